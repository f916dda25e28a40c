"""What stands upright in the colours of posts and poles (section 4.3): sums of these along the azimuths of the rays.

What stands upright lies at one azimuth of the camera's rays, whatever the lens and the lean: every cell contributes to
the sum of its azimuth. Maxima are looked at more closely: how high and wide they are, in which order their colours
come. Their axis and their foot are found in the whole image.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.field import FieldModel
from touchline.geometry import FloatArray
from touchline.perception.line_graph.colour_classes import (
    BLUE,
    CELL_PX,
    CLASSES,
    FIRST_WHITE,
    FULL,
    YELLOW,
    ColourClasses,
    CountArray,
)
from touchline.perception.line_graph.image_plane import ImagePlane, plane_from_pixel, transformed
from touchline.perception.line_graph.profiles import Pixels, is_carpet
from touchline.perception.line_graph.structure import Structure
from touchline.types import Colors, ImageArray

COLOURS = {"yellow": YELLOW, "blue": BLUE}
_NAMES = {code: name for name, code in COLOURS.items()}
_BIN_PX = 6.0
_FILLED = 0.25  # share of colour from which on a cell counts
_FEWEST_CELLS = 3
_NEARBY, _STANDS_OUT = 10, 0.3  # bins to each side, and of the most of these what stands out
_GAP_ROWS = 2
_GOES_ON = 0.5  # of a colour's usual amount in a row: with less of it another band begins
_LEAST_HEIGHT, _MOST_WIDTH = 0.5, 2.2  # of what is expected
_MOST_BESIDE = 0.8  # of its rows: its colour may go on there, a crossbar or something behind
_LONG_ROWS = 9  # from so many rows on a band has two at least
_EQUAL_BANDS = 2.0
_MOST, _MOST_BANDS = 20, 5
_U, _V, _HEIGHT, _CUT, _BANDS = range(5)  # columns of what is found; the colours of the bands follow
_LOW_ROWS, _PER_ROW = 10, 2  # rows of cells that tell the axis, and rows of pixels in each
_ACROSS = (-0.3, -0.15, 0.0, 0.15, 0.3)  # of the width: where it is looked for its foot
_BELOW_PX = 9  # down to here there is the ground below the foot


class Upright(NamedTuple):
    """Something upright: where its foot meets the ground (m, robot frame), its pixel, its colours from the ground up.

    cut: whether it leaves the image at the top. seen_m: how high its lowest colour reaches.
    """

    place: FloatArray
    pixel: FloatArray
    colors: Colors
    cut: bool = False
    seen_m: float = 0.0


def coloured_uprights(
    pixels: Pixels, classes: ColourClasses, structure: Structure, plane: ImagePlane, field: FieldModel
) -> list[Upright]:
    """Everything upright in the colours of the field's posts and poles; feet are those of their front."""
    coloured = [post for post in field.posts if set(post.colors_from_ground) & set(COLOURS)]
    if not coloured:
        return []
    limits = np.array([min(post.height for post in coloured), max(post.diameter for post in coloured)])
    found = np.empty((_MOST, _BANDS + 1 + _MOST_BANDS))
    count = _find(pixels, classes.table, structure.counts, structure.ends, plane, limits, found)
    uprights = []
    for row in found[:count]:
        x, y = plane_from_pixel(plane.lens, row[_U], row[_V])
        place = np.array(transformed(plane.ground, x, y))
        colors = tuple(_NAMES[int(code)] for code in row[_BANDS + 1 : _BANDS + 1 + int(row[_BANDS])])
        uprights.append(Upright(place, row[:2].copy(), colors, bool(row[_CUT]), float(row[_HEIGHT])))
    return uprights


@njit(cache=True, error_model="numpy")
def _find(
    pixels: Pixels,
    table: npt.NDArray[np.uint8],
    counts: CountArray,
    ends: FloatArray,
    plane: ImagePlane,
    limits: FloatArray,
    found: FloatArray,
) -> int:
    """Look for uprights; limits: least height, greatest diameter (m). Fills rows of found, and returns how many."""
    rows, columns = counts.shape[1], counts.shape[2]
    off = np.full((rows, columns), np.nan)
    middle = _azimuth(plane, plane.lens.pinhole[2], plane.lens.pinhole[3])
    least, most, number = np.inf, -np.inf, 0
    for row in range(rows):
        for column in range(columns):
            if np.int64(counts[YELLOW, row, column]) + np.int64(counts[BLUE, row, column]) > _FILLED * FULL:
                turn = _azimuth(plane, CELL_PX * (column + 0.5) - 0.5, CELL_PX * (row + 0.5) - 0.5) - middle
                turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
                off[row, column] = turn
                if not math.isnan(turn):
                    least, most, number = min(least, turn), max(most, turn), number + 1
    if number < _FEWEST_CELLS:
        return 0
    step = _BIN_PX / plane.lens.pinhole[0]
    sums = np.zeros(int((most - least) / step) + 1)
    bins = np.full((rows, columns), -1, dtype=np.int64)
    for row in range(rows):
        for column in range(columns):
            if not math.isnan(off[row, column]):
                bins[row, column] = int((off[row, column] - least) / step)
                sums[bins[row, column]] += counts[YELLOW, row, column] + counts[BLUE, row, column]
    sums /= FULL
    first, kept = -1, 0
    for k in range(len(sums) + 1):
        strong = False
        if k < len(sums):
            nearby = sums[max(k - _NEARBY, 0) : k + _NEARBY + 1].max()
            strong = sums[k] > max(_FEWEST_CELLS, _STANDS_OUT * nearby)
        if strong and first < 0:
            first = k
        if not strong and first >= 0:
            mask = (bins >= max(first - 1, 0)) & (bins <= k)  # cells beside the axis may lie in the next bin
            if kept < len(found) and _measure(pixels, table, counts, ends, plane, limits, mask, found[kept]):
                kept += 1
            first = -1
    return kept


@njit(cache=True, error_model="numpy")
def _azimuth(plane: ImagePlane, u: float, v: float) -> float:
    """Direction (rad, robot frame) along the ground of what a pixel sees, above the horizon, too."""
    x, y = plane_from_pixel(plane.lens, u, v)
    h, foot = plane.ground, plane.foot
    w = h[2, 0] * x + h[2, 1] * y + h[2, 2]
    ahead = h[0, 0] * x + h[0, 1] * y + h[0, 2] - foot[0] * w
    return math.atan2(h[1, 0] * x + h[1, 1] * y + h[1, 2] - foot[1] * w, ahead)


@njit(cache=True, error_model="numpy")
def _measure(
    pixels: Pixels,
    table: npt.NDArray[np.uint8],
    counts: CountArray,
    ends: FloatArray,
    plane: ImagePlane,
    limits: FloatArray,
    mask: npt.NDArray[np.bool_],
    out: FloatArray,
) -> bool:
    """What cells (rows, columns) of neighbouring azimuths show, from its foot up; False if it is nothing upright."""
    rows, columns = mask.shape
    # rows of cells from the bottom up: first and last column, which colour there is more of, which row
    spans, size, bottom, top, area, beside = np.empty((rows, 4), dtype=np.int64), 0, -1, -1, 0, 0
    amounts = np.zeros(CLASSES)  # of each colour in a row, and in the mean of those below
    kind, usual = 0, 0.0
    for row in range(rows - 1, -1, -1):
        for colour in (YELLOW, BLUE):
            amounts[colour] = (counts[colour, row] * mask[row]).sum()
        if kind == 0 or amounts[kind] < _GOES_ON * usual:
            kind, usual = (YELLOW if amounts[YELLOW] >= amounts[BLUE] else BLUE), 0.0
        cells = np.flatnonzero(mask[row] & (counts[kind, row] > _FILLED * FULL))
        if not len(cells):
            if bottom >= 0 and top - row >= _GAP_ROWS:
                break
            kind = kind if bottom >= 0 else 0
            continue
        usual = amounts[kind] if usual == 0.0 else 0.7 * usual + 0.3 * amounts[kind]
        bottom, top, area = row if bottom < 0 else bottom, row, area + len(cells)
        spans[size] = cells[0], cells[-1], kind, row
        size += 1
        for column in (cells[0] - 2, cells[-1] + 2):
            if 0 <= column < columns:
                beside += counts[kind, row, column] > _FILLED * FULL
    width = area / max(size, 1)
    if size < max(_FEWEST_CELLS, 1.5 * width) or bottom >= rows - 1 or beside > _MOST_BESIDE * size:
        return False
    if not _foot(pixels, table, plane, spans[:size], bottom, out):
        return False
    x, y = plane_from_pixel(plane.lens, out[_U], out[_V])
    px, py = transformed(plane.ground, x, y)
    away = math.hypot(px - plane.foot[0], py - plane.foot[1])
    column = min(max(int(out[_U] / CELL_PX), 0), columns - 1)
    if not math.isfinite(away) or rows - bottom > ends[column] + 1.0:
        return False  # above the horizon, or it stands beyond the field
    cells = plane.lens.pinhole[0] / CELL_PX / away
    out[_CUT] = 1.0 if top == 0 else 0.0
    if width > _MOST_WIDTH * limits[1] * cells + 2.0 or (size < _LEAST_HEIGHT * limits[0] * cells and top > 0):
        return False
    top = _bands(spans[:size], out)
    out[_HEIGHT] = _height(plane, out[_U], CELL_PX * top, away)
    return True


@njit(cache=True, error_model="numpy")
def _foot(
    pixels: Pixels,
    table: npt.NDArray[np.uint8],
    plane: ImagePlane,
    spans: npt.NDArray[np.int64],
    bottom: int,
    out: FloatArray,
) -> bool:
    """Pixel of the foot, into out: below it there is ground. spans: of rows of cells from the bottom up."""
    height, width = pixels.image.shape[:2]
    turns, number, wide, seen, below, ground = np.empty(_LOW_ROWS * _PER_ROW), 0, 0.0, 0.0, 0, 0
    for k in range(min(len(spans), _LOW_ROWS)):
        for part in range(_PER_ROW):
            v = CELL_PX * (bottom - k) + 2 + 4 * part
            total, coloured = 0, 0
            for u in range(max(CELL_PX * (spans[k, 0] - 1), 0), min(CELL_PX * (spans[k, 1] + 2), width)):
                if _code(pixels.image, table, u, v) == spans[k, 2]:
                    total, coloured = total + u, coloured + 1
            if coloured >= 3:
                turns[number] = _azimuth(plane, float(total) / coloured, float(v))
                number, wide = number + 1, wide + coloured
    if not number:
        return False
    turn, wide = float(np.median(turns[:number])), wide / number
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
    out[_U], out[_V] = axis, start - 0.5 + seen
    for row in range(int(out[_V]) + 3, min(int(out[_V]) + _BELOW_PX, height)):
        for part in _ACROSS:
            column = round(axis + part * wide)
            ground += is_carpet(pixels, column, row) or _code(pixels.image, table, column, row) >= FIRST_WHITE
    return bool(below >= 3 and 2 * ground > (_BELOW_PX - 3) * len(_ACROSS))


@njit(cache=True)
def _code(image: ImageArray, table: npt.NDArray[np.uint8], u: int, v: int) -> int:
    b, g, r = np.int64(image[v, u, 0]), np.int64(image[v, u, 1]), np.int64(image[v, u, 2])
    return int(table[((b >> 3) << 11) | ((g >> 2) << 5) | (r >> 3)])


@njit(cache=True, error_model="numpy")
def _height(plane: ImagePlane, u: float, v: float, away: float) -> float:
    """How high (m) above the ground a pixel shows what is so far (m) from the camera's foot."""
    x, y = plane_from_pixel(plane.lens, u, v)
    h, foot = plane.ground, plane.foot
    w = h[2, 0] * x + h[2, 1] * y + h[2, 2]  # of the ray's slope downwards
    ahead = h[0, 0] * x + h[0, 1] * y + h[0, 2] - foot[0] * w
    aside = h[1, 0] * x + h[1, 1] * y + h[1, 2] - foot[1] * w
    above = math.sqrt(np.sum((h[0] - foot[0] * h[2]) ** 2))
    height: float = above * (1.0 - away * w / max(math.hypot(ahead, aside), 1e-9))
    return height


@njit(cache=True)
def _bands(spans: npt.NDArray[np.int64], out: FloatArray) -> int:
    """The colours from the ground up, into out, and the highest row of the first; the first alone where they are of
    unequal heights, as a poster behind a post.
    """
    least, top = 1 if len(spans) < _LONG_ROWS else 2, spans[0, 3]
    sizes, count, run = np.zeros(_MOST_BANDS, dtype=np.int64), 0, 0
    for k in range(len(spans)):
        run += 1
        if k + 1 < len(spans) and spans[k + 1, 2] == spans[k, 2]:
            continue
        if count and out[_BANDS + count] == spans[k, 2]:
            sizes[count - 1] += run
        elif (run >= least or count == 0) and count < _MOST_BANDS:
            out[_BANDS + 1 + count], sizes[count] = spans[k, 2], run
            count += 1
        if count == 1:
            top = spans[k, 3]
        run = 0
    unequal = count > 1 and sizes[:count].max() > _EQUAL_BANDS * sizes[:count].min() + 1
    out[_BANDS] = 1 if unequal else count
    return int(top)
