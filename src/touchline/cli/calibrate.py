"""`touchline calibrate NAME`: what a robot has to know of itself before a match."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from touchline.cli.calibrate_lines import calibrate_lines
from touchline.cli.calibrate_perspective import calibrate_camera, calibrate_imu
from touchline.cli.calibrate_range import calibrate_range
from touchline.cli.calibrate_self import calibrate_self
from touchline.cli.console import warn
from touchline.cli.new_pair import CAMERA_ENDINGS, NewFile, NewPicture, new_files, print_lines, write_pair
from touchline.cli.options import FollowLinks, SkipUnusable
from touchline.errors import InputError

if TYPE_CHECKING:
    from touchline.calibration.mirror import MirrorCalibration

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
    from touchline.calibration.mirror import calibrate_mirror
    from touchline.calibration.strip_recording import camera_yaml
    from touchline.sources import open_source
    from touchline.view.calibration import mirror_picture

    source = open_source(recording, follow_links)
    calibration = calibrate_mirror(source, skip_unusable, support)
    for message in calibration.unusable:
        warn(f"left out: {message}")
    sighting = calibration.sightings[0]
    image = source.image(sighting.index)
    assert image is not None  # it was read a moment ago
    words = _mirror_words(calibration, source.name)
    drawn = mirror_picture(calibration, image, sighting)
    write_pair(output, camera_yaml(calibration.camera, words), picture, drawn, words)


calibrate_app.command("lines")(calibrate_lines)
calibrate_app.command("range")(calibrate_range)
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


def _mirror_words(calibration: MirrorCalibration, name: str) -> str:
    import math

    camera, edges = calibration.camera, calibration.strip.edges_m
    hidden = f"\n{calibration.filled} edges, hidden or spoilt, were taken from the other directions."
    hidden = hidden if calibration.filled else ""
    return (
        f"Mirror calibrated without a model from {name}: {len(calibration.sightings)} images of {len(edges)} edges.\n"
        f"Centre {camera.center[0]:.2f}, {camera.center[1]:.2f} px; "
        f"{'mirrored' if camera.handedness < 0 else 'straight'} image; "
        f"mounted at {math.degrees(camera.mount_yaw_rad):.2f}°; "
        f"bearings agree to {math.degrees(calibration.bearing_error_rad):.2f}°.\n"
        f"Known from edges between {edges[0]:g} and {edges[-1]:g} m; continued from {camera.range_m[:, 0].min():.2f} "
        f"to {camera.range_m[:, -1].max():.1f} m.{hidden}"
    )
