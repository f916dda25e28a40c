"""Bare carpet, most of every image: rays that no paint, seam, body or edge of the light is near.

They are found and shaded in short loops of float32 without branches, which the compiler makes wide.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from touchline.geometry import FloatArray
from touchline.simulation.compiled import uncounted
from touchline.simulation.rendering.illumination import (
    FLAGS_PER_M,
    HAS_PAINT,
    HAS_SEAM,
    NEAR_BODY,
    PAINT_AROUND,
    PAINT_NEAR,
    SUN_AROUND,
    SUN_EDGE,
    SUN_MARGIN_M,
    SUN_TIGHT_M,
    SUNLIT,
)
from touchline.simulation.rendering.paint import MARGIN_M, MIDDLE_MARGIN_M, TIGHT_MARGIN_M
from touchline.simulation.rendering.pile import FIRST_TEXEL_M, LEVEL_CHANGES, PILE, SEAM_OFFSET, TILE_TEXELS, TONE_M

Float32Array = npt.NDArray[np.float32]
Int32Array = npt.NDArray[np.int32]
POINT_ROWS, PLACE_ROWS = 7, 8  # of the work space of `shade_bare`


@uncounted
def meet_ground(
    cast: Float32Array, extents: Float32Array, shift: float, texture: Float32Array, count: int, landing: Float32Array
) -> None:
    """Fill landing (4, >= N), where the first `count` rays meet the ground, wherever the carpet ends.

    Rows: x, y (m), how far a pixel reaches from there (m), square (m^2) that its texture is smoothed over.
    """
    s, long = cast[6, :count], landing[3, :count]
    _along(cast[0, :count], s, cast[3, :count], landing[0, :count])
    _along(cast[1, :count], s, cast[4, :count], landing[1, :count])
    _along(extents[2, :count], s, extents[0, :count], landing[2, :count])
    away = np.float32(shift)
    for n in range(count):
        landing[2, n] += away
    for n in range(count):
        long[n] = texture[4, n] * cast[8, n]
    for n in range(count):
        long[n] = np.float32(1.5) * long[n] * long[n]


@uncounted
def find_plain(
    cast: Float32Array,
    extents: Float32Array,
    landing: Float32Array,
    count: int,
    words: npt.NDArray[np.uint32],
    flag_frame: FloatArray,
    carpet: FloatArray,
    sunny: bool,
    flag: Int32Array,
    plain: Int32Array,
) -> None:
    """Fill flag (N,) with the flags of the ground where the first `count` rays meet it, and plain (N,) with 1 where all
    of a pixel surely sees nothing but the pile of one strip of carpet, evenly lit, and else 0.

    words: the flags of the ground's cells, four to a word; flag_frame (4,): x, y (m) of the first, columns, rows.
    """
    x, y, reach, square = landing[0, :count], landing[1, :count], landing[2, :count], landing[3, :count]
    ux, uy, deep = cast[3, :count], cast[4, :count], extents[2, :count]
    columns, rows = np.int32(flag_frame[2]), np.int32(flag_frame[3])
    _cell_at(x, y, np.float32(flag_frame[0]), np.float32(flag_frame[1]), columns, rows, flag[:count])
    _flag_of_cell(words, flag[:count])
    farthest = np.float32(min(MARGIN_M, SUN_MARGIN_M) if sunny else MARGIN_M)
    _nothing_flagged(flag[:count], reach, square, farthest, plain[:count])
    _one_level(square, cast[6, :count], deep, cast[8, :count], cast[2, :count], plain[:count])
    if carpet[3] > 0.0:
        _one_strip(x, ux, uy, deep, reach, np.float32(carpet[3]), plain[:count])


@uncounted
def _cell_at(
    x: Float32Array,
    y: Float32Array,
    x0: np.float32,
    y0: np.float32,
    columns: np.int32,
    rows: np.int32,
    cell: Int32Array,
) -> None:
    """Number of the cell, row by row, that a point lies in or nearest to."""
    per_m, none = np.float32(FLAGS_PER_M), np.float32(0.0)
    last_i, last_j = np.float32(columns - 1), np.float32(rows - 1)
    for n in range(len(cell)):
        i = np.int32(min(max((x[n] - x0) * per_m, none), last_i))
        j = np.int32(min(max((y[n] - y0) * per_m, none), last_j))
        cell[n] = j * columns + i


@uncounted
def _flag_of_cell(words: npt.NDArray[np.uint32], cell: Int32Array) -> None:
    """Replace numbers of cells by their flags."""
    for n in range(len(cell)):
        k = np.uint32(cell[n])
        word = words[k >> np.uint32(2)]
        cell[n] = np.int32((word >> ((k & np.uint32(3)) << np.uint32(3))) & np.uint32(255))


@uncounted
def _nothing_flagged(
    flag: Int32Array, reach: Float32Array, square: Float32Array, farthest: np.float32, plain: Int32Array
) -> None:
    always, none = np.int32(HAS_PAINT | HAS_SEAM | NEAR_BODY | SUN_EDGE), np.int32(0)
    paint_near, paint_around, sun_around = np.int32(PAINT_NEAR), np.int32(PAINT_AROUND), np.int32(SUN_AROUND)
    tight, middle, sun_tight = np.float32(TIGHT_MARGIN_M), np.float32(MIDDLE_MARGIN_M), np.float32(SUN_TIGHT_M)
    first = np.float32(FIRST_TEXEL_M * FIRST_TEXEL_M)
    for n in range(len(plain)):
        watched = always | (paint_near if reach[n] >= tight else none)
        watched |= (paint_around if reach[n] >= middle else none) | (sun_around if reach[n] >= sun_tight else none)
        clear = ((flag[n] & watched) == none) & (reach[n] < farthest) & (square[n] > first)
        plain[n] = np.int32(1) if clear else none


@uncounted
def _one_level(
    square: Float32Array, s: Float32Array, deep: Float32Array, stretch: Float32Array, z: Float32Array, plain: Int32Array
) -> None:
    """Not plain is where the pile is seen at two levels: see `pile.two_levels`."""
    per_first, four = np.float32(1.0 / (FIRST_TEXEL_M * FIRST_TEXEL_M)), np.float32(4.0)
    first, second, third = np.float32(LEVEL_CHANGES[0]), np.float32(LEVEL_CHANGES[1]), np.float32(LEVEL_CHANGES[2])
    for n in range(len(plain)):
        texels = square[n] * per_first
        change = four * s[n] * deep[n] / (stretch[n] * z[n]) * texels
        two = (abs(texels - first) < change) | (abs(texels - second) < change) | (abs(texels - third) < change)
        plain[n] = np.int32(0) if two else plain[n]


@uncounted
def _one_strip(
    x: Float32Array,
    ux: Float32Array,
    uy: Float32Array,
    deep: Float32Array,
    reach: Float32Array,
    spacing: np.float32,
    plain: Int32Array,
) -> None:
    """Not plain is where a wide pixel sees two strips: see `pile.past_seam`."""
    tone, offset, half = np.float32(TONE_M), np.float32(SEAM_OFFSET), np.float32(0.5)
    for n in range(len(plain)):
        aside = abs(ux[n]) * deep[n] + abs(uy[n]) * (reach[n] - deep[n])
        strip = x[n] / spacing + offset
        past = abs(strip - np.floor(strip + half)) * spacing
        plain[n] = np.int32(0) if (aside > tone) & (past < aside + tone) else plain[n]


@uncounted
def lay_out_bare(
    bare: Int32Array, landing: Float32Array, flag: Int32Array, places: Float32Array, points: Float32Array
) -> None:
    """Fill places (8, >= M) and points (7, >= M) of the plain rays that `bare` (M,) lists, see `sift_ground`."""
    count = len(bare)
    _gather(landing[0], bare, places[0, :count])
    _gather(landing[1], bare, places[1, :count])
    _gather(landing[0], bare, points[0, :count])
    _gather(landing[1], bare, points[1, :count])
    _gather(landing[3], bare, points[2, :count])
    sunlit, first = places[2, :count], places[3, :count]
    for n in range(count):
        sunlit[n] = np.float32(1.0) if flag[np.uint32(bare[n])] & np.int32(SUNLIT) else np.float32(0.0)
    for n in range(count):
        first[n] = np.float32(n)
    places[4, :count] = np.float32(1.0)
    places[5, :count] = np.float32(1.0)


@uncounted
def _gather(values: Float32Array, places: Int32Array, out: Float32Array) -> None:
    for n in range(len(out)):
        out[n] = values[np.uint32(places[n])]


@uncounted
def _along(start: Float32Array, length: Float32Array, direction: Float32Array, out: Float32Array) -> None:
    for n in range(len(out)):
        out[n] = start[n] + length[n] * direction[n]


@uncounted
def shade_bare(
    bare: npt.NDArray[np.int32],
    places: Float32Array,
    points: Float32Array,
    dots: int,
    light: Float32Array,
    light_frame: FloatArray,
    carpet: FloatArray,
    pyramid: Float32Array,
    sun: FloatArray,
    radiance: Float32Array,
) -> None:
    """Fill radiance (N, 3) of the rays that `bare` (M,) lists, with places and points of `sift_ground`."""
    count = len(bare)
    look_up_pile(points, dots, pyramid)
    look_up_light(places, count, light, light_frame, float(sun[0]))
    red, green, blue, strength = carpet[0], carpet[1], carpet[2], carpet[4] * PILE
    for n in range(count):
        dot, i = np.uint32(places[3, n]), np.uint32(bare[n])
        grain = float(points[0, dot])
        if places[4, n] > 1.0:
            grain = 0.25 * (
                grain + points[0, dot + np.uint32(1)] + points[0, dot + np.uint32(2)] + points[0, dot + np.uint32(3)]
            )
        level = places[0, n] * (1.0 + strength * grain)
        radiance[i, 0], radiance[i, 1], radiance[i, 2] = red * level, green * level, blue * level


@uncounted
def look_up_pile(points: Float32Array, count: int, pyramid: Float32Array) -> None:
    """`pile.pile_at` for points (7, >= N): x, y and footprint become the brightness in the first row; 4 rows of space.

    Numbers of texels are whole numbers below 2^24, so float32 holds them exactly.
    """
    x, y, square, size = points[0, :count], points[1, :count], points[2, :count], points[3, :count]
    left, low, high = points[4, :count], points[5, :count], points[6, :count]
    _level_size(square, size)
    _texel(x, size, left)
    _texel(y, size, low)
    _part(x, size)
    _part(y, size)
    _next_row(low, size, high)
    _first_in_row(low, size)
    _first_in_row(high, size)
    for n in range(count):
        right = np.uint32(left[n] + np.float32(1.0)) & np.uint32(size[n] - np.float32(1.0))
        i, j, j1 = np.uint32(left[n]), np.uint32(low[n]), np.uint32(high[n])
        top = pyramid[j + i] + (pyramid[j + right] - pyramid[j + i]) * x[n]
        bottom = pyramid[j1 + i] + (pyramid[j1 + right] - pyramid[j1 + i]) * x[n]
        x[n] = top + (bottom - top) * y[n]


@uncounted
def _level_size(square: Float32Array, size: Float32Array) -> None:
    """Texels along the level of the pyramid whose texel is the next larger than each footprint (m^2)."""
    per_square = np.float32(1.0 / FIRST_TEXEL_M**2)
    for n in range(len(size)):
        texels, texel = square[n] * per_square, np.float32(TILE_TEXELS)
        texel = texel if texels <= np.float32(1.0) else np.float32(TILE_TEXELS >> 1)
        texel = texel if texels <= np.float32(4.0) else np.float32(TILE_TEXELS >> 2)
        texel = texel if texels <= np.float32(16.0) else np.float32(TILE_TEXELS >> 3)
        texel = texel if texels <= np.float32(64.0) else np.float32(TILE_TEXELS >> 4)
        texel = texel if texels <= np.float32(256.0) else np.float32(TILE_TEXELS >> 5)
        texel = texel if texels <= np.float32(1024.0) else np.float32(TILE_TEXELS >> 6)
        texel = texel if texels <= np.float32(4096.0) else np.float32(TILE_TEXELS >> 7)
        size[n] = texel if texels <= np.float32(16384.0) else np.float32(TILE_TEXELS >> 8)


@uncounted
def _texel(position: Float32Array, size: Float32Array, texel: Float32Array) -> None:
    """Column or row of the texel that lies before a position (m), in a tile that repeats itself."""
    per_tile = np.float32(1.0 / (FIRST_TEXEL_M * TILE_TEXELS))
    for n in range(len(texel)):
        tiles = np.floor(position[n] * per_tile * size[n])
        texel[n] = tiles - size[n] * np.floor(tiles / size[n])


@uncounted
def _part(position: Float32Array, size: Float32Array) -> None:
    """Replace a position (m) by its smooth weight between two texels."""
    per_tile, two, three = np.float32(1.0 / (FIRST_TEXEL_M * TILE_TEXELS)), np.float32(2.0), np.float32(3.0)
    for n in range(len(size)):
        texels = position[n] * per_tile * size[n]
        part = texels - np.floor(texels)
        position[n] = part * part * (three - two * part)


@uncounted
def _next_row(row: Float32Array, size: Float32Array, after: Float32Array) -> None:
    one, none = np.float32(1.0), np.float32(0.0)
    for n in range(len(after)):
        after[n] = row[n] + one if row[n] + one < size[n] else none


@uncounted
def _first_in_row(row: Float32Array, size: Float32Array) -> None:
    """Replace a row by where it starts in the pyramid."""
    finest, third, half = np.float32(TILE_TEXELS * TILE_TEXELS), np.float32(4.0 / 3.0), np.float32(0.5)
    for n in range(len(size)):
        row[n] = np.floor((finest - size[n] * size[n]) * third + half) + row[n] * size[n]


@uncounted
def look_up_light(places: Float32Array, count: int, light: Float32Array, light_frame: FloatArray, sun: float) -> None:
    """Light on bare carpet at places (8, >= N) of x, y (m), 1 in the sun, of level `sun`: into the first row.

    light: the map of `illumination.light_at`. Row 5 holds the share of the map's light, rows 6 and 7 are space.
    """
    frame_x, frame_y, per_m = np.float32(light_frame[0]), np.float32(light_frame[1]), np.float32(light_frame[2])
    columns, rows = light.shape[1], light.shape[0]
    x, y, sunlit = places[0, :count], places[1, :count], places[2, :count]
    share, i, j = places[5, :count], places[6, :count], places[7, :count]
    _cell_before(x, frame_x, per_m, np.float32(columns - 1.001), i)
    _cell_before(y, frame_y, per_m, np.float32(rows - 1.001), j)
    for n in range(count):
        column, row = np.uint32(i[n]), np.uint32(j[n])
        after, below = np.uint32(column + np.uint32(1)), np.uint32(row + np.uint32(1))
        top = light[row, column, 1] + (light[row, after, 1] - light[row, column, 1]) * x[n]
        bottom = light[below, column, 1] + (light[below, after, 1] - light[below, column, 1]) * x[n]
        level, part = top + (bottom - top) * y[n], share[n]
        if sunlit[n] > 0.0:
            top = light[row, column, 0] + (light[row, after, 0] - light[row, column, 0]) * x[n]
            bottom = light[below, column, 0] + (light[below, after, 0] - light[below, column, 0]) * x[n]
            part += np.float32(sun) / (top + (bottom - top) * y[n])
        x[n] = level * part


@uncounted
def _cell_before(
    position: Float32Array, origin: np.float32, per_m: np.float32, last: np.float32, cell: Float32Array
) -> None:
    """Cell before each position (m), which is replaced by what it lies past it, in cells."""
    none = np.float32(0.0)
    for n in range(len(cell)):
        cells = min(max((position[n] - origin) * per_m, none), last)
        before = np.floor(cells)
        cell[n], position[n] = before, cells - before
