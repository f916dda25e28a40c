"""Pictures of a calibration from lines: before and after."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from touchline.calibration.lines.calibration import LineCalibration
from touchline.calibration.lines.equations import WIDTHS
from touchline.calibration.lines.images import ImageCalibration
from touchline.camera import GroundView, OmniCamera
from touchline.field import FieldModel
from touchline.field.drawing import draw_field, field_view
from touchline.geometry import FloatArray, Pose
from touchline.perception.stages import SHIFT, enlarged, fixed_point, titled
from touchline.types import ImageArray
from touchline.view.overlay import LINE_COLOR, OFF_LINE_COLOR, ON_LINE_COLOR, draw_rated, projected_lines

_SIDE = 900


def image_picture(found: ImageCalibration, image: ImageArray, field: FieldModel) -> ImageArray:
    """The first image with the field's lines at its pose through the generic mirror and through the calibrated one,

    and the points of all images on the field. BGR.
    """
    lines = found.lines
    pose, pixels = lines.poses[0], lines.pixels[0]
    good = lines.certainty.residuals[: len(pixels)] < WIDTHS[-1]
    front = Pose(pose.x, pose.y, pose.heading - found.camera.mount_yaw_rad)
    panels = [
        titled(_overlay(image, found.before, field, pose, pixels, good), "before: a generic mirror", _SIDE),
        titled(_overlay(image, found.camera, field, front, pixels, good), "after: the calibrated mirror", _SIDE),
    ]
    return np.vstack((np.hstack(panels), _wide(_on_field(lines, field), 2 * _SIDE)))


def points_picture(lines: LineCalibration, field: FieldModel) -> ImageArray:
    """The points as they are given, and on the field. BGR."""
    points = np.concatenate(lines.pixels)
    low, high = points.min(axis=0), points.max(axis=0)
    scale = 0.9 * _SIDE / float((high - low).max())
    canvas: ImageArray = np.full((_SIDE, _SIDE, 3), 24, dtype=np.uint8)
    for (u, v), good in zip(points, lines.certainty.residuals < WIDTHS[-1], strict=True):
        at = (round(0.05 * _SIDE + (u - low[0]) * scale), round(0.05 * _SIDE + (v - low[1]) * scale))
        cv2.circle(canvas, at, 2, ON_LINE_COLOR if good else OFF_LINE_COLOR, -1, cv2.LINE_AA)
    return np.vstack(
        (_wide(titled(canvas, "before: the points in the image", _SIDE), _SIDE), _wide(_on_field(lines, field), _SIDE))
    )


def _overlay(
    image: ImageArray,
    camera: OmniCamera,
    field: FieldModel,
    pose: Pose,
    pixels: FloatArray,
    good: npt.NDArray[np.bool_],
) -> ImageArray:
    scale = _SIDE / max(image.shape[:2])
    canvas = enlarged(image, scale)
    for line in projected_lines(GroundView(camera), field, pose):
        cv2.polylines(canvas, [fixed_point(line, scale)], False, LINE_COLOR, 1, cv2.LINE_AA, SHIFT)
    for pixel, on_line in zip(pixels, good, strict=True):
        at = fixed_point(pixel[np.newaxis], scale)[0]
        cv2.circle(
            canvas, (int(at[0]), int(at[1])), 32, ON_LINE_COLOR if on_line else OFF_LINE_COLOR, -1, cv2.LINE_AA, SHIFT
        )
    return canvas


def _on_field(lines: LineCalibration, field: FieldModel) -> ImageArray:
    """The field from above with all points where mirror and poses put them."""
    canvas, view = draw_field(field), field_view(field)
    good = lines.certainty.residuals < WIDTHS[-1]
    start = 0
    for pose, pixels in zip(lines.poses, lines.pixels, strict=True):
        own = good[start : start + len(pixels)]
        start += len(pixels)
        draw_rated(canvas, view, pose.transform(lines.shape.ground(pixels)), own, 3)
        u, v = view.picture_from_field(np.array([[pose.x, pose.y]]))[0]
        cv2.circle(canvas, (round(u), round(v)), 10, (0, 0, 220), 3, cv2.LINE_AA)
    return canvas


def _wide(panel: ImageArray, width: int) -> ImageArray:
    height = round(panel.shape[0] * width / panel.shape[1])
    return np.asarray(cv2.resize(panel, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)
