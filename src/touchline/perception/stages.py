"""What the pictures of a detector's steps are drawn with: colours, masks, paths and points over an image."""

from collections.abc import Iterable

import cv2
import numpy as np

from touchline.geometry import BoolArray, FloatArray, Int32Array
from touchline.types import ImageArray

Paint = tuple[int, int, int]
"""B, G, R."""
Legend = list[tuple[str, Paint]]
"""What each paint of a picture means."""
GREEN_PAINT, WHITE_PAINT, BODY_PAINT = (70, 140, 50), (245, 245, 245), (90, 60, 120)
RAY_PAINT, CIRCLE_PAINT, BOUNDARY_PAINT, POINT_PAINT = (200, 200, 60), (200, 120, 60), (40, 200, 255), (60, 60, 255)
SHIFT = 4
"""OpenCV draws with so many binary digits below the pixel."""
_ZOOM = 2
_LEGEND = 0.8 / 960.0  # of a picture's width: its words can be read where it is shown 440 px wide
_PAPER, _INK, _RIM = 24, (235, 235, 235), (110, 110, 110)


def painted(image: ImageArray, *layers: tuple[BoolArray, Paint]) -> ImageArray:
    """The image (H, W, 3) darkened, and what each mask (H, W) covers in its paint, the last on top."""
    picture = (image // 4).astype(np.uint8)
    for mask, paint in layers:
        picture[mask] = paint
    return picture


def enlarged(image: ImageArray, zoom: float = _ZOOM) -> ImageArray:
    """The image at twice its size, or so many times, for what is finer than a pixel."""
    return cv2.resize(image, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_CUBIC).astype(np.uint8)


def fixed_point(pixels: FloatArray, zoom: float) -> Int32Array:
    """Pixels (N, 2) in an enlarged image as OpenCV's fixed-point numbers; pixel centres stay pixel centres."""
    return np.round(((pixels + 0.5) * zoom - 0.5) * 2**SHIFT).astype(np.int32)


def titled(panel: ImageArray, title: str, size: int) -> ImageArray:
    """A panel in the corner of a square of this size (px), under its title."""
    square: ImageArray = np.full((size + 40, size, 3), _PAPER, dtype=np.uint8)
    height, width = min(panel.shape[0], size), min(panel.shape[1], size)
    square[40 : 40 + height, :width] = panel[:height, :width]
    cv2.putText(square, title, (12, 27), cv2.FONT_HERSHEY_SIMPLEX, 0.55, _INK, 1, cv2.LINE_AA)
    return square


def draw_paths(picture: ImageArray, paths: Iterable[FloatArray], paint: Paint, closed: bool, width: int = 1) -> None:
    """Draw paths (N, 2) of image positions over an enlarged picture."""
    cv2.polylines(picture, [_enlarged_pixels(path) for path in paths], closed, paint, width, cv2.LINE_AA)


def points_picture(image: ImageArray, pixels: FloatArray) -> ImageArray:
    """The image enlarged, a circle about each of pixels (N, 2)."""
    picture = enlarged(image)
    for pixel in _enlarged_pixels(pixels):
        cv2.circle(picture, (int(pixel[0]), int(pixel[1])), 4, POINT_PAINT, 1, cv2.LINE_AA)
    return picture


def with_legend(canvas: ImageArray, entries: Legend) -> ImageArray:
    """A picture (H, W, 3) with what its paints mean in a band below, in as many rows as that takes."""
    if not entries:
        return canvas
    columns = canvas.shape[1]
    size = _LEGEND * columns
    rows: list[Legend] = [[]]
    room = 0
    for text, paint in entries:
        wide = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, 1)[0][0] + round(72 * size)
        if room + wide > columns and rows[-1]:
            rows.append([])
            room = 0
        rows[-1].append((text, paint))
        room += wide
    return np.vstack([canvas, *(_legend_row(row, columns, size) for row in rows)])


def _legend_row(entries: Legend, columns: int, size: float) -> ImageArray:
    band: ImageArray = np.full((max(1, round(70 * size)), columns, 3), _PAPER, dtype=np.uint8)
    x, middle = round(24 * size), band.shape[0] // 2
    for text, paint in entries:
        (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, 1)
        cv2.circle(band, (x, middle), max(3, round(11 * size)), _RIM, -1, cv2.LINE_AA)
        cv2.circle(band, (x, middle), max(2, round(9 * size)), paint, -1, cv2.LINE_AA)
        x += round(24 * size)
        at = (x, middle + height // 2)
        cv2.putText(band, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, _INK, max(1, round(1.5 * size)), cv2.LINE_AA)
        x += width + round(48 * size)
    return band


def _enlarged_pixels(path: FloatArray) -> Int32Array:
    """Image positions (N, 2) as whole pixels of the enlarged picture, whose pixel centres lie half a pixel further."""
    return np.rint(_ZOOM * path + 0.5 * (_ZOOM - 1)).astype(np.int32)
