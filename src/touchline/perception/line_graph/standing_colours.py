"""The coloured classes learned from what stands on the carpet: goal posts, poles, balls; not posters behind the field.

Where something coloured stands, carpet lies below its foot and on both sides of it.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from touchline.geometry import BoolArray, ByteArray, FloatArray
from touchline.perception.colour import GREEN as IS_GREEN
from touchline.perception.colour import ColourModel, look_up
from touchline.perception.colour_ellipses import (
    COLOURED,
    FIXED,
    Ellipse,
    Ellipses,
    learned_ellipse,
    nearest_ellipse,
    tinted_chroma,
)
from touchline.types import ImageArray

_MIN_PIXELS = 100  # of one colour; fewer teach nothing
_PRIOR_PIXELS = 200.0  # what the fixed ellipse counts for beside them
_REACH = 1.3  # times the fixed ellipses: a colour that lies half outside is found whole
_MIN_PX = 60  # of one thing
_FOOT = 0.15  # of a thing's height
_BESIDE_PX = 8
_GREEN_BESIDE = 0.5
_LINE_PX = 21  # lines on the carpet are bridged
_SAME_HUE = 0.87  # least cosine, 30 degrees
_MAX_WIDTH_RATIO = 2.0  # times the foot: wider rows are crossbars, or grown together with what is behind


def standing_ellipses(images: Sequence[ImageArray], around: BoolArray, model: ColourModel) -> Ellipses:
    """The ellipses of COLOURED as images (H, W, 3) show them; fixed where too little of a colour stands on the field.

    around: (H, W) all of the field that is looked at. model: carpet and paint.
    """
    coloured = _coloured(model.white)
    things = [thing for image in images for thing in _standing(image, around, model, coloured)]
    return tuple(_ellipse_of([pixels for kind, pixels in things if kind == k], k) for k in range(len(COLOURED)))


def _ellipse_of(things: list[FloatArray], kind: int) -> Ellipse:
    pixels = np.concatenate(things) if things else np.zeros((0, 3))
    return learned_ellipse(pixels, FIXED[kind], _PRIOR_PIXELS) if len(pixels) >= _MIN_PIXELS else FIXED[kind]


def _coloured(white: FloatArray) -> ByteArray:
    """(32, 32, 32) whether a colour (B, G, R each shifted right by 3) beside this paint may be of COLOURED."""
    levels = 8.0 * np.arange(32) + 3.5
    colours = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), axis=-1).reshape(-1, 3)
    return (nearest_ellipse(tinted_chroma(colours, white), FIXED, _REACH) >= 0).astype(np.uint8).reshape(32, 32, 32)


def _standing(
    image: ImageArray, around: BoolArray, model: ColourModel, may_be: ByteArray
) -> list[tuple[int, FloatArray]]:
    """Class (index into COLOURED) and pixels (N, 3) Y, U, V, edges left out, of each coloured thing on the carpet."""
    smooth = np.asarray(cv2.blur(image, (3, 3)), dtype=np.uint8)
    green = (model.classify(smooth) == IS_GREEN) & around
    coloured = look_up(may_be, smooth) & ~green
    _, labels, boxes, _ = cv2.connectedComponentsWithStats(coloured, connectivity=4)
    large = [label for label in range(1, len(boxes)) if boxes[label, cv2.CC_STAT_AREA] >= _MIN_PX]
    if not large:
        return []
    ground = cv2.morphologyEx(green.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((_LINE_PX, _LINE_PX), np.uint8)) > 0
    found = []
    for label in large:
        left, top, width, height, _ = (int(value) for value in boxes[label])
        thing = labels[top : top + height, left : left + width] == label
        standing = _as_wide_as_its_foot(thing, ground, left, top)
        inner = cv2.erode(np.pad(standing, 1).astype(np.uint8), np.ones((3, 3), np.uint8))[1:-1, 1:-1] > 0
        v, u = np.nonzero(inner)
        if len(v):
            found.append(_of_one_colour(tinted_chroma(smooth[v + top, u + left].astype(np.float64), model.white)))
    return found


def _of_one_colour(pixels: FloatArray) -> tuple[int, FloatArray]:
    """The class whose hue pixels (N, 3) Y, U, V of a thing have, and those of that hue: a shine on a ball is orange."""
    u, v = np.median(pixels[:, 1:], axis=0)
    kind = max(range(len(FIXED)), key=lambda k: (FIXED[k].u * u + FIXED[k].v * v) / np.hypot(FIXED[k].u, FIXED[k].v))
    cosine = (pixels[:, 1:] @ (u, v)) / np.maximum(np.hypot(pixels[:, 1], pixels[:, 2]) * np.hypot(u, v), 1e-9)
    return kind, pixels[cosine > _SAME_HUE]


def _as_wide_as_its_foot(thing: BoolArray, ground: BoolArray, left: int, top: int) -> BoolArray:
    """The rows of a thing (h, w) at this place of the image that are hardly wider than its foot; none where it floats.

    ground: (H, W) carpet and the lines on it.
    """
    height = len(thing)
    rows = max(round(_FOOT * height), 2)
    columns = np.flatnonzero(thing[-rows:].any(axis=0))
    first, last, bottom = left + int(columns[0]), left + int(columns[-1]) + 1, top + height
    beside = (
        ground[bottom - rows : bottom, max(first - _BESIDE_PX, 0) : max(first - 1, 0)],
        ground[bottom - rows : bottom, last + 1 : last + _BESIDE_PX],
        ground[bottom + 1 : bottom + _BESIDE_PX, first:last],
    )
    if not all(part.size and part.mean() >= _GREEN_BESIDE for part in beside):
        return np.zeros_like(thing)
    return thing & (thing.sum(axis=1) <= _MAX_WIDTH_RATIO * len(columns))[:, np.newaxis]
