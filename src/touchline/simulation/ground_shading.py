"""How bright the carpet and its paint are: lamps, sun, contact shadows, pile, wear and seams.

Rays whose cell holds no body and that end well within the carpet need no tracing (`sort_rays`).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.geometry import FloatArray
from touchline.simulation.illumination import (
    FLAGS_PER_M,
    HAS_PAINT,
    HAS_SEAM,
    NEAR_BODY,
    PAINT_AROUND,
    PAINT_NEAR,
    SUN_EDGE,
    SUN_MARGIN_M,
    SUNLIT,
    contact_shadow,
    light_at,
    sun_at,
)
from touchline.simulation.paint import MARGIN_M, MIDDLE_MARGIN_M, TIGHT_MARGIN_M, paint_at

TILE_TEXELS, LEVELS = 512, 9  # of the pile's pyramid, see `carpet.pile_pyramid`
FIRST_TEXEL_M = 0.006  # its finest level: a tile of 3 m
SEAM_M = 0.012  # width of a seam between two strips of carpet
_TONE_M = 0.06  # half the width over which the tone of one strip goes over into the next (the light map's step)
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
def _grain(
    pyramid: npt.NDArray[np.float32], x: float, y: float, square: float, px: float, py: float, qx: float, qy: float
) -> float:
    """Brightness of the pile in a pixel that sees a point, with samples at (+-px +-qx, +-py +-qy) from it.

    square: of the footprint (m^2). Where the samples are not much closer together than the finest texels, it is their
    mean.
    """
    if max(abs(px) + abs(qx), abs(py) + abs(qy)) < 0.2 * FIRST_TEXEL_M or square > FIRST_TEXEL_M * FIRST_TEXEL_M:
        return pile_at(pyramid, x, y, square)
    return 0.25 * (
        pile_at(pyramid, x + px + qx, y + py + qy, 0.0) + pile_at(pyramid, x + px - qx, y + py - qy, 0.0)
        + pile_at(pyramid, x - px + qx, y - py + qy, 0.0) + pile_at(pyramid, x - px - qx, y - py - qy, 0.0)
    )  # fmt: skip


@njit(cache=True, error_model="numpy", inline="always")
def _two_levels(texels: float, part: float) -> bool:
    """Whether a pixel sees the pile at two of its three finest levels.

    texels: square of its length in finest texels, on which the level depends; part: by which that varies within it.
    """
    change = part * texels
    return bool(abs(texels - 1.0) < change or abs(texels - 4.0) < change or abs(texels - 16.0) < change)


@njit(cache=True, error_model="numpy")
def sort_rays(
    cast: npt.NDArray[np.float32],
    extents: npt.NDArray[np.float32],
    shift: float,
    total: int,
    starts: npt.NDArray[np.int32],
    room: FloatArray,
    rest: npt.NDArray[np.int32],
    ground: npt.NDArray[np.int32],
) -> tuple[int, int]:
    """List which of the first `total` rays are to be traced (rest) and which surely end on the carpet; count both.

    cast (9, >= N), extents (3, >= N), shift: the rays, see `casting`. starts: no body is near a ray whose cell is
    empty; room: see `trace_rays`.
    """
    count, ground_count = 0, 0
    for i in range(total):
        s, cell = float(cast[6, i]), np.uint32(cast[7, i])
        x, y = abs(cast[0, i] + s * cast[3, i]), abs(cast[1, i] + s * cast[4, i])
        reach = extents[2, i] + s * extents[0, i] + shift
        if x + reach < room[0] and y + reach < room[1] and starts[cell] == starts[cell + np.uint32(1)]:
            ground[ground_count] = i
            ground_count += 1
        else:
            rest[count] = i
            count += 1
    return count, ground_count


@njit(cache=True, error_model="numpy")
def shade_ground(
    ground: npt.NDArray[np.int32],
    cast: npt.NDArray[np.float32],
    extents: npt.NDArray[np.float32],
    shift: float,
    texture: npt.NDArray[np.float32],
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
    radiance: npt.NDArray[np.float32],
    edges: npt.NDArray[np.bool_],
) -> None:
    """Fill radiance (N, 3) of the rays that `ground` lists, all on the carpet, or set edges (N,) where one is near.

    cast (9, >= N), extents (3, >= N), shift, texture (5, >= N): the rays, see `casting` and `sampling`. carpet (5,):
    colour, seam spacing, contrast; paints (P, 3) colours; the other arrays: see the functions that read them.
    """
    for listed in ground:
        i = np.uint32(listed)
        s, ux, uy, stretch = float(cast[6, i]), float(cast[3, i]), float(cast[4, i]), float(cast[8, i])
        x, y = cast[0, i] + s * ux, cast[1, i] + s * uy
        deep, wide = float(extents[2, i]), s * extents[0, i] + shift
        reach, long = deep + wide, texture[4, i] * stretch
        square = 1.5 * long * long
        flag = (
            flags[np.uint32((y - paint_frame[1]) * FLAGS_PER_M), np.uint32((x - paint_frame[0]) * FLAGS_PER_M)] & 0xFF
        )
        if reach < MIDDLE_MARGIN_M:
            flag &= 0xFF - (PAINT_AROUND if reach >= TIGHT_MARGIN_M else PAINT_AROUND | PAINT_NEAR)
        paint, share, edge = -1, 1.0, reach >= MARGIN_M
        if square < 32.0 * FIRST_TEXEL_M**2 and deep > 0.0:
            edge = edge or _two_levels(square / FIRST_TEXEL_M**2, 4.0 * s * deep / (stretch * cast[2, i]))
        sunlit = flag & SUNLIT != 0
        if flag & (HAS_PAINT | PAINT_NEAR | PAINT_AROUND):
            paint, near = paint_at(shapes, starts, items, paint_frame, x, y, ux, uy, deep, wide)
            edge = edge or near
        if flag & NEAR_BODY:
            share, near = contact_shadow(casters, caster_cells, paint_frame, x, y, reach)
            edge = edge or near
        if flag & SUN_EDGE or (sun[0] > 0.0 and reach >= SUN_MARGIN_M):
            sunlit, near = sun_at(sun, windows, casters, x, y, 0.0, np.hypot(deep, wide))
            edge = edge or near
        aside = abs(ux) * deep + abs(uy) * wide
        if carpet[3] > 0.0 and aside > _TONE_M:
            edge = edge or abs(_past_seam(carpet, x)) < aside + _TONE_M
        if edge and deep > 0.0:
            edges[i] = True
            continue
        px, py, qx, qy = 0.0, 0.0, 0.0, 0.0
        if long < FIRST_TEXEL_M or flag & HAS_SEAM:
            across = np.sqrt(stretch * cast[2, i])
            p, aside, q, across = (
                texture[0, i] * stretch,
                texture[1, i] * across,
                texture[2, i] * stretch,
                texture[3, i] * across,
            )
            px, py, qx, qy = p * ux - aside * uy, p * uy + aside * ux, q * ux - across * uy, q * uy + across * ux
        grain = carpet[4] * PILE * _grain(pyramid, x, y, square, px, py, qx, qy)
        if paint >= 0:
            level = light_at(light, light_frame, 0, x, y) * share + (sun[0] if sunlit else 0.0)
            level *= 1.0 + 0.25 * grain
            for c in range(3):
                radiance[i, c] = paints[paint, c] * level
            continue
        level = share + (sun[0] / light_at(light, light_frame, 0, x, y) if sunlit else 0.0)
        if flag & HAS_SEAM:
            level *= _seam(carpet, x, abs(ux) * long + abs(uy) * s * texture[4, i], px, qx)
        level *= light_at(light, light_frame, 1, x, y) * (1.0 + grain)
        for c in range(3):
            radiance[i, c] = carpet[c] * level


@njit(cache=True, error_model="numpy", inline="always")
def _past_seam(carpet: FloatArray, x: float) -> float:
    """How far (m) x lies past the nearest seam."""
    strip = x / carpet[3] + 0.37
    return float((strip - np.round(strip)) * carpet[3])


@njit(cache=True, error_model="numpy")
def _seam(carpet: FloatArray, x: float, width: float, p: float, q: float) -> float:
    """Share of light from a thin dark seam between strips of carpet across the field's length.

    Box-filtered over a pixel's width (m), and the mean over samples at x +- p +- q.
    """
    width, dark = max(width, 1e-6), 0.0
    for n in range(4):
        offset = _past_seam(carpet, x + (p if n < 2 else -p) + (q if n % 2 == 0 else -q))
        dark += max(min(offset + 0.5 * width, 0.5 * SEAM_M) - max(offset - 0.5 * width, -0.5 * SEAM_M), 0.0)
    return float(1.0 - 0.1 * dark / width)
