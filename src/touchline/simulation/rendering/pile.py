"""The carpet's pile and seams at a point: what `carpet` makes, smoothed to what a pixel sees of it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.geometry import FloatArray
from touchline.simulation.compiled import uncounted

TILE_TEXELS, LEVELS = 512, 9  # of the pile's pyramid, see `carpet.pile_pyramid`
FIRST_TEXEL_M = 0.006  # its finest level: a tile of 3 m
SEAM_M = 0.012  # width of a seam between two strips of carpet
TONE_M = 0.06  # half the width over which the tone of one strip goes over into the next (the light map's step)
SEAM_OFFSET = 0.37  # of the strips from the middle of the field, in strips
LEVEL_CHANGES = (1.0, 4.0, 16.0)  # squares of texels, in finest ones, between which the pile's look changes notably
PILE = 0.10  # standard deviation of the pile's brightness at its finest texel
_SMALLEST = np.uint32(TILE_TEXELS >> (LEVELS - 1))


@njit(cache=True, error_model="numpy", inline="always")
def pile_at(pyramid: npt.NDArray[np.float32], x: float, y: float, square: float) -> float:
    """Brightness of the pile (mean 0) at a point, smoothed to a footprint of that square (m^2).

    Between the texels of the level whose texel is the next larger, without kinks: samples of one pixel that lie on both
    sides of a texel's middle average to nearly what lies between them.
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
    a, b = a * a * (3.0 - 2.0 * a), b * b * (3.0 - 2.0 * b)
    low, high = np.uint32(start + (j & mask) * size), np.uint32(start + (np.uint32(j + 1) & mask) * size)
    i0, i1 = i & mask, np.uint32(i + 1) & mask
    top = pyramid[low + i0] * (1.0 - a) + pyramid[low + i1] * a
    bottom = pyramid[high + i0] * (1.0 - a) + pyramid[high + i1] * a
    return float(top * (1.0 - b) + bottom * b)


@njit(cache=True, error_model="numpy", inline="always")
def grain_at(
    pyramid: npt.NDArray[np.float32], x: float, y: float, square: float, px: float, py: float, qx: float, qy: float
) -> float:
    """Brightness of the pile in a pixel that sees a point, with samples at (+-px +-qx, +-py +-qy) from it.

    square: of the footprint (m^2). Where the samples are not much closer together than the finest texels, it is their
    mean.
    """
    if square > FIRST_TEXEL_M * FIRST_TEXEL_M or not reaches_texels(px, py, qx, qy):
        return pile_at(pyramid, x, y, square)
    return 0.25 * (
        pile_at(pyramid, x + px + qx, y + py + qy, 0.0) + pile_at(pyramid, x + px - qx, y + py - qy, 0.0)
        + pile_at(pyramid, x - px + qx, y - py + qy, 0.0) + pile_at(pyramid, x - px - qx, y - py - qy, 0.0)
    )  # fmt: skip


@njit(cache=True, error_model="numpy", inline="always")
def samples_apart(
    p_along: float, p_across: float, q_along: float, q_across: float, stretch: float, oz: float, ux: float, uy: float
) -> tuple[float, float, float, float]:
    """px, py, qx, qy (m): a pixel's samples lie on the ground at (+-px +-qx, +-py +-qy) from its middle.

    p, q: the same as angles (rad), see `SampleRays`. The ray starts at a height oz (m), runs along (ux, uy) and ends
    stretch (m) further per radian of elevation.
    """
    across = np.sqrt(stretch * oz)
    p, aside, q, off = p_along * stretch, p_across * across, q_along * stretch, q_across * across
    return p * ux - aside * uy, p * uy + aside * ux, q * ux - off * uy, q * uy + off * ux


@njit(cache=True, error_model="numpy", inline="always")
def samples_within(
    p_along: float,
    p_across: float,
    q_along: float,
    q_across: float,
    deep: float,
    wide: float,
    ux: float,
    uy: float,
    upright: bool,
) -> tuple[float, float, float, float]:
    """`samples_apart`, stretched so that the samples reach deep (m) along (ux, uy) and wide (m) across it.

    Of a camera that leans, whose pixels are turned against their p and q, and without samples at +-p +-q: the corners
    of that rectangle.
    """
    along, across = abs(p_along) + abs(q_along), abs(p_across) + abs(q_across)
    if not upright or along == 0.0 or across == 0.0:
        return deep * ux, deep * uy, -wide * uy, wide * ux
    per_along, per_across = deep / along, wide / across
    p, aside, q, off = p_along * per_along, p_across * per_across, q_along * per_along, q_across * per_across
    return p * ux - aside * uy, p * uy + aside * ux, q * ux - off * uy, q * uy + off * ux


@njit(cache=True, error_model="numpy", inline="always")
def reaches_texels(px: float, py: float, qx: float, qy: float) -> bool:
    """Whether samples at (+-px +-qx, +-py +-qy) lie so far apart (m) that the finest texels differ between them."""
    return bool(max(abs(px) + abs(qx), abs(py) + abs(qy)) >= 0.2 * FIRST_TEXEL_M)


@njit(cache=True, error_model="numpy", inline="always")
def two_levels(texels: float, part: float) -> bool:
    """Whether a pixel sees the pile at two of its three finest levels.

    texels: square of its length in finest texels, on which the level depends; part: by which that varies within it.
    """
    change = part * texels
    first, second, third = LEVEL_CHANGES
    return bool(abs(texels - first) < change or abs(texels - second) < change or abs(texels - third) < change)


@njit(cache=True, error_model="numpy", inline="always")
def past_seam(carpet: FloatArray, x: float) -> float:
    """How far (m) x lies past the nearest seam."""
    strip = x / carpet[3] + SEAM_OFFSET
    return float((strip - np.round(strip)) * carpet[3])


@uncounted
def seam_share(carpet: FloatArray, x: float, width: float, p: float, q: float) -> float:
    """Share of light from a thin dark seam between strips of carpet across the field's length.

    Box-filtered over a pixel's width (m), and the mean over samples at x +- p +- q.
    """
    width, dark = max(width, 1e-6), 0.0
    for n in range(4):
        offset = past_seam(carpet, x + (p if n < 2 else -p) + (q if n % 2 == 0 else -q))
        dark += max(min(offset + 0.5 * width, 0.5 * SEAM_M) - max(offset - 0.5 * width, -0.5 * SEAM_M), 0.0)
    return float(1.0 - 0.1 * dark / width)
