"""A drawing of the field: carpet, paint at its true width, marks, goals and poles, seen from above."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from touchline.errors import InputError
from touchline.field.distances import arc_sweep
from touchline.field.model import FieldModel, Goal, Pole
from touchline.geometry import ByteArray, FloatArray

Color = tuple[int, int, int]

CARPET: Color = (58, 124, 44)  # BGR, as all colours here
PAINT: Color = (248, 248, 248)
NET: Color = (84, 146, 72)
RIM: Color = (40, 40, 40)
UNKNOWN: Color = (150, 150, 150)
COLORS: dict[str, Color] = {
    "white": (255, 255, 255),
    "black": (20, 20, 20),
    "blue": (200, 80, 20),
    "yellow": (30, 210, 250),
    "orange": (30, 130, 250),
    "magenta": (180, 40, 200),
    "cyan": (220, 200, 30),
    "red": (40, 40, 210),
    "green": (80, 180, 60),
}
_FINER = 4  # drawn this many times finer, then averaged: anti-aliased to the true coverage
_SHIFT = 6  # OpenCV draws with 6 binary digits below the pixel
_MAX_PIXELS = 30_000_000


@dataclass(frozen=True, slots=True)
class FieldView:
    """How field metres become picture pixels: x to the right, y up, the centre mark in the middle of the picture.

    Pixel coordinates are OpenCV's: the centre of the upper left pixel is (0, 0).
    """

    width: int
    height: int
    pixels_per_metre: float

    def picture_from_field(self, points: npt.ArrayLike) -> FloatArray:
        """Pixels u, v (N, 2) of points (N, 2) in m, field frame."""
        table = np.asarray(points, dtype=np.float64)
        u = 0.5 * (self.width - 1) + self.pixels_per_metre * table[..., 0]
        v = 0.5 * (self.height - 1) - self.pixels_per_metre * table[..., 1]
        return np.stack((u, v), axis=-1)


def field_view(field: FieldModel, pixels_per_metre: float = 50.0, margin_m: float | None = None) -> FieldView:
    """The view of a field with a margin beyond its lines (m); without one the border, and no less than the goals need.

    Raises InputError for a scale that makes no picture.
    """
    if not (math.isfinite(pixels_per_metre) and pixels_per_metre > 0.0):
        raise InputError(f"field drawing: expected a positive number of pixels per metre, found {pixels_per_metre}")
    need_x = max((abs(goal.x) + goal.depth for goal in field.goals), default=0.0)
    need_y = max((abs(pole.y) + pole.diameter for pole in field.poles), default=0.0)
    margin = field.border if margin_m is None else margin_m
    half_x = 0.5 * field.length + margin
    half_y = 0.5 * field.width + margin
    if margin_m is None:
        half_x, half_y = max(half_x, need_x + 0.1), max(half_y, need_y + 0.1)
    width, height = (max(1, math.ceil(2.0 * half * pixels_per_metre)) for half in (half_x, half_y))
    if width * height > _MAX_PIXELS:
        raise InputError(f"field drawing: {pixels_per_metre:g} pixels per metre make a picture of {width} x {height}")
    return FieldView(width, height, float(pixels_per_metre))


def draw_field(field: FieldModel, pixels_per_metre: float = 50.0, margin_m: float | None = None) -> ByteArray:
    """The field from above as a BGR picture uint8 (H, W, 3), in the view of `field_view` with the same arguments.

    Raises InputError for a scale that makes no picture.
    """
    view = field_view(field, pixels_per_metre, margin_m)
    # Strips bound the memory of the finer canvas, which is 16 times the picture.
    rows = max(1, 4_000_000 // (view.width * _FINER * _FINER))
    picture = np.empty((view.height, view.width, 3), dtype=np.uint8)
    for top in range(0, view.height, rows):
        height = min(rows, view.height - top)
        canvas = _Canvas(view, top, height)
        for goal in field.goals:
            _draw_net(canvas, goal)
        _draw_paint(canvas, field)
        for goal in field.goals:
            _draw_posts(canvas, goal)
        for pole in field.poles:
            _draw_pole(canvas, pole)
        picture[top : top + height] = cv2.resize(canvas.pixels, (view.width, height), interpolation=cv2.INTER_AREA)
    return picture


class _Canvas:
    """Some rows of the picture, drawn finer."""

    def __init__(self, view: FieldView, top: int, height: int) -> None:
        self._view = view
        self._top = top
        self.rim_m = 0.5 / (view.pixels_per_metre * _FINER)  # OpenCV fills the pixels of the outline, too
        self.pixels = np.full((height * _FINER, view.width * _FINER, 3), CARPET, dtype=np.uint8)

    def fill(self, outlines: list[FloatArray], color: Color) -> None:
        """Fill polygons (M, 2) in m, field frame; one inside another is a hole."""
        fixed = []
        for outline in outlines:
            coarse = self._view.picture_from_field(outline) - (0.0, self._top)
            fine = (coarse + 0.5) * _FINER - 0.5  # pixel centres, not corners, have whole coordinates
            fixed.append(np.round(fine * 2**_SHIFT).astype(np.int32))
        cv2.fillPoly(self.pixels, fixed, color, cv2.LINE_8, _SHIFT)


def _draw_paint(canvas: _Canvas, field: FieldModel) -> None:
    half = max(0.5 * field.line_width - canvas.rim_m, 0.0)
    for x1, y1, x2, y2 in field.segments:
        along = np.array((x2 - x1, y2 - y1)) / math.hypot(x2 - x1, y2 - y1) * half
        aside = np.array((-along[1], along[0]))
        start, end = np.array((x1, y1)) - along, np.array((x2, y2)) + along
        canvas.fill([np.array((start + aside, end + aside, end - aside, start - aside))], PAINT)
    for cx, cy, radius in field.circles:
        outlines = [_bow(cx, cy, radius + half, 0.0, 2.0 * math.pi)]
        if radius > half:
            outlines.append(_bow(cx, cy, radius - half, 0.0, 2.0 * math.pi))
        canvas.fill(outlines, PAINT)
    for cx, cy, radius, start, end in field.arcs:
        turn, inner = (
            (start, arc_sweep(start, end)),
            max(radius - half, 0.0),
        )  # arcs end where they end, unlike segments
        canvas.fill([np.concatenate((_bow(cx, cy, radius + half, *turn), _bow(cx, cy, inner, *turn)[::-1]))], PAINT)
    for cx, cy, diameter in field.discs:
        canvas.fill([_bow(cx, cy, max(0.5 * diameter - canvas.rim_m, 0.0), 0.0, 2.0 * math.pi)], PAINT)


def _draw_net(canvas: _Canvas, goal: Goal) -> None:
    outwards = math.copysign(goal.depth, goal.x)
    canvas.fill([_box(goal.x, goal.x + outwards, min(goal.y_posts), max(goal.y_posts))], NET)


def _draw_posts(canvas: _Canvas, goal: Goal) -> None:
    half = 0.5 * goal.post_width
    for y in goal.y_posts:
        for size, color in ((1.3 * half, RIM), (half, COLORS.get(goal.color, UNKNOWN))):
            if goal.post_shape == "square":
                canvas.fill([_box(goal.x - size, goal.x + size, y - size, y + size)], color)
            else:
                canvas.fill([_bow(goal.x, y, size, 0.0, 2.0 * math.pi)], color)


def _draw_pole(canvas: _Canvas, pole: Pole) -> None:
    """The bands as rings, the lowest outermost."""
    canvas.fill([_bow(pole.x, pole.y, 0.56 * pole.diameter, 0.0, 2.0 * math.pi)], RIM)
    for number, band in enumerate(pole.bands_from_ground):
        share = 1.0 - number / len(pole.bands_from_ground)
        outline = _bow(pole.x, pole.y, 0.5 * pole.diameter * share, 0.0, 2.0 * math.pi)
        canvas.fill([outline], COLORS.get(band, UNKNOWN))


def _box(x1: float, x2: float, y1: float, y2: float) -> FloatArray:
    return np.array(((x1, y1), (x2, y1), (x2, y2), (x1, y2)))


def _bow(cx: float, cy: float, radius: float, start: float, sweep: float) -> FloatArray:
    angles = start + np.linspace(0.0, sweep, max(24, math.ceil(sweep * radius / 0.02)))
    return np.column_stack((cx + radius * np.cos(angles), cy + radius * np.sin(angles)))
