"""What stands upright in the colours of posts and poles (section 4.3): sums of these along the azimuths of the rays.

What stands upright lies at one azimuth of the camera's rays, whatever the lens and the lean: every cell contributes to
the sum of its azimuth. Maxima are looked at more closely: how high and wide they are, in which order their colours
come. Their axis and their foot are found in the whole image.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.field import FieldModel
from touchline.geometry import ByteArray, FloatArray, IntArray
from touchline.perception.line_graph.colour_classes import (
    BLUE,
    CELL_PX,
    FIRST_WHITE,
    FULL,
    YELLOW,
    ColourClasses,
    CountArray,
)
from touchline.perception.line_graph.image_plane import ImagePlane, ground_from_pixel, plane_from_pixel, transformed
from touchline.perception.line_graph.profiles import Pixels, is_carpet
from touchline.perception.line_graph.structure import Structure
from touchline.types import Colors, ImageArray

COLOURS = {"yellow": YELLOW, "blue": BLUE}
_NAMES = {code: name for name, code in COLOURS.items()}
_BIN_PX = 6.0
_FILLED = 0.25  # share of colour from which on a cell counts
_MIN_CELLS = 3
_NEARBY, _STANDS_OUT = 10, 0.3  # bins to each side, and of the most of these what stands out
_GAP_ROWS = 2
_GOES_ON = 0.5  # of a colour's usual amount in a row: with less of it another band begins
_MIN_HEIGHT, _MAX_WIDTH = 0.5, 2.2  # of what is expected
_MAX_BESIDE = 0.8  # of its rows: its colour may go on there, a crossbar or something behind
_LONG_ROWS = 9  # from so many rows on a band has two at least
_EQUAL_BANDS = 2.0
_MAX_UPRIGHTS, _MAX_BANDS = 20, 5
_U, _V, _X, _Y, _HEIGHT, _WIDTH, _CUT, _BANDS = range(8)  # columns of what is found; the colours of the bands follow
_LOW_ROWS, _PER_ROW = 10, 2  # rows of cells that tell the axis, and rows of pixels in each
_ACROSS = (-0.3, -0.15, 0.0, 0.15, 0.3)  # of the width: where it is looked for its foot
_BELOW_PX = 6  # and as much as a line's paint: what is looked at below the foot
_BESIDE = (-0.8, -0.4, 0.0, 0.4, 0.8)
_CARPET, _GROUND = 0.4, 0.75  # least share of carpet there, and of carpet and paint


class Upright(NamedTuple):
    """Something upright: where its foot meets the ground (m, robot frame), its pixel, its colours from the ground up.

    cut: whether it leaves the image at the top. seen_m: how high its lowest colour reaches. width_m: how wide it looks.
    """

    place: FloatArray
    pixel: FloatArray
    colors: Colors
    cut: bool = False
    seen_m: float = 0.0
    width_m: float = 0.0


def coloured_uprights(
    pixels: Pixels, classes: ColourClasses, structure: Structure, plane: ImagePlane, field: FieldModel
) -> list[Upright]:
    """Everything upright in the colours of the field's posts and poles; feet are those of their front."""
    limits = _limits(field)
    if limits is None:
        return []
    found = np.empty((_MAX_UPRIGHTS, _BANDS + 1 + _MAX_BANDS))
    count = _find(pixels, classes.tables[0], structure.counts, structure.ends, plane, limits, found)
    uprights = []
    for row in found[:count]:
        colors = tuple(_NAMES[int(code)] for code in row[_BANDS + 1 : _BANDS + 1 + int(row[_BANDS])])
        uprights.append(
            Upright(row[[_X, _Y]], row[:2].copy(), colors, bool(row[_CUT]), *row[[_HEIGHT, _WIDTH]].tolist())
        )
    return uprights


@lru_cache(maxsize=16)
def _limits(field: FieldModel) -> tuple[float, float] | None:
    """Least height and greatest diameter (m) of the coloured posts and poles."""
    coloured = [post for post in field.posts if set(post.colors_from_ground) & set(COLOURS)]
    return (min(post.height for post in coloured), max(post.diameter for post in coloured)) if coloured else None


@njit(cache=True, error_model="numpy")
def _find(
    pixels: Pixels,
    table: ByteArray,
    counts: CountArray,
    ends: FloatArray,
    plane: ImagePlane,
    limits: tuple[float, float],
    found: FloatArray,
) -> int:
    """Look for uprights; limits: least height, greatest diameter (m). Fills rows of found, and returns how many."""
    cells, turns, number = np.empty((counts[0].size, 3), dtype=np.int64), np.empty(counts[0].size), 0
    middle = _azimuth(plane, plane.lens.pinhole[2], plane.lens.pinhole[3])
    for row in range(counts.shape[1]):
        for column in range(counts.shape[2]):
            if np.int64(counts[YELLOW, row, column]) + np.int64(counts[BLUE, row, column]) > _FILLED * FULL:
                turn = _azimuth(plane, CELL_PX * (column + 0.5) - 0.5, CELL_PX * (row + 0.5) - 0.5) - middle
                turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
                if not math.isnan(turn):
                    cells[number, 0], cells[number, 1], turns[number] = row, column, turn
                    number += 1
    if number < _MIN_CELLS:
        return 0
    step, least = _BIN_PX / plane.lens.pinhole[0], turns[:number].min()
    sums = np.zeros(int((turns[:number].max() - least) / step) + 1)
    for k in range(number):
        cells[k, 2] = int((turns[k] - least) / step)
        sums[cells[k, 2]] += counts[YELLOW, cells[k, 0], cells[k, 1]] + counts[BLUE, cells[k, 0], cells[k, 1]]
    sums /= FULL
    first, kept = -1, 0
    for k in range(len(sums) + 1):
        strong = False
        if k < len(sums):
            nearby = sums[max(k - _NEARBY, 0) : k + _NEARBY + 1].max()
            strong = sums[k] > max(_MIN_CELLS, _STANDS_OUT * nearby)
        if strong and first < 0:
            first = k
        if not strong and first >= 0:
            # cells beside the axis may lie in the next bin
            mine = cells[:number][(cells[:number, 2] >= first - 1) & (cells[:number, 2] <= k)]
            if kept < len(found) and _measure(pixels, table, counts, ends, plane, limits, mine, found[kept]):
                kept += 1
            first = -1
    return kept


@njit(cache=True, error_model="numpy")
def _azimuth(plane: ImagePlane, u: float, v: float) -> float:
    """Direction (rad, robot frame) along the ground of what a pixel sees, above the horizon, too."""
    ahead, aside, _ = _ray(plane, u, v)
    return math.atan2(aside, ahead)


@njit(cache=True, error_model="numpy")
def _ray(plane: ImagePlane, u: float, v: float) -> tuple[float, float, float]:
    """A pixel's ray from the camera's foot: ahead and aside along the ground, and downwards, each by a scale."""
    x, y = plane_from_pixel(plane.lens, u, v)
    h, foot = plane.ground, plane.foot
    w = h[6] * x + h[7] * y + h[8]
    ahead = h[0] * x + h[1] * y + h[2] - foot[0] * w
    return ahead, h[3] * x + h[4] * y + h[5] - foot[1] * w, w


@njit(cache=True, error_model="numpy")
def _measure(
    pixels: Pixels,
    table: ByteArray,
    counts: CountArray,
    ends: FloatArray,
    plane: ImagePlane,
    limits: tuple[float, float],
    cells: IntArray,
    out: FloatArray,
) -> bool:
    """What cells (N, 3), row by row, of neighbouring azimuths show, from its foot up; False: nothing upright."""
    rows, columns = counts.shape[1], counts.shape[2]
    # rows of cells from the bottom up: first and last column, which colour there is more of, which row
    spans, size, bottom, top, area, beside = np.empty((rows, 4), dtype=np.int64), 0, -1, -1, 0, 0
    kind, usual, end = 0, 0.0, len(cells)
    while end > 0:
        row, start, yellow, blue = cells[end - 1, 0], end, 0, 0
        while start > 0 and cells[start - 1, 0] == row:
            start -= 1
            yellow, blue = yellow + counts[YELLOW, row, cells[start, 1]], blue + counts[BLUE, row, cells[start, 1]]
        if kind == 0 or (yellow if kind == YELLOW else blue) < _GOES_ON * usual:
            kind, usual = (YELLOW if yellow >= blue else BLUE), 0.0
        amount = 1.0 * (yellow if kind == YELLOW else blue)
        first, last, inside = -1, -1, 0
        for k in range(start, end):
            if counts[kind, row, cells[k, 1]] > _FILLED * FULL:
                first, last, inside = cells[k, 1] if first < 0 else first, cells[k, 1], inside + 1
        end = start
        if not inside:
            continue
        if bottom >= 0 and top - row > _GAP_ROWS:
            break
        usual = amount if usual == 0.0 else 0.7 * usual + 0.3 * amount
        bottom, top, area = row if bottom < 0 else bottom, row, area + inside
        spans[size, 0], spans[size, 1], spans[size, 2], spans[size, 3] = first, last, kind, row
        size += 1
        for column in (first - 2, last + 2):
            if 0 <= column < columns:
                beside += counts[kind, row, column] > _FILLED * FULL
    width = area / max(size, 1)
    if size < max(_MIN_CELLS, 1.5 * width) or bottom >= rows - 1 or beside > _MAX_BESIDE * size:
        return False
    if not _foot(pixels, table, plane, spans[:size], bottom, out):
        return False
    x, y = plane_from_pixel(plane.lens, out[_U], out[_V])
    px, py = out[_X], out[_Y] = transformed(plane.ground, x, y)
    distance = math.hypot(px - plane.foot[0], py - plane.foot[1])
    column = min(max(int(out[_U] / CELL_PX), 0), columns - 1)
    if not math.isfinite(distance) or rows - bottom > ends[column] + 1.0:
        return False  # above the horizon, or it stands beyond the field
    per_m = plane.lens.pinhole[0] / CELL_PX / distance
    out[_CUT] = 1.0 if top == 0 else 0.0
    if width > _MAX_WIDTH * limits[1] * per_m + 2.0 or (size < _MIN_HEIGHT * limits[0] * per_m and top > 0):
        return False
    top = _bands(spans[:size], out)
    out[_HEIGHT] = _height(plane, out[_U], float(CELL_PX * top), distance)
    above = _height(plane, out[_U], out[_V], 0.0)
    out[_WIDTH] *= math.hypot(distance, above) / plane.lens.pinhole[0]
    return True


@njit(cache=True, error_model="numpy")
def _foot(
    pixels: Pixels,
    table: ByteArray,
    plane: ImagePlane,
    spans: IntArray,
    bottom: int,
    out: FloatArray,
) -> bool:
    """Pixel of the foot, into out: below it there is ground. spans: of rows of cells from the bottom up."""
    height, width = pixels.image.shape[:2]
    turns, widths, number, seen, below = np.empty(_LOW_ROWS * _PER_ROW), np.empty(_LOW_ROWS * _PER_ROW), 0, 0.0, 0
    for k in range(min(len(spans), _LOW_ROWS)):
        for half in range(_PER_ROW):
            v = CELL_PX * (bottom - k) + 2 + 4 * half
            total, coloured = 0, 0
            for u in range(max(CELL_PX * (spans[k, 0] - 1), 0), min(CELL_PX * (spans[k, 1] + 2), width)):
                if _code(pixels.image, table, u, v) == spans[k, 2]:
                    total, coloured = total + u, coloured + 1
            if coloured >= 3:
                turns[number] = _azimuth(plane, float(total) / coloured, float(v))
                widths[number] = coloured
                number += 1
    if not number:
        return False
    turn, wide = float(np.median(turns[:number])), float(np.median(widths[:number]))
    axis = 0.5 * CELL_PX * (spans[0, 0] + spans[0, 1] + 1)
    start = CELL_PX * (bottom - 1)
    for v in range(start, min(CELL_PX * (bottom + 3), height)):
        for _ in range(2):  # along the axis, whose azimuth changes by so much per pixel
            here = _azimuth(plane, axis, float(v))
            axis += (turn - here) / (_azimuth(plane, axis + 1.0, float(v)) - here)
        coloured = 0
        for part in _ACROSS:
            column = round(axis + part * wide)
            if not 0 <= column < width:
                return False
            coloured += _code(pixels.image, table, column, v) == spans[0, 2]
        seen, below = seen + coloured / len(_ACROSS), 0 if coloured else below + 1
        if below >= 3:
            break
    out[_U], out[_V], out[_WIDTH] = axis, start - 0.5 + seen, wide
    return below >= 3 and _stands(pixels, table, plane, out)


@njit(cache=True, error_model="numpy")
def _stands(pixels: Pixels, table: ByteArray, plane: ImagePlane, out: FloatArray) -> bool:
    """Whether there is carpet below a foot, and nothing else than a line's paint before it."""
    height, width = pixels.image.shape[:2]
    near, far = ground_from_pixel(plane, out[_U], out[_V] + 1.0), ground_from_pixel(plane, out[_U], out[_V])
    line_px = pixels.width_m / max(math.hypot(far[0] - near[0], far[1] - near[1]), 1e-6)
    first, carpet, pale, number = int(out[_V]) + 3, 0, 0, 0
    for row in range(first, min(first + int(2.0 * line_px) + _BELOW_PX, height)):
        for part in _BESIDE:
            column = round(out[_U] + part * out[_WIDTH])
            if 0 <= column < width:
                green = is_carpet(pixels, float(column), float(row))
                carpet += green
                pale += not green and _code(pixels.image, table, column, row) >= FIRST_WHITE
                number += 1
    return carpet > _CARPET * number and carpet + pale > _GROUND * number


@njit(cache=True)
def _code(image: ImageArray, table: ByteArray, u: int, v: int) -> int:
    b, g, r = np.int64(image[v, u, 0]), np.int64(image[v, u, 1]), np.int64(image[v, u, 2])
    return int(table[((b >> 3) << 11) | ((g >> 2) << 5) | (r >> 3)])


@njit(cache=True, error_model="numpy")
def _height(plane: ImagePlane, u: float, v: float, distance: float) -> float:
    """How high (m) above the ground a pixel shows what is so far (m) from the camera's foot."""
    ahead, aside, w = _ray(plane, u, v)
    return plane.height * (1.0 - distance * w / max(math.hypot(ahead, aside), 1e-9))


@njit(cache=True)
def _bands(spans: IntArray, out: FloatArray) -> int:
    """The colours from the ground up, into out, and the highest row of the first; the first alone where they are of
    unequal heights, as a poster behind a post.
    """
    least, top = 1 if len(spans) < _LONG_ROWS else 2, spans[0, 3]
    sizes, count, run = np.zeros(_MAX_BANDS, dtype=np.int64), 0, 0
    for k in range(len(spans)):
        run += 1
        if k + 1 < len(spans) and spans[k + 1, 2] == spans[k, 2]:
            continue
        if count and out[_BANDS + count] == spans[k, 2]:
            sizes[count - 1] += run
        elif (run >= least or count == 0) and count < _MAX_BANDS:
            out[_BANDS + 1 + count], sizes[count] = spans[k, 2], run
            count += 1
        if count == 1:
            top = spans[k, 3]
        run = 0
    unequal = count > 1 and sizes[:count].max() > _EQUAL_BANDS * sizes[:count].min() + 1
    out[_BANDS] = 1 if unequal else count
    return int(top)
