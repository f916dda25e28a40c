"""`touchline calibrate imu`: the correction by roll and pitch that figure 3 of Schulz and Behnke 2012 shows."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from touchline.calibration.calibrated import Calibrated
from touchline.calibration.marks import MARKS, first_image, read_marks
from touchline.calibration.perspective import perspective_yaml
from touchline.camera import PinholeCamera, open_camera
from touchline.errors import InputError
from touchline.palette import BLUE, VERMILLION, bgr
from touchline.perception.stages import SHIFT, with_legend
from touchline.published.nimbro_lines.imu import ImuCalibration, calibrate_imu
from touchline.sources import open_source
from touchline.types import ImageArray
from touchline.view.calibration import enlarged_view, fixed_pixels


def calibrated_imu(
    recording: Path, camera: Path | None = None, *, paper: bool = False, follow_links: bool = False
) -> Calibrated:
    """The camera of a recording (or `camera`) with the correction. Raises InputError for one that is no pinhole."""
    source = open_source(recording, follow_links)
    before = source.camera if camera is None else open_camera(camera)
    if not isinstance(before, PinholeCamera):
        what = "looks at a mirror" if before.model == "omni" else f"is a {before.model}"
        raise InputError(f"{recording}: its camera {what}; the IMU's correction is for pinhole cameras")
    found = calibrate_imu(source, before, paper)
    words = _words(found)
    text = perspective_yaml(replace(before, imu_correction=found.correction, use_attitude=True), words)
    files = read_marks(source.file(MARKS)).files
    seen = first_image(source.folder, files, (before.width, before.height), follow_links)
    return Calibrated(text, wander_picture(found, before, None if seen is None else seen[1]), words)


def wander_picture(found: ImuCalibration, camera: PinholeCamera, image: ImageArray | None) -> ImageArray:
    """An image without its distortion, BGR, and where the marks were in all images: as seen, and corrected."""
    flat = image
    if image is not None:
        matrix = np.array([(camera.fx, 0.0, camera.cx), (0.0, camera.fy, camera.cy), (0.0, 0.0, 1.0)])
        flat = cv2.undistort(image, matrix, np.asarray(camera.distortion)).astype(np.uint8)
    canvas, scale = enlarged_view(camera, flat)
    for pixels, color in ((found.seen_px, VERMILLION), (found.corrected_px, BLUE)):
        for at in fixed_pixels(pixels, scale).tolist():
            cv2.circle(canvas, (at[0], at[1]), 3 << SHIFT, bgr(color), -1, cv2.LINE_AA, SHIFT)
    before, after = f"as seen: {found.before_px:.1f} px", f"corrected: {found.after_px:.1f} px"
    return with_legend(canvas, [(before, bgr(VERMILLION)), (after, bgr(BLUE))])


def _words(found: ImuCalibration) -> str:
    """What was learned from what, and what it is good for."""
    upright = (
        f"upright is the reading of the first {found.standing} images, in which the robot stands"
        if found.standing
        else "upright is the reading 0, for the robot never stands"
    )
    without = (
        f", without {found.left_out} of {len(found.seen_px)} sightings, which fit far worse: look at the picture"
        if found.left_out
        else ""
    )
    return (
        f"Learned from {found.marks} marks in {found.images} images: they wander by {found.before_px:.1f} px (root "
        f"mean square) as the robot walks, by {found.after_px:.1f} px once corrected{without}.\n"
        f"{upright[0].upper()}{upright[1:]}."
    )
