"""`touchline calibrate range`: the pixel-to-centimetre regression of a mirror."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from touchline.cli.new_pair import CAMERA_ENDINGS, NewFile, NewPicture, new_files, print_lines
from touchline.cli.options import FollowLinks, SkipUnusable, check_handedness
from touchline.errors import InputError
from touchline.files.new import write_new_file

if TYPE_CHECKING:
    from touchline.calibration.range_pairs import RangePairs
    from touchline.calibration.range_regression import RangeRegression

_UNSURE_PX = 1.5  # of the centre: ranges to one side are 3 % off then
_BAD_SHARE = 0.03  # of the range: more than a pixel's worth anywhere on the table


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
        int | None,
        typer.Option(
            metavar="1|-1", help="1: the image shows the field as a map does; -1: mirrored. For marks that can't tell."
        ),
    ] = None,
    keep_center: Annotated[
        bool, typer.Option("--keep-center", help="Take the centre of camera.yaml though the marks can't tell it.")
    ] = False,
    follow_links: FollowLinks = False,
) -> None:
    """Write a camera.yaml whose ranges are a polynomial of the pixel radius, fitted to pairs of both."""
    check_handedness(handedness)
    picture = new_files(output, CAMERA_ENDINGS, "a camera", picture)
    pairs = _pairs(source, camera, skip_unusable, handedness, follow_links)
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
