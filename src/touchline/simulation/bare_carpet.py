"""Bare carpet, most of every image: rays that no paint, seam, body or edge of the light is near.

They are set apart (`sift_ground`) and shaded in short loops of float32 without branches, which the compiler makes wide.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from touchline.geometry import FloatArray
from touchline.simulation.compiled import uncounted
from touchline.simulation.illumination import (
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
    contact_shadow,
)
from touchline.simulation.paint import MARGIN_M, MIDDLE_MARGIN_M, TIGHT_MARGIN_M
from touchline.simulation.pile import (
    FIRST_TEXEL_M,
    PILE,
    TILE_TEXELS,
    TONE_M,
    past_seam,
    reaches_texels,
    samples_apart,
    two_levels,
)

Float32Array = npt.NDArray[np.float32]
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
def _along(start: Float32Array, length: Float32Array, direction: Float32Array, out: Float32Array) -> None:
    for n in range(len(out)):
        out[n] = start[n] + length[n] * direction[n]


@uncounted
def sift_ground(
    ground: npt.NDArray[np.int32],
    landing: Float32Array,
    cast: Float32Array,
    extents: Float32Array,
    texture: Float32Array,
    flags: npt.NDArray[np.uint8],
    paint_frame: FloatArray,
    carpet: FloatArray,
    sun: FloatArray,
    casters: FloatArray,
    caster_cells: npt.NDArray[np.int16],
    bare: npt.NDArray[np.int32],
    places: Float32Array,
    points: Float32Array,
) -> tuple[int, int, int]:
    """Move those of the rays on the carpet (N,) that see nothing but carpet to `bare`; count the others, these, points.

    Rays through the middles of pixels: see `shade_ground` and `meet_ground`. places (8, N): x, y of each (m), 1 in the
    sun, its first point and how many, share of the lamps' light beside bodies. points (7, 4 N): x, y of points on the
    pile and the square (m^2) it is smoothed over there: one for each ray, or its pixel's four samples.
    """
    left, count, dots = 0, 0, 0
    x0, y0, sunny, first = paint_frame[0], paint_frame[1], sun[0] > 0.0, FIRST_TEXEL_M * FIRST_TEXEL_M
    for n in range(len(ground)):
        i = np.uint32(ground[n])
        x, y, reach, square = float(landing[0, i]), float(landing[1, i]), float(landing[2, i]), float(landing[3, i])
        flag = flags[np.uint32((y - y0) * FLAGS_PER_M), np.uint32((x - x0) * FLAGS_PER_M)] & 0xFF
        watched = HAS_PAINT | HAS_SEAM | (SUN_EDGE if reach < SUN_TIGHT_M else SUN_EDGE | SUN_AROUND)
        if reach >= TIGHT_MARGIN_M:
            watched |= PAINT_NEAR if reach < MIDDLE_MARGIN_M else PAINT_NEAR | PAINT_AROUND
        other = flag & watched != 0 or reach >= MARGIN_M or (sunny and reach >= SUN_MARGIN_M)
        if not other and square < 32.0 * first:
            part = 4.0 * cast[6, i] * extents[2, i] / (cast[8, i] * cast[2, i])
            other = two_levels(square / first, part)
        if not other and carpet[3] > 0.0 and reach > TONE_M:
            deep = extents[2, i]
            aside = abs(cast[3, i]) * deep + abs(cast[4, i]) * (reach - deep)
            other = aside > TONE_M and abs(past_seam(carpet, x)) < aside + TONE_M
        share = 1.0
        if not other and flag & NEAR_BODY:
            share, other = contact_shadow(casters, caster_cells, paint_frame, x, y, reach)
        if other:
            ground[left] = i
            left += 1
            continue
        bare[count] = i
        places[0, count], places[1, count], places[2, count] = x, y, 1.0 if flag & SUNLIT else 0.0
        places[3, count], places[4, count], places[5, count] = dots, 1.0, share
        points[0, dots], points[1, dots], points[2, dots] = x, y, square
        if square <= first:
            ux, uy, stretch = float(cast[3, i]), float(cast[4, i]), float(cast[8, i])
            px, py, qx, qy = samples_apart(
                texture[0, i], texture[1, i], texture[2, i], texture[3, i], stretch, cast[2, i], ux, uy
            )
            if reaches_texels(px, py, qx, qy):
                points[0, dots], points[1, dots] = x + px + qx, y + py + qy
                points[0, dots + 1], points[1, dots + 1] = x + px - qx, y + py - qy
                points[0, dots + 2], points[1, dots + 2] = x - px + qx, y - py + qy
                points[0, dots + 3], points[1, dots + 3] = x - px - qx, y - py - qy
                points[2, dots : dots + 4] = 0.0
                places[4, count] = 4.0
                dots += 3
        dots += 1
        count += 1
    return left, count, dots


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
