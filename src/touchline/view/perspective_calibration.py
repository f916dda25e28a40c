"""A perspective camera's calibrations over an image: marks and metres on the ground; what the IMU's correction does."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from touchline.calibration.imu import ImuCalibration
from touchline.calibration.perspective import PerspectiveCalibration
from touchline.camera import GroundView, PinholeCamera
from touchline.geometry import FloatArray
from touchline.palette import BLUE, ORANGE, VERMILLION, bgr
from touchline.perception.stages import SHIFT, Paint, enlarged, fixed_point, with_legend
from touchline.types import ImageArray

_WIDTH_PX = 1200
_GRID_M, _STEP_M, _BEYOND_M = 0.5, 0.05, 1.0
_GRID: Paint = (235, 220, 190)
_BLANK = 60


def marks_picture(
    found: PerspectiveCalibration, image: ImageArray | None, pixels: FloatArray, places: FloatArray
) -> ImageArray:
    """The image, BGR, with the ground's half metres, the marks as clicked, and where the camera sees their places.

    image: None where there is none; an empty one stands for it. pixels, places: (N, 2) of the marks; m, robot frame.
    """
    canvas, scale = _enlarged(found.camera, image)
    view = GroundView(found.camera)
    for line in _half_metres(places):
        seen = view.image_from_ground(line)
        for piece in np.split(seen, np.flatnonzero(~view.sees(seen))):
            inside = piece[view.sees(piece)]
            if len(inside) > 1:
                cv2.polylines(canvas, [_fixed(inside, scale)], False, _GRID, 1, cv2.LINE_AA, SHIFT)
    for at in _fixed(pixels, scale).tolist():
        cv2.drawMarker(
            canvas, (at[0] >> SHIFT, at[1] >> SHIFT), bgr(ORANGE), cv2.MARKER_TILTED_CROSS, 18, 2, cv2.LINE_AA
        )
    known = np.isfinite(places).all(axis=1)
    for at in _fixed(found.camera.image_from_ground(places[known]), scale).tolist():
        cv2.circle(canvas, (at[0], at[1]), 11 << SHIFT, bgr(BLUE), 2, cv2.LINE_AA, SHIFT)
    legend = [("marks", bgr(ORANGE)), ("their places as this camera sees them", bgr(BLUE)), ("half metres", _GRID)]
    return with_legend(canvas, legend)


def wander_picture(found: ImuCalibration, camera: PinholeCamera, image: ImageArray | None) -> ImageArray:
    """An image without its distortion, BGR, and where the marks were in all images: as seen, and corrected."""
    flat = image
    if image is not None:
        matrix = np.array([(camera.fx, 0.0, camera.cx), (0.0, camera.fy, camera.cy), (0.0, 0.0, 1.0)])
        flat = cv2.undistort(image, matrix, np.asarray(camera.distortion)).astype(np.uint8)
    canvas, scale = _enlarged(camera, flat)
    for pixels, color in ((found.seen_px, VERMILLION), (found.corrected_px, BLUE)):
        for at in _fixed(pixels, scale).tolist():
            cv2.circle(canvas, (at[0], at[1]), 3 << SHIFT, bgr(color), -1, cv2.LINE_AA, SHIFT)
    before, after = f"as seen: {found.before_px:.1f} px", f"corrected: {found.after_px:.1f} px"
    return with_legend(canvas, [(before, bgr(VERMILLION)), (after, bgr(BLUE))])


def _enlarged(camera: PinholeCamera, image: ImageArray | None) -> tuple[ImageArray, float]:
    scale = _WIDTH_PX / camera.width
    if image is None:
        image = np.full((camera.height, camera.width, 3), _BLANK, np.uint8)
    return enlarged(image, scale), scale


def _half_metres(places: FloatArray) -> list[FloatArray]:
    """Lines of the ground (M, 2), half a metre apart, about the marks."""
    known = places[np.isfinite(places).all(axis=1)]
    low, high = (
        _GRID_M * np.round(end / _GRID_M) for end in (known.min(axis=0) - _BEYOND_M, known.max(axis=0) + _BEYOND_M)
    )
    x, y = (np.arange(low[k], high[k] + 1e-6, _STEP_M) for k in (0, 1))
    along = [np.column_stack((np.full(len(y), at), y)) for at in np.arange(low[0], high[0] + 1e-6, _GRID_M)]
    across = [np.column_stack((x, np.full(len(x), at))) for at in np.arange(low[1], high[1] + 1e-6, _GRID_M)]
    return along + across


def _fixed(pixels: FloatArray, scale: float) -> npt.NDArray[np.int32]:
    """Pixels (N, 2) in the enlarged image as OpenCV's fixed-point numbers; those that are none are left out."""
    limit = 1e4 / scale
    return fixed_point(np.clip(pixels[np.isfinite(pixels).all(axis=1)], -limit, limit), scale)
