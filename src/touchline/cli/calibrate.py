"""`touchline calibrate NAME`: what a robot has to know of itself before a match."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from touchline.cli.calibrate_lines import calibrate_lines
from touchline.cli.calibrate_perspective import calibrate_camera, calibrate_imu
from touchline.cli.calibrate_self import calibrate_self
from touchline.cli.console import warn
from touchline.cli.new_pair import CAMERA_ENDINGS, NewFile, NewPicture, new_files, print_lines, write_pair
from touchline.cli.options import FollowLinks, SkipUnusable
from touchline.errors import InputError
from touchline.files.new import write_new_file

if TYPE_CHECKING:
    from touchline.calibration.mirror import MirrorCalibration
    from touchline.calibration.range_pairs import RangePairs
    from touchline.calibration.range_regression import RangeRegression

_UNSURE_PX = 1.5  # of the centre: ranges to one side are 3 % off then
_BAD_SHARE = 0.03  # of the range: more than a pixel's worth anywhere on the table

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
    pairs = _pairs(source, camera, skip_unusable, int(handedness) if handedness else None, follow_links)
    from touchline.calibration.marks import first_image
    from touchline.calibration.range_regression import fit_range
    from touchline.calibration.strip_recording import camera_yaml
    from touchline.view.range_figure import range_figure

    regression = fit_range(pairs, degree)
    deviation_px = regression.center_deviation_px()
    if deviation_px > _UNSURE_PX and not keep_center:
        raise InputError(
            f"{source}: the pairs can't tell whether the centre {pairs.optics.center[0]:.1f}, "
            f"{pairs.optics.center[1]:.1f} px is right, and each pixel that it is off makes the ranges to one side too "
            "long: mark three directions or more all around, or take it as it is with --keep-center"
        )
    words = regression_words(regression)
    write_new_file(output, camera_yaml(regression.camera(continued=True), f"{words}\n{regression.formula()}").encode())
    drawn = io.BytesIO()
    optics = pairs.optics
    seen = first_image(pairs.folder, pairs.files, (optics.width, optics.height), follow_links)
    range_figure(regression, seen).savefig(drawn, dpi=130, format=picture.suffix.lower().removeprefix("."))
    write_new_file(picture, drawn.getvalue())
    print_lines(words, output, picture)


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


def _pairs(
    source: Path, camera: Path | None, skip_unusable: bool, handedness: int | None, follow_links: bool
) -> RangePairs:
    if not source.exists():
        raise InputError(f"{source}: there is no such recording or file of marks")
    from touchline.calibration.range_pairs import marked_pairs, recording_pairs
    from touchline.sources import is_recording, open_source

    if is_recording(source) and camera is not None:
        raise InputError("--camera is for a file of marks: a recording brings its own")
    if is_recording(source):
        return recording_pairs(open_source(source, follow_links), skip_unusable, handedness)
    return marked_pairs(source, camera or source.parent / "camera.yaml", handedness)


def regression_words(regression: RangeRegression) -> str:
    """What was fitted to what, how well, and where it holds."""
    import numpy as np

    pairs, residuals_cm = regression.pairs, 100.0 * regression.residuals_m
    camera, deviation_px = regression.camera(continued=True), regression.center_deviation_px()
    turned = "straight" if camera.handedness > 0 else "mirrored"
    words = (
        f"Polynomial of degree {regression.degree} fitted to {pairs.origin}: residuals "
        f"{np.sqrt(np.mean(residuals_cm**2)):.1f} cm (root mean square), {np.abs(residuals_cm).max():.1f} cm at most.\n"
        f"Known from pairs between {pairs.range_m.min():g} and {pairs.range_m.max():g} m "
        f"({regression.first_px:.0f} to {regression.last_px:.0f} px); continued from {camera.range_m.min():.2f} to "
        f"{camera.range_m.max():.1f} m.\n"
        f"{turned.capitalize()} image; mounted at {np.degrees(camera.mount_yaw_rad):.2f}°."
    )
    if deviation_px > _UNSURE_PX:
        return f"{words}\nThe pairs can't tell the centre: it is taken as camera.yaml has it."
    if np.abs(regression.residuals_m / pairs.range_m).max() > _BAD_SHARE:
        words += "\nA polynomial follows this mirror badly; touchline calibrate mirror needs no formula."
    off_u, off_v = regression.center_offset_px()
    if np.hypot(off_u, off_v) > 1.0:
        u, v = pairs.optics.center
        words += (
            f"\nThe pairs lie as if the centre were at {u + off_u:.1f}, {v + off_v:.1f} px instead of "
            f"{u:.1f}, {v:.1f}: correct 'center' in camera.yaml and fit again."
        )
    return words
