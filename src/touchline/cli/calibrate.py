"""`touchline calibrate NAME`: what a robot has to know of itself before a match."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from touchline.cli.calibrate_lines import calibrate_lines
from touchline.cli.calibrate_perspective import calibrate_camera, calibrate_imu
from touchline.cli.calibrate_self import calibrate_self
from touchline.cli.new_pair import (
    CAMERA_ENDINGS,
    NewFile,
    NewPicture,
    calibration_of_a_paper,
    new_files,
    print_lines,
    write_calibrated,
)
from touchline.cli.options import FollowLinks, SkipUnusable
from touchline.errors import InputError

calibrate_app = typer.Typer(
    help="Calibrate the mirror, its ranges, a perspective camera, its IMU or the colours.", no_args_is_help=True
)


@calibrate_app.command("mirror")
def mirror(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="A recording of the calibration strip in known directions.")
    ],
    output: NewFile,
    picture: NewPicture = None,
    skip_unusable: SkipUnusable = False,
    support: Annotated[
        int,
        typer.Option(min=0, max=100, metavar="N", help="Nearest edges in each polynomial; 0: all, as Lagrange has it."),
    ] = 4,
    follow_links: FollowLinks = False,
) -> None:
    """Write a camera.yaml with ranges and bearings for every direction, from images of a strip of known edges."""
    picture = new_files(output, CAMERA_ENDINGS, "a camera", picture)
    from touchline.sources import open_source

    calibrate = calibration_of_a_paper("mirror")
    write_calibrated(calibrate(open_source(recording, follow_links), skip_unusable, support), output, picture)


calibrate_app.command("lines")(calibrate_lines)


@calibrate_app.command("range")
def calibrate_range(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING|MARKS.csv",
            help="A recording with marks.csv or of the calibration strip, or a file of marks.",
        ),
    ],
    output: NewFile,
    degree: Annotated[
        int | None,
        typer.Option(min=1, max=12, help="Degree of the polynomial (default: the highest up to 6 that rises)."),
    ] = None,
    camera: Annotated[Path | None, typer.Option(help="camera.yaml for MARKS.csv (default: the one beside it).")] = None,
    picture: NewPicture = None,
    skip_unusable: SkipUnusable = False,
    handedness: Annotated[
        Literal["1", "-1"] | None,
        typer.Option(help="1: the image shows the field as a map does; -1: mirrored. For marks that can't tell."),
    ] = None,
    keep_center: Annotated[
        bool, typer.Option("--keep-center", help="Take the centre of camera.yaml though the marks can't tell it.")
    ] = False,
    follow_links: FollowLinks = False,
) -> None:
    """Write a camera.yaml whose ranges are a polynomial of the pixel radius, fitted to pairs of both."""
    picture = new_files(output, CAMERA_ENDINGS, "a camera", picture)
    found = calibration_of_a_paper("range")(
        source, camera=camera, degree=degree, skip_unusable=skip_unusable,
        handedness=int(handedness) if handedness else None,
        keep_center=keep_center, follow_links=follow_links,
    )  # fmt: skip
    write_calibrated(found, output, picture)


calibrate_app.command("self")(calibrate_self)
calibrate_app.command("camera")(calibrate_camera)
calibrate_app.command("imu")(calibrate_imu)


@calibrate_app.command("colour")
def colour(
    source: Annotated[Path, typer.Argument(metavar="RECORDING|IMAGE", help="A recording, or one image.")],
    output: NewFile,
    regions: Annotated[
        Path | None, typer.Option(help="Marked regions (default: RECORDING/regions.yaml, if any).")
    ] = None,
    camera: Annotated[Path | None, typer.Option(help="camera.yaml of an image without marks.")] = None,
    picture: NewPicture = None,
    follow_links: FollowLinks = False,
) -> None:
    """Write a colour table (.npz), learned from marked regions, or without any marks from the field itself."""
    if not source.exists():
        raise InputError(f"{source}: there is no such recording or image")
    picture = new_files(output, (".npz",), "a colour table", picture)
    from touchline.calibration.colour import calibrate_marked, calibrate_recording, calibrate_unmarked, read_picture
    from touchline.camera import open_camera
    from touchline.perception.colour_ellipses import learned_names
    from touchline.perception.colour_file import save_colours
    from touchline.sources import is_recording, open_source
    from touchline.view.calibration import colour_picture
    from touchline.view.picture_files import save_picture

    if is_recording(source):
        if camera is not None:
            raise InputError("--camera is for single images: a recording brings its own")
        calibration = calibrate_recording(open_source(source, follow_links), regions)
    elif regions is not None:
        calibration = calibrate_marked(source.parent, regions, follow_links)
    elif camera is not None:
        calibration = calibrate_unmarked([read_picture(source)], open_camera(camera), source.name)
    else:
        raise InputError(
            f"{source}: an image needs its camera model (--camera FILE), or marked regions (--regions FILE)"
        )
    save_colours(calibration.colours, output)
    save_picture(picture, colour_picture(calibration.colours, calibration.image))
    green, white = (
        tuple(round(float(c)) for c in color[::-1]) for color in (calibration.colours.green, calibration.colours.white)
    )
    coloured = ", ".join(learned_names(calibration.colours.ellipses)) or "none"
    words = (
        f"Colours learned from {calibration.learned_from}: green {green}, white {white} (R, G, B).\n"
        f"Of blue, yellow, orange, magenta and cyan learned: {coloured}; the usual ones stand for the rest."
    )
    print_lines(words, output, picture)
