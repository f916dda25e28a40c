"""Pictures of what a detector does with an image, step by step."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from touchline.perception.colour import GREEN, WHITE, ColourModel
from touchline.types import ImageArray, LinePoints

if TYPE_CHECKING:
    from touchline.perception.line_points import LinePointDetector

ZOOM = 2
_GREEN_PAINT, _WHITE_PAINT, _BODY_PAINT = (70, 140, 50), (245, 245, 245), (90, 60, 120)
_RAY, _CIRCLE, _BOUNDARY, _POINT = (200, 200, 60), (200, 120, 60), (40, 200, 255), (60, 60, 255)


def draw_stages(
    detector: LinePointDetector, model: ColourModel, image: ImageArray, points: LinePoints
) -> dict[str, ImageArray]:
    """Title -> picture (H, W, 3), BGR: classes, signal, scan lines, boundary of the field, points.

    The detector has just seen the image: its boundary is that of this image.
    """
    return {
        "colour classes": _classes(detector, model, image),
        "white against this green": _signal(model, image),
        "scan lines": _scan_lines(detector, image),
        "field boundary": _boundary(detector, image),
        "line points": points_picture(image, points),
    }


def _classes(detector: LinePointDetector, model: ColourModel, image: ImageArray) -> ImageArray:
    classes = model.classify(image)
    picture = (image // 4).astype(np.uint8)
    picture[classes == GREEN] = _GREEN_PAINT
    picture[classes == WHITE] = _WHITE_PAINT
    picture[detector.body] = _BODY_PAINT
    return picture


def _signal(model: ColourModel, image: ImageArray) -> ImageArray:
    level = (image @ model.signal) - float(model.green @ model.signal)
    grey = np.clip(64.0 + 160.0 * level, 0, 255).astype(np.uint8)
    return np.repeat(grey[..., np.newaxis], 3, axis=2)


def _scan_lines(detector: LinePointDetector, image: ImageArray) -> ImageArray:
    picture, lines = enlarged(image), detector.scan_lines
    for k, closed in enumerate(lines.closed):
        path = lines.samples[lines.starts[k] : lines.starts[k + 1]]
        cv2.polylines(picture, [enlarged_pixels(path)], bool(closed), _CIRCLE if closed else _RAY, 1, cv2.LINE_AA)
    return picture


def _boundary(detector: LinePointDetector, image: ImageArray) -> ImageArray:
    picture = enlarged(image)
    angles = 2.0 * np.pi * np.arange(len(detector.green_ends_px)) / len(detector.green_ends_px)
    ends = np.column_stack((np.cos(angles), np.sin(angles))) * detector.green_ends_px[:, np.newaxis]
    cv2.polylines(picture, [enlarged_pixels(ends + detector.camera.center)], True, _BOUNDARY, 2, cv2.LINE_AA)
    return picture


def points_picture(image: ImageArray, points: LinePoints) -> ImageArray:
    """The image enlarged, a circle about each point."""
    picture = enlarged(image)
    for pixel in enlarged_pixels(points.pixels):
        cv2.circle(picture, (int(pixel[0]), int(pixel[1])), 4, _POINT, 1, cv2.LINE_AA)
    return picture


def enlarged(image: ImageArray) -> ImageArray:
    """The image at `ZOOM` times its size."""
    large: ImageArray = cv2.resize(image, None, fx=ZOOM, fy=ZOOM, interpolation=cv2.INTER_CUBIC)  # type: ignore[assignment]
    return large


def enlarged_pixels(path: np.ndarray) -> np.ndarray:
    """Image positions (N, 2) as whole pixels of the enlarged picture, whose pixel centres lie half a pixel further."""
    return np.rint(ZOOM * path + 0.5 * (ZOOM - 1)).astype(np.int32)
