"""`touchline calibrate range`: ranges as a polynomial of the pixel radius (Ismail et al. 2021)."""

from pathlib import Path

import numpy as np

from touchline.calibration.calibrated import Calibrated
from touchline.calibration.marks import first_image
from touchline.camera.writing import camera_yaml
from touchline.errors import InputError
from touchline.published.iris_fusion.range_pairs import RangePairs, marked_pairs, recording_pairs
from touchline.published.iris_fusion.range_picture import range_picture
from touchline.published.iris_fusion.range_regression import RangeRegression, fit_range
from touchline.sources import is_recording, open_source

_UNSURE_PX = 1.5  # of the centre: ranges to one side are 3 % off then
_BAD_SHARE = 0.03  # of the range: more than a pixel's worth anywhere on the table


def calibrated_range(
    source: Path,
    *,
    camera: Path | None = None,
    degree: int | None = None,
    skip_unusable: bool = False,
    handedness: int | None = None,
    keep_center: bool = False,
    follow_links: bool = False,
) -> Calibrated:
    """Fit the ranges to a recording's marks or calibration strip, or to a file of marks. Raises InputError."""
    pairs = _pairs(source, camera, skip_unusable, handedness, follow_links)
    regression = fit_range(pairs, degree)
    optics = pairs.optics
    if regression.center_deviation_px() > _UNSURE_PX and not keep_center:
        raise InputError(
            f"{source}: the pairs can't tell whether the centre {optics.center[0]:.1f}, {optics.center[1]:.1f} px is "
            "right, and each pixel that it is off makes the ranges to one side too long: mark three directions or more "
            "all around, or take it as it is with --keep-center"
        )
    words = regression_words(regression)
    text = camera_yaml(regression.camera(continued=True), f"{words}\n{regression.formula()}")
    seen = first_image(pairs.folder, pairs.files, (optics.width, optics.height), follow_links)
    return Calibrated(text, range_picture(regression, seen), words)


def _pairs(
    source: Path, camera: Path | None, skip_unusable: bool, handedness: int | None, follow_links: bool
) -> RangePairs:
    if not source.exists():
        raise InputError(f"{source}: there is no such recording or file of marks")
    if is_recording(source) and camera is not None:
        raise InputError("--camera is for a file of marks: a recording brings its own")
    if is_recording(source):
        return recording_pairs(open_source(source, follow_links), skip_unusable, handedness)
    return marked_pairs(source, camera or source.parent / "camera.yaml", handedness)


def regression_words(regression: RangeRegression) -> str:
    """What was fitted to what, how well, and where it holds."""
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
