"""`touchline view`: what each stage makes of one image."""

from pathlib import Path
from typing import Annotated

import typer

from touchline.cli.console import say
from touchline.cli.options import BagBase, BagLate, FollowLinks, Topics, bag_options
from touchline.errors import InputError


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
) -> None:
    """Draw points and field lines over one image; with --stages, every step on the way there."""
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
