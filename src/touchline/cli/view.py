"""`touchline view`: what each stage makes of one image; in the viewer, of a whole recording."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from touchline.cli.console import say
from touchline.cli.options import BagBase, BagLate, FollowLinks, Topics, bag_options
from touchline.cli.viewer import KeepIn, ShowIn, shown_in
from touchline.errors import InputError

if TYPE_CHECKING:
    from touchline.sources import BagOptions


def view(
    source: Annotated[Path, typer.Argument(metavar="RECORDING|IMAGE", help="A recording, or one image.")],
    stages: Annotated[bool, typer.Option("--stages", help="Every stage's picture and a sheet of all.")] = False,
    frame: Annotated[
        int | None,
        typer.Option(
            min=0,
            metavar="N",
            help="Which image of a recording, from 0 (default: the first in which the robot is located).",
        ),
    ] = None,
    camera: Annotated[Path | None, typer.Option(help="camera.yaml of an image or bag.")] = None,
    field: Annotated[str | None, typer.Option(metavar="NAME|FILE", help="The field of an image or bag.")] = None,
    system: Annotated[str | None, typer.Option(help="Whose stages to draw (default: touchline).")] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="New folder for the pictures (default: runs/NAME-view-N).")
    ] = None,
    follow_links: FollowLinks = False,
    topics: Topics = None,
    base: BagBase = None,
    late: BagLate = 0.0,
    viewer: ShowIn = None,
    rrd: KeepIn = None,
) -> None:
    """Draw points and field lines over one image; with --stages, every step on the way there.

    With --view or --rrd, a whole recording is shown in the viewer.
    """
    if not source.exists():
        raise InputError(f"{source}: there is no such recording or image")
    from touchline.sources import is_recording
    from touchline.sources.bags.kinds import find_bag

    recorded, bag = is_recording(source), find_bag(source) is not None
    if not recorded and frame is not None:
        raise InputError("--frame is for recordings: an image is one by itself")
    if recorded and not bag and (camera is not None or field is not None):
        raise InputError("--camera and --field are for single images: a recording brings its own")
    if not recorded and camera is None:
        raise InputError(f"{source}: an image needs its camera model; give it with --camera FILE")
    options = bag_options(topics, field if bag else None, camera, base, late)
    if viewer is not None or rrd is not None:
        if not recorded:
            raise InputError("--view and --rrd show a recording; an image's stages are pictures: --stages")
        if stages or frame is not None or output is not None:
            raise InputError("--stages, --frame and --output are for pictures of one image, --view and --rrd for all")
        _show_all(source, system, follow_links, options, viewer, rrd)
        return
    from touchline.evaluation.run_folder import new_folder
    from touchline.view.look import look_at_image, look_at_recording
    from touchline.view.stages import save_pictures

    if recorded:
        look = look_at_recording(source, frame, system, follow_links, options)
    else:
        assert camera is not None
        look = look_at_image(source, camera, field, system)
    pictures = look.stages() if stages else {"overlay": look.overlay()}
    folder = new_folder(output, f"{look.name}-view")
    written = save_pictures(pictures, folder)
    say(look.words(), *map(str, written))


def _show_all(
    path: Path, system: str | None, follow_links: bool, options: BagOptions, viewer: str | None, rrd: Path | None
) -> None:
    """A system's run over a recording in the viewer; no folder is written."""
    from touchline.api import prepare
    from touchline.cli.run import frame_progress, on_screen, warn_of
    from touchline.sources import open_source
    from touchline.systems import DEFAULT_SYSTEM
    from touchline.systems.ordered import OrderedSystem

    prepared = prepare(open_source(path, follow_links, options), system or DEFAULT_SYSTEM)
    with shown_in(viewer, rrd) as screen:
        warn_of(prepared)
        show = on_screen(screen, prepared)
        ordered = OrderedSystem(prepared.system, prepared.prior)
        statuses = Counter[str]()
        with frame_progress(prepared.source) as (advance, stop):
            for frame in prepared.source:
                estimate = ordered.step(frame)
                statuses[estimate.status] += 1
                for tell in (advance, *show):
                    tell(frame, estimate)
                if stop():
                    break
        say(", ".join(f"{status} {count}" for status, count in statuses.items()) or "no images")
