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
from touchline.types import ImageArray
from touchline.view.overlay import projected_lines

_SIDE = 900
_LINE, _ON, _OFF = (255, 90, 235), (255, 200, 0), (0, 120, 255)  # BGR


def image_picture(found: ImageCalibration, image: ImageArray, field: FieldModel) -> ImageArray:
    """The first image with the field's lines at its pose through the generic mirror and through the calibrated one,

    and the points of all images on the field. BGR.
    """
    lines = found.lines
    pose, pixels = lines.poses[0], lines.pixels[0]
    good = lines.certainty.residuals[: len(pixels)] < WIDTHS[-1]
    front = Pose(pose.x, pose.y, pose.heading - found.camera.mount_yaw_rad)
    panels = [
        _titled(_overlay(image, found.before, field, pose, pixels, good), "before: a generic mirror"),
        _titled(_overlay(image, found.camera, field, front, pixels, good), "after: the calibrated mirror"),
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
        cv2.circle(canvas, at, 2, _ON if good else _OFF, -1, cv2.LINE_AA)
    return np.vstack(
        (_wide(_titled(canvas, "before: the points in the image"), _SIDE), _wide(_on_field(lines, field), _SIDE))
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
    canvas = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC).astype(np.uint8)
    for line in projected_lines(GroundView(camera), field, pose):
        cv2.polylines(canvas, [_fixed(line, scale)], False, _LINE, 1, cv2.LINE_AA, 4)
    for pixel, on_line in zip(pixels, good, strict=True):
        at = _fixed(pixel[np.newaxis], scale)[0]
        cv2.circle(canvas, (int(at[0]), int(at[1])), 32, _ON if on_line else _OFF, -1, cv2.LINE_AA, 4)
    return canvas


def _fixed(pixels: FloatArray, scale: float) -> ImageArray:
    numbers: ImageArray = np.round(((pixels + 0.5) * scale - 0.5) * 16.0).astype(np.int32)
    return numbers


def _on_field(lines: LineCalibration, field: FieldModel) -> ImageArray:
    """The field from above with all points where mirror and poses put them."""
    canvas, view = draw_field(field), field_view(field)
    good = lines.certainty.residuals < WIDTHS[-1]
    start = 0
    for pose, pixels in zip(lines.poses, lines.pixels, strict=True):
        own = good[start : start + len(pixels)]
        start += len(pixels)
        places = view.picture_from_field(pose.transform(lines.shape.ground(pixels)))
        for place, on_line in zip(places, own, strict=True):
            if np.all(np.abs(place) < 1e4):
                cv2.circle(canvas, (round(place[0]), round(place[1])), 3, _ON if on_line else _OFF, -1, cv2.LINE_AA)
        u, v = view.picture_from_field(np.array([[pose.x, pose.y]]))[0]
        cv2.circle(canvas, (round(u), round(v)), 10, (0, 0, 220), 3, cv2.LINE_AA)
    return canvas


def _wide(panel: ImageArray, width: int) -> ImageArray:
    height = round(panel.shape[0] * width / panel.shape[1])
    return np.asarray(cv2.resize(panel, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _titled(panel: ImageArray, title: str) -> ImageArray:
    square: ImageArray = np.full((_SIDE + 40, _SIDE, 3), 24, dtype=np.uint8)
    square[40 : 40 + panel.shape[0], : panel.shape[1]] = panel[:_SIDE, :_SIDE]
    cv2.putText(square, title, (12, 27), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (235, 235, 235), 1, cv2.LINE_AA)
    return square
