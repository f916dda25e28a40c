"""How bright the carpet and its paint are: lamps, sun, contact shadows, pile, wear and seams.

Most pixels see open carpet: nothing painted, standing or shadowed near. They are done in one short loop; the rest goes the
long way (`tracing`, `shade_ground`, `upright_shading`).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.geometry import FloatArray
from touchline.simulation.carpet import FIRST_TEXEL_M, LEVELS, TILE_TEXELS
from touchline.simulation.illumination import (
    FLAGS_PER_M,
    HAS_PAINT,
    HAS_SEAM,
    NEAR_BODY,
    PAINT_AROUND,
    PAINT_NEAR,
    SUN_EDGE,
    SUNLIT,
    contact_shadow,
    light_at,
    sun_at,
)
from touchline.simulation.paint import MIDDLE_MARGIN_M, TIGHT_MARGIN_M, paint_at
from touchline.simulation.solids import SECTORS
from touchline.simulation.tracing import CARPET

EDGE_FLAG = 1 << 30  # labels: a pixel that needs supersampling whatever its neighbours are
SUN_FLAG = 1 << 29
GROUND_LABEL = 1
SEAM_M = 0.012  # width of a seam between two strips of carpet
PILE = 0.13  # standard deviation of the pile's brightness at its finest texel
_SMALLEST = np.uint32(TILE_TEXELS >> (LEVELS - 1))


@njit(cache=True, error_model="numpy", inline="always")
def pile_at(pyramid: npt.NDArray[np.float32], x: float, y: float, square: float) -> float:
    """Brightness of the pile (mean 0) at a point, smoothed to a footprint of that square (m^2): bilinear in the level

    whose texel is the next larger.
    """
    start, size, texel = np.uint32(0), np.uint32(TILE_TEXELS), FIRST_TEXEL_M
    while texel * texel < square and size > _SMALLEST:
        start = np.uint32(start + size * size)
        size = np.uint32(size >> np.uint32(1))
        texel *= 2.0
    mask = np.uint32(size - np.uint32(1))
    scale = 1.0 / texel
    fx, fy = x * scale + 65536.0, y * scale + 65536.0
    i, j = np.uint32(fx), np.uint32(fy)
    a, b = fx - i, fy - j
    low, high = np.uint32(start + (j & mask) * size), np.uint32(start + (np.uint32(j + 1) & mask) * size)
    i0, i1 = i & mask, np.uint32(i + 1) & mask
    top = pyramid[low + i0] * (1.0 - a) + pyramid[low + i1] * a
    bottom = pyramid[high + i0] * (1.0 - a) + pyramid[high + i1] * a
    return float(top * (1.0 - b) + bottom * b)


@njit(cache=True, error_model="numpy")
def shade_open_carpet(
    cast: npt.NDArray[np.float32],
    total: int,
    first_body: FloatArray,
    room: FloatArray,
    flags: npt.NDArray[np.uint8],
    flag_frame: FloatArray,
    light: npt.NDArray[np.float32],
    light_frame: FloatArray,
    carpet: FloatArray,
    pyramid: npt.NDArray[np.float32],
    sun_level: float,
    pixel_angle: float,
    radiance: npt.NDArray[np.float32],
    labels: npt.NDArray[np.int32],
    rest: npt.NDArray[np.int32],
    ground: npt.NDArray[np.int32],
    ground_hits: npt.NDArray[np.float32],
) -> tuple[int, int]:
    """Fill radiance (N, 3) and labels (N,) of rays that end on open carpet; return how many others there are of two sorts.

    cast (8, >= N): the rays, see `cast_rays`; total: N. ground: rays that end on the carpet, but not in the open (their
    ground_hits are filled as by `trace_rays`); rest: all others. first_body (512,): distance (m) of the first body in
    each sector; room: see `trace_rays`.
    """
    count, ground_count = 0, 0
    grain_scale = carpet[4] * PILE
    footprint = 0.49 * pixel_angle * pixel_angle
    middle, far = TIGHT_MARGIN_M / (0.37 * pixel_angle), MIDDLE_MARGIN_M / (0.37 * pixel_angle)
    for i in range(total):
        s = float(cast[6, i])
        ux, uy = float(cast[3, i]), float(cast[4, i])
        x, y = cast[0, i] + s * ux, cast[1, i] + s * uy
        if abs(x) < room[0] and abs(y) < room[1] and s < first_body[min(int(cast[7, i]), SECTORS - 1)]:
            oz, square = float(cast[2, i]), s * s
            column, row = np.uint32((x - flag_frame[0]) * FLAGS_PER_M), np.uint32((y - flag_frame[1]) * FLAGS_PER_M)
            flag = flags[row, column] & 0xFF
            reach = (square + oz * oz) / oz  # paint further from the cell than a third of a pixel cannot matter
            if reach < far:
                flag &= 0xFF - PAINT_AROUND
            if reach < middle:
                flag &= 0xFF - PAINT_NEAR
            if flag != 0 and flag != SUNLIT:
                n, ground_count = ground_count, ground_count + 1
                ground[n] = i
                ground_hits[n, 0], ground_hits[n, 1], ground_hits[n, 3] = x, y, s
                ground_hits[n, 4], ground_hits[n, 5], ground_hits[n, 6] = ux, uy, cast[5, i]
                continue
            level = light_at(light, light_frame, 1, x, y)
            label = GROUND_LABEL
            if flag == SUNLIT:
                level *= 1.0 + sun_level / light_at(light, light_frame, 0, x, y)
                label |= SUN_FLAG
            grain = pile_at(pyramid, x, y, footprint * s * reach)
            level *= 1.0 + grain_scale * grain
            radiance[i, 0] = carpet[0] * level
            radiance[i, 1] = carpet[1] * level
            radiance[i, 2] = carpet[2] * level
            labels[i] = label
            continue
        rest[count] = i
        count += 1
    return count, ground_count


@njit(cache=True, error_model="numpy")
def shade_ground(
    rest: npt.NDArray[np.int32],
    hits: npt.NDArray[np.float32],
    codes: npt.NDArray[np.int32],
    flags: npt.NDArray[np.uint8],
    light: npt.NDArray[np.float32],
    light_frame: FloatArray,
    shapes: FloatArray,
    starts: npt.NDArray[np.int32],
    items: npt.NDArray[np.int16],
    paint_frame: FloatArray,
    paints: FloatArray,
    carpet: FloatArray,
    pyramid: npt.NDArray[np.float32],
    casters: FloatArray,
    caster_cells: npt.NDArray[np.int16],
    sun: FloatArray,
    windows: FloatArray,
    pixel_angle: float,
    radiance: npt.NDArray[np.float32],
    labels: npt.NDArray[np.int32],
) -> None:
    """Fill radiance (N, 3) and labels (N,) of the rays in rest whose code is CARPET (all of them if codes is empty).

    carpet (5,): colour, seam spacing, contrast; paints (P, 3) colours; the other arrays: see the functions that read them.
    """
    for n in range(len(rest)):
        if len(codes) > 0 and codes[n] != CARPET:
            continue
        i = rest[n]
        x, y, s = float(hits[n, 0]), float(hits[n, 1]), float(hits[n, 3])
        height = -s * hits[n, 6]
        wide = s * pixel_angle
        deep = pixel_angle * (height * height + s * s) / height
        flag = flags[np.uint32((y - paint_frame[1]) * FLAGS_PER_M), np.uint32((x - paint_frame[0]) * FLAGS_PER_M)]
        paint, label, level = -1, GROUND_LABEL, 1.0
        if flag & (HAS_PAINT | PAINT_NEAR | PAINT_AROUND):
            paint, edge = paint_at(shapes, starts, items, paint_frame, x, y)
            if edge < 0.37 * deep or deep > 0.8:
                label |= EDGE_FLAG
        if flag & NEAR_BODY:
            level = contact_shadow(casters, caster_cells, paint_frame, x, y)
        sunlit = flag & SUNLIT != 0 and (flag & SUN_EDGE == 0 or sun_at(sun, windows, casters, x, y, 0.0))
        grain = carpet[4] * PILE * pile_at(pyramid, x, y, 0.49 * wide * deep)
        open_level = light_at(light, light_frame, 0, x, y)
        level *= open_level
        if sunlit:
            level += sun[0]
            label |= SUN_FLAG
        if paint >= 0:
            level *= 1.0 + 0.25 * grain
            for c in range(3):
                radiance[i, c] = paints[paint, c] * level
        else:
            level *= (1.0 + grain) * light_at(light, light_frame, 1, x, y) / open_level
            if flag & HAS_SEAM:
                level *= _seam(carpet, x, wide, deep, float(hits[n, 4]), float(hits[n, 5]))
            for c in range(3):
                radiance[i, c] = carpet[c] * level
        labels[i] = label


@njit(cache=True, error_model="numpy")
def _seam(carpet: FloatArray, x: float, wide: float, deep: float, ux: float, uy: float) -> float:
    """A thin dark seam between strips of carpet across the field's length, box-filtered over the pixel's footprint."""
    strip = x / carpet[3] + 0.37
    offset = (strip - np.round(strip)) * carpet[3]
    width = max(abs(ux) * deep + abs(uy) * wide, 1e-6)
    dark = min(offset + 0.5 * width, 0.5 * SEAM_M) - max(offset - 0.5 * width, -0.5 * SEAM_M)
    return 1.0 - 0.4 * max(dark, 0.0) / width
