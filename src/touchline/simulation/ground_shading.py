"""How bright the carpet and its paint are: lamps, sun, contact shadows, pile, wear, strips and seams."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.geometry import FloatArray
from touchline.simulation.carpet import FIRST_TEXEL_M, LEVELS, TILE_TEXELS
from touchline.simulation.illumination import contact_shadow, light_at, sun_at
from touchline.simulation.paint import paint_at
from touchline.simulation.tracing import CARPET

EDGE_FLAG = 1 << 30  # labels: a pixel that needs supersampling whatever its neighbours are
SUN_FLAG = 1 << 29
_SEAM_M = 0.012  # width of a seam between two strips of carpet
PILE = 0.085  # standard deviation of the pile's brightness at its finest texel


@njit(cache=True)
def pile_at(pyramid: npt.NDArray[np.float32], x: float, y: float, footprint: float) -> float:
    """Brightness of the pile (mean 0) at a point, smoothed to a footprint (m): bilinear in the level that fits."""
    level, texel = 0, FIRST_TEXEL_M
    while texel < footprint and level < LEVELS - 1:
        level += 1
        texel *= 2.0
    fx, fy = x / texel + 1e5, y / texel + 1e5
    i, j = int(fx), int(fy)
    a, b = fx - i, fy - j
    mask = TILE_TEXELS - 1
    i0, i1, j0, j1 = i & mask, (i + 1) & mask, j & mask, (j + 1) & mask
    top = pyramid[level, j0, i0] * (1.0 - a) + pyramid[level, j0, i1] * a
    bottom = pyramid[level, j1, i0] * (1.0 - a) + pyramid[level, j1, i1] * a
    return float(top * (1.0 - b) + bottom * b)


@njit(cache=True)
def shade_ground(
    hits: npt.NDArray[np.float32],
    codes: npt.NDArray[np.int32],
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
    """Fill radiance (N, 3) and labels (N,) where codes say CARPET; carpet (5,): colour, seam spacing, contrast."""
    for i in range(len(codes)):
        if codes[i] != CARPET:
            continue
        x, y, s = float(hits[i, 0]), float(hits[i, 1]), float(hits[i, 3])
        height = -s * hits[i, 6]
        wide = s * pixel_angle
        deep = pixel_angle * (height * height + s * s) / height
        level, brightness = light_at(light, light_frame, x, y)
        level *= contact_shadow(casters, caster_cells, paint_frame, x, y)
        paint, edge = paint_at(shapes, starts, items, paint_frame, x, y)
        label = 2 + paint
        if edge < 0.71 * deep or (deep > 0.4 and edge < 999.0):
            label |= EDGE_FLAG
        if sun_at(sun, windows, casters, x, y, 0.0):
            level += sun[0]
            label |= SUN_FLAG
        grain = carpet[4] * PILE * pile_at(pyramid, x, y, 0.7 * np.sqrt(wide * deep))
        if paint >= 0:
            level *= 1.0 + 0.25 * grain
            for c in range(3):
                radiance[i, c] = paints[paint, c] * level
        else:
            level *= brightness * (1.0 + grain) * _seam(carpet, x, y, wide, deep, hits[i, 4], hits[i, 5])
            for c in range(3):
                radiance[i, c] = carpet[c] * level
        labels[i] = label


@njit(cache=True)
def _seam(carpet: FloatArray, x: float, y: float, wide: float, deep: float, ux: float, uy: float) -> float:
    """Strips of carpet across the field's length: every other one a little darker, a thin dark seam between."""
    if carpet[3] <= 0.0 or carpet[4] <= 0.0:
        return 1.0
    strip = x / carpet[3] + 0.37
    nearest = np.round(strip)
    offset = (strip - nearest) * carpet[3]
    width = max(abs(ux) * deep + abs(uy) * wide, 1e-6)
    inside = min(max(offset / width + 0.5, 0.0), 1.0)  # share of the pixel beyond the seam
    sign = 1.0 if int(nearest) % 2 == 0 else -1.0
    dark = min(offset + 0.5 * width, 0.5 * _SEAM_M) - max(offset - 0.5 * width, -0.5 * _SEAM_M)
    return (1.0 + 0.018 * sign * (2.0 * inside - 1.0)) * (1.0 - 0.3 * max(dark, 0.0) / width)
