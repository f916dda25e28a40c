"""Pictures of what thresholds, hull and rays make of an image (figures 6 and 7 of the IRIS paper)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from touchline.geometry import FloatArray
from touchline.perception.stages import enlarged, enlarged_pixels, points_picture
from touchline.types import ImageArray, LinePoints

if TYPE_CHECKING:
    from touchline.perception.hsv_lines import HsvLineDetector, Masks

_GREEN_PAINT, _WHITE_PAINT, _HULL, _RAY = (70, 140, 50), (245, 245, 245), (40, 200, 255), (200, 200, 60)


def draw_threshold_stages(
    detector: HsvLineDetector, image: ImageArray, masks: Masks, points: LinePoints
) -> dict[str, ImageArray]:
    """Title -> picture (H, W, 3), BGR: green, its hull, white, white in the hull, distances along the rays, points."""
    return {
        "HSV threshold": _painted(image, masks.green, _GREEN_PAINT),
        "convex hull": _hull(image, masks.field),
        "HSL threshold": _painted(image, masks.white, _WHITE_PAINT),
        "bitwise AND": _painted(image, masks.lines, _WHITE_PAINT),
        "distances along rays": _rays(detector, masks, points.pixels),
        "line points": points_picture(image, points),
    }


def _painted(image: ImageArray, mask: ImageArray, paint: tuple[int, int, int]) -> ImageArray:
    picture = (image // 4).astype(np.uint8)
    picture[mask > 0] = paint
    return picture


def _hull(image: ImageArray, field: ImageArray) -> ImageArray:
    outlines, _ = cv2.findContours(field, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    picture = enlarged(image)
    cv2.polylines(picture, [enlarged_pixels(outline[:, 0]) for outline in outlines], True, _HULL, 2, cv2.LINE_AA)
    return picture


def _rays(detector: HsvLineDetector, masks: Masks, pixels: FloatArray) -> ImageArray:
    """A stroke from the robot's rim to every point, over the white that the rays cross."""
    picture = enlarged(_painted(np.zeros((*masks.lines.shape, 3), dtype=np.uint8), masks.lines, _WHITE_PAINT))
    center = np.array(detector.camera.center)
    offset = pixels - center
    rims = center + offset * (detector.camera.inner_radius_px / np.hypot(*offset.T))[:, np.newaxis]
    for rim, point in zip(enlarged_pixels(rims), enlarged_pixels(pixels), strict=True):
        cv2.line(picture, rim.tolist(), point.tolist(), _RAY, 1, cv2.LINE_AA)
    return picture
