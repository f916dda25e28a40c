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
    AROUND_PAINT,
    FLAGS_PER_M,
    HAS_PAINT,
    HAS_SEAM,
    NEAR_BODY,
    SUN_EDGE,
    SUNLIT,
    contact_shadow,
    light_at,
    sun_at,
)
from touchline.simulation.paint import TIGHT_MARGIN_M, paint_at
from touchline.simulation.solids import SECTORS, turn_number
from touchline.simulation.tracing import CARPET

EDGE_FLAG = 1 << 30  # labels: a pixel that needs supersampling whatever its neighbours are
SUN_FLAG = 1 << 29
GROUND_LABEL = 1
SEAM_M = 0.012  # width of a seam between two strips of carpet
PILE = 0.085  # standard deviation of the pile's brightness at its finest texel
_MASK = np.uint32(TILE_TEXELS - 1)


@njit(cache=True, error_model="numpy", inline="always")
def pile_at(pyramid: npt.NDArray[np.float32], x: float, y: float, square: float) -> float:
    """Brightness of the pile (mean 0) at a point, smoothed to a footprint of that square (m^2): bilinear in the level

    whose texel is the next larger.
    """
    level, texel = np.uint32(0), FIRST_TEXEL_M
    while texel * texel < square and level < LEVELS - 1:
        level = np.uint32(level + 1)
        texel *= 2.0
    scale = 1.0 / texel
    fx, fy = x * scale + 65536.0, y * scale + 65536.0
    i, j = np.uint32(fx), np.uint32(fy)
    a, b = fx - i, fy - j
    i0, j0, i1, j1 = i & _MASK, j & _MASK, np.uint32(i + 1) & _MASK, np.uint32(j + 1) & _MASK
    top = pyramid[level, j0, i0] * (1.0 - a) + pyramid[level, j0, i1] * a
    bottom = pyramid[level, j1, i0] * (1.0 - a) + pyramid[level, j1, i1] * a
    return float(top * (1.0 - b) + bottom * b)


@njit(cache=True, error_model="numpy")
def shade_open_carpet(
    rays: npt.NDArray[np.float32],
    rows: npt.NDArray[np.int32],
    poses: FloatArray,
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

    ground: rays that end on the carpet, but not in the open (their ground_hits are filled as by `trace_rays`); rest: all
    others.

    first_body (512,): distance (m) of the first body in each sector. See `trace_rays` for rays, rows, poses and room.
    """
    count, ground_count = 0, 0
    grain_scale = carpet[4] * PILE
    footprint = 0.49 * pixel_angle * pixel_angle
    far = TIGHT_MARGIN_M / (0.37 * pixel_angle)
    for i in range(len(rays)):
        p = rows[i]
        rx, ry, rz = rays[i, 3], rays[i, 4], rays[i, 5]
        dz = poses[p, 6] * rx + poses[p, 7] * ry + poses[p, 8] * rz
        if dz < -1e-4:
            qx, qy, qz = rays[i, 0], rays[i, 1], rays[i, 2]
            oz = poses[p, 6] * qx + poses[p, 7] * qy + poses[p, 8] * qz + poses[p, 11]
            dx = poses[p, 0] * rx + poses[p, 1] * ry + poses[p, 2] * rz
            dy = poses[p, 3] * rx + poses[p, 4] * ry + poses[p, 5] * rz
            t = -oz / dz
            sx, sy = t * dx, t * dy
            x = sx + poses[p, 0] * qx + poses[p, 1] * qy + poses[p, 2] * qz + poses[p, 9]
            y = sy + poses[p, 3] * qx + poses[p, 4] * qy + poses[p, 5] * qz + poses[p, 10]
            if abs(x) < room[0] and abs(y) < room[1]:
                square = sx * sx + sy * sy
                body = first_body[min(np.uint32(turn_number(dx, dy) * (SECTORS / 4.0)), SECTORS - 1)]
                column, row = np.uint32((x - flag_frame[0]) * FLAGS_PER_M), np.uint32((y - flag_frame[1]) * FLAGS_PER_M)
                flag = flags[row, column] & 0xFF
                if square + oz * oz < far * oz:  # no paint beyond the cell can matter
                    flag &= 0xFF - AROUND_PAINT
                if square < body * abs(body):
                    s = np.sqrt(square)
                    if flag != 0 and flag != SUNLIT:
                        n, ground_count = ground_count, ground_count + 1
                        ground[n] = i
                        ground_hits[n, 0], ground_hits[n, 1], ground_hits[n, 3] = x, y, s
                        ground_hits[n, 4], ground_hits[n, 5], ground_hits[n, 6] = sx / s, sy / s, -oz / s
                        continue
                    level = light_at(light, light_frame, 1, x, y)
                    label = GROUND_LABEL
                    if flag == SUNLIT:
                        level *= 1.0 + sun_level / light_at(light, light_frame, 0, x, y)
                        label |= SUN_FLAG
                    grain = pile_at(pyramid, x, y, footprint * s * (oz * oz + square) / oz)
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
        if flag & (HAS_PAINT | AROUND_PAINT):
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
