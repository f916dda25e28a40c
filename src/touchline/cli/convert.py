"""`touchline convert`: a recording from one kind into another."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, get_args

import typer

from touchline.cli.console import say, steps_shown, warn
from touchline.cli.options import BagBase, BagCamera, BagField, BagLate, FollowLinks, FromZero, Topics, bag_options
from touchline.errors import InputError, TouchlineError
from touchline.files.new import check_new_path
from touchline.messages import counted

if TYPE_CHECKING:
    from touchline.sources import Recording
    from touchline.sources.bags.with_rosbags import Codec
    from touchline.sources.bags.writing import BagWriter


Kind = Literal["folder", "mcap", "rosbag2", "rosbag2-mcap"]


def convert(
    source: Annotated[
        Path, typer.Argument(metavar="SOURCE", help="A recording of any kind, a video, a folder of numbered images.")
    ],
    target: Annotated[Path, typer.Argument(metavar="TARGET", help="A new folder or file.")],
    to: Annotated[
        Kind | None, typer.Option(help="What to write (default: mcap for a TARGET that ends in .mcap, else folder).")
    ] = None,
    rate: Annotated[
        float | None, typer.Option(metavar="HZ", help="Of numbered images, or instead of a video's own times.")
    ] = None,
    odometry: Annotated[Path | None, typer.Option(metavar="CSV", help="Odometry beside a video or images.")] = None,
    columns: Annotated[
        str, typer.Option(help="Of the CSV: the name or number (from 1) of each; also t_ns, t_ms, x_mm, theta_deg.")
    ] = "t=t,x=x,y=y,theta=theta",
    first_image_at: Annotated[
        str, typer.Option(metavar="SECONDS", help="When the first image was taken, on the CSV's clock.")
    ] = "0",
    follow_links: FollowLinks = False,
    topics: Topics = None,
    field: BagField = None,
    camera: BagCamera = None,
    base: BagBase = None,
    late: BagLate = 0.0,
    from_zero: FromZero = False,
) -> None:
    """Write a recording as another kind, without loss: images are copied as they are, times to the nanosecond."""
    kind = to or ("mcap" if target.suffix.lower() == ".mcap" else "folder")
    _check_target(target, kind)
    from touchline.sources import open_source
    from touchline.sources.loose import LooseOptions, is_loose, open_loose

    if (source / "summary.json").is_file():
        _write_results(source, target, kind, follow_links)
        return
    described = bag_options(topics, field, camera, base, late, from_zero)
    if is_loose(source):
        recording = open_loose(source, LooseOptions(rate, odometry, columns, first_image_at), described)
    else:
        if rate is not None or odometry is not None:
            what = "has its own times and odometry; --rate and --odometry are for videos and images"
            raise InputError(f"{source}: {what}")
        recording = open_source(source, follow_links, described)
    for problem in recording.problems:
        warn(f"warning: {problem}")
    _write(recording, target, kind)
    say(f"{target}: {_held(recording)}")


def _held(recording: Recording) -> str:
    what = [counted(len(recording), "image" if recording.has_images else "observation"), *recording.sensor_files]
    return ", ".join([*what, "truth"] if recording.truth is not None else what)


def _check_target(target: Path, kind: Kind) -> None:
    check_new_path(target)
    if target.suffix.lower() in (".bag", ".db3", ".zip", ".tar", ".mp4"):
        raise InputError(f"{target}: is not written; a recording is written as {', '.join(get_args(Kind))} (--to)")
    if kind == "mcap" and target.suffix.lower() != ".mcap":
        raise InputError(f"{target}: an MCAP file's name has to end in .mcap")


def _write(recording: Recording, target: Path, kind: Kind) -> None:
    """Write it, with a progress bar; what cannot be finished is taken away again."""
    with _kept_whole(target), steps_shown(recording.name, len(recording)) as advance:
        if kind == "folder":
            from touchline.sources.to_folder import write_folder

            write_folder(recording, target, advance)
            return
        writer, codec = _bag_writer(target, kind)
        from touchline.sources.bags.writing import write_recording

        write_recording(recording, writer, codec, advance)


@contextmanager
def _kept_whole(target: Path) -> Iterator[None]:
    """Makes the folder around the target, and takes away what is not finished."""
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException as error:
        if target.is_dir():
            shutil.rmtree(target, ignore_errors=True)
        else:
            target.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise TouchlineError(f"{error.filename or target}: cannot be written ({error.strerror})") from None
        raise


def _write_results(run: Path, target: Path, kind: Kind, follow_links: bool) -> None:
    """The results of a run as a bag."""
    if kind == "folder":
        raise InputError(f"{run}: is the folder of a run; its results are written as a bag: {target}.mcap")
    from touchline.evaluation.run import Run
    from touchline.view.run_pictures import looks

    finished = Run(run, follow_links)
    look = looks(finished.recording(), finished.summary.system)
    with _kept_whole(target), steps_shown(finished.folder.name, len(finished.estimates)) as advance:
        writer, codec = _bag_writer(target, kind)
        from touchline.evaluation.ros_results import write_results

        write_results(finished, writer, codec, look, advance)
    say(f"{target}: {len(finished.estimates)} poses")


def _bag_writer(target: Path, kind: Kind) -> tuple[BagWriter, Codec]:
    from touchline.sources.bags.kinds import require_bags

    require_bags(target)
    from touchline.sources.bags.with_rosbags import Codec, Rosbag2Writer
    from touchline.sources.bags.writing import McapWriter

    codec = Codec()
    if kind == "mcap":
        return McapWriter(target, codec), codec
    return Rosbag2Writer(target, codec, kind == "rosbag2-mcap"), codec
