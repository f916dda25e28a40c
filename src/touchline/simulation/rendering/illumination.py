"""Where light falls: lamps as a map over the hall, sun through windows with hard edges, shadows of bodies."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.geometry import FloatArray
from touchline.simulation.compiled import uncounted

# what a flag cell of the ground (1/32 m) holds
HAS_PAINT, NEAR_BODY, HAS_SEAM, SUNLIT, SUN_EDGE, PAINT_NEAR, PAINT_AROUND, SUN_AROUND = 1, 2, 4, 8, 16, 32, 64, 128
FLAGS_PER_M = 32.0
SUN_MARGIN_M, SUN_TIGHT_M = 0.1, 0.03  # so close to a cell with SUN_AROUND or SUN_EDGE a shadow's edge may lie


@njit(cache=True, error_model="numpy", inline="always")
def light_at(light: npt.NDArray[np.float32], frame: FloatArray, channel: int, x: float, y: float) -> float:
    """Light level of the map (ny, nx, 2) at a point (m, field frame), bilinear; frame: x, y of [0, 0], samples per
    metre.

    channel 0: what falls on the ground; 1: the same times the carpet's brightness there.
    """
    fx = min(max((x - frame[0]) * frame[2], 0.0), light.shape[1] - 1.001)
    fy = min(max((y - frame[1]) * frame[2], 0.0), light.shape[0] - 1.001)
    i, j = np.uint32(fx), np.uint32(fy)
    a, b = fx - i, fy - j
    i1, j1 = np.uint32(i + 1), np.uint32(j + 1)
    top = light[j, i, channel] * (1.0 - a) + light[j, i1, channel] * a
    bottom = light[j1, i, channel] * (1.0 - a) + light[j1, i1, channel] * a
    return float(top * (1.0 - b) + bottom * b)


@uncounted
def sun_at(
    sun: FloatArray,
    windows: FloatArray,
    casters: FloatArray,
    x: float,
    y: float,
    z: float,
    reach: float,
    px: float = 0.0,
    py: float = 0.0,
    qx: float = 0.0,
    qy: float = 0.0,
) -> tuple[bool, bool]:
    """Whether the sun shines on a point (m, field frame) through a window and past all casters, and whether that may
    change within reach (m) of the parallelogram around it with corners at (+-px +-qx, +-py +-qy).

    sun (4,): level, horizontal direction towards it, tangent of its elevation. windows (W, 16): axis (0: wall across x,
    1: across y), signed distance of the wall, start, end, bottom, top, bars along, bars up, width of a bar; then what
    follows from the sun's direction, see `sunward`. casters (M, 4): x, y, radius, height.
    """
    lit, edge = False, False
    for k in range(len(windows)):
        across_x = windows[k, 0] == 0.0
        run = (windows[k, 1] - (x if across_x else y)) * windows[k, 9]
        if run <= 0.0:
            continue
        p_to, q_to, p_off, q_off = (px, qx, py, qy) if across_x else (py, qy, px, qx)
        slant = windows[k, 9] * (sun[2] if across_x else sun[1])
        over = reach * windows[k, 10] + abs(p_off - p_to * slant) + abs(q_off - q_to * slant)
        up = reach * windows[k, 11] + (abs(p_to) + abs(q_to)) * abs(windows[k, 9]) * sun[3]
        height, tall = z + run * sun[3] - windows[k, 4], windows[k, 5] - windows[k, 4]
        if not -up < height < tall + up:
            continue
        along = (y + run * sun[2] if across_x else x + run * sun[1]) - windows[k, 2]
        broad = windows[k, 3] - windows[k, 2]
        if not -over < along < broad + over:
            continue
        across = _light_past(along, broad, windows[k, 6], windows[k, 12], windows[k, 13], windows[k, 8])
        upright = _light_past(height, tall, windows[k, 7], windows[k, 14], windows[k, 15], windows[k, 8])
        lit = lit or (across > 0.0 and upright > 0.0)
        edge = edge or (min(across + over, upright + up) > 0.0 and (across < over or upright < up))
    if not (lit or edge) or len(casters) == 0:
        return lit, edge
    towards = reach + abs(px * sun[1] + py * sun[2]) + abs(qx * sun[1] + qy * sun[2])
    beside = reach + abs(px * sun[2] - py * sun[1]) + abs(qx * sun[2] - qy * sun[1])
    above = reach + towards * sun[3]
    for m in range(len(casters)):
        ex, ey = casters[m, 0] - x, casters[m, 1] - y
        run = ex * sun[1] + ey * sun[2]
        off = abs(ex * sun[2] - ey * sun[1]) - casters[m, 2]
        over = z + (run - casters[m, 2]) * sun[3] - casters[m, 3]
        if run > -towards and off < beside and over < above:
            lit = lit and not (run > 0.0 and off < 0.0 and over < 0.0)
            edge = edge or run < towards or off > -beside or over > -above
    return lit, edge


def sunward(windows: FloatArray, azimuth_rad: float, elevation_rad: float) -> FloatArray:
    """Windows (W, 9) with seven more columns for `sun_at`, (W, 16).

    Metres along the sun's direction per metre towards the wall (signed); by how much a reach grows on the way to the
    wall, along and up it; size of a pane and panes per metre along the wall, then up it.
    """
    x, y = math.cos(azimuth_rad), math.sin(azimuth_rad)
    across_x = windows[:, 0] == 0.0
    towards, aside = np.where(across_x, x, y), np.where(across_x, y, x)
    per = 1.0 / np.where(towards != 0.0, towards, 1e-9)
    along = (windows[:, 6] + 1.0) / (windows[:, 3] - windows[:, 2])
    up = (windows[:, 7] + 1.0) / (windows[:, 5] - windows[:, 4])
    grown_along, grown_up = np.hypot(1.0, aside * per), np.hypot(1.0, np.tan(elevation_rad) * per)
    rows: FloatArray = np.column_stack((windows, per, grown_along, grown_up, 1.0 / along, along, 1.0 / up, up))
    return rows


@njit(cache=True, error_model="numpy", inline="always")
def _light_past(position: float, size: float, bars: float, pane: float, per_m: float, width: float) -> float:
    """How far (m) a position in a window's opening is from the frame and the nearest bar; negative: in their shade."""
    nearest = min(max(np.round(position * per_m), 1.0), bars)
    clear = min(position, size - position)
    return float(min(clear, abs(position - nearest * pane) - 0.5 * width) if bars > 0.0 else clear)


@uncounted
def contact_shadow(
    casters: FloatArray, cells: npt.NDArray[np.int16], frame: FloatArray, x: float, y: float, reach: float
) -> tuple[float, bool]:
    """Share of the light that reaches the ground beside bodies: 45 % below them, all from three radii on.

    cells (ny, nx, n): casters near each 0.25 m cell; frame: x, y of the first. Also whether the share's mean within
    reach (m) differs notably from that in the middle.
    """
    i = min(max(int((x - frame[0]) * 4.0), 0), cells.shape[1] - 1)
    j = min(max(int((y - frame[1]) * 4.0), 0), cells.shape[0] - 1)
    share, coarse = 1.0, False
    for n in range(cells.shape[2]):
        m = cells[j, i, n]
        if m < 0:
            break
        ex, ey = x - casters[m, 0], y - casters[m, 1]
        fade = 1.0 - (ex * ex + ey * ey) / (9.0 * casters[m, 2] * casters[m, 2])
        if fade > 0.0:
            share *= 1.0 - 0.55 * fade * fade * fade
            coarse = coarse or reach > 0.3 * casters[m, 2]
    return share, coarse


@njit(cache=True, error_model="numpy")
def place_casters(
    casters: FloatArray, sun: FloatArray, frame: FloatArray, flags: npt.NDArray[np.uint8]
) -> npt.NDArray[np.int16]:
    """For each 0.25 m cell of the ground (ny, nx, 6) up to six bodies within three radii, -1 for none.

    Marks the flags (8 ny, 8 nx) around them, and where sunlight may be cut off by them. frame: x, y of the first cell.
    """
    cells = np.full((flags.shape[0] // 8, flags.shape[1] // 8, 6), -1, dtype=np.int16)
    for m in range(len(casters)):
        x, y, radius = casters[m, 0], casters[m, 1], casters[m, 2]
        _mark_square(x, y, 3.0 * radius, frame, flags, NEAR_BODY, 0)
        low_j, high_j, low_i, high_i = _cells_around(x, y, 3.0 * radius, frame, 4.0, cells.shape[:2])
        for cell in range((high_j - low_j) * (high_i - low_i)):
            j, i = low_j + cell // (high_i - low_i), low_i + cell % (high_i - low_i)
            for n in range(cells.shape[2]):
                if cells[j, i, n] < 0:
                    cells[j, i, n] = m
                    break
        if sun[0] <= 0.0:
            continue
        length, run = casters[m, 3] / sun[3] + radius, 0.0
        while run < length + SUN_MARGIN_M + 0.25:
            shade_x, shade_y = x - run * sun[1], y - run * sun[2]
            _mark_square(shade_x, shade_y, radius + SUN_MARGIN_M, frame, flags, SUN_EDGE, SUNLIT | SUN_AROUND)
            run += 0.2
    return cells


@njit(cache=True, error_model="numpy")
def _cells_around(
    x: float, y: float, reach: float, frame: FloatArray, per_m: float, shape: tuple[int, int]
) -> tuple[int, int, int, int]:
    """First and last row (exclusive), first and last column (exclusive) of the cells that a square touches."""
    low_i, high_i = int((x - reach - frame[0]) * per_m), int((x + reach - frame[0]) * per_m) + 1
    low_j, high_j = int((y - reach - frame[1]) * per_m), int((y + reach - frame[1]) * per_m) + 1
    return (
        min(max(low_j, 0), shape[0]),
        min(max(high_j, 0), shape[0]),
        min(max(low_i, 0), shape[1]),
        min(max(high_i, 0), shape[1]),
    )


@njit(cache=True, error_model="numpy")
def _mark_square(
    x: float, y: float, reach: float, frame: FloatArray, flags: npt.NDArray[np.uint8], bit: int, only: int
) -> None:
    """Set a bit in the flags (ny, nx) of the cells that a square touches, of those that hold one of `only`, if any."""
    low_j, high_j, low_i, high_i = _cells_around(x, y, reach, frame, FLAGS_PER_M, flags.shape)
    for j in range(low_j, high_j):
        for i in range(low_i, high_i):
            if only == 0 or flags[j, i] & only:
                flags[j, i] |= bit


@njit(cache=True, error_model="numpy")
def mark_sunlight(sun: FloatArray, windows: FloatArray, frame: FloatArray, flags: npt.NDArray[np.uint8]) -> None:
    """Set in flags (ny, nx) which cells the sun lights (SUNLIT), and near which it ends (SUN_EDGE, SUN_AROUND)."""
    nobody, half = np.zeros((0, 4)), np.sqrt(0.5) / FLAGS_PER_M
    for j in range(flags.shape[0]):
        for i in range(flags.shape[1]):
            x, y = frame[0] + (i + 0.5) / FLAGS_PER_M, frame[1] + (j + 0.5) / FLAGS_PER_M
            lit, around = sun_at(sun, windows, nobody, x, y, 0.0, SUN_MARGIN_M + half)
            if lit:
                flags[j, i] |= SUNLIT
            if around:
                _, near = sun_at(sun, windows, nobody, x, y, 0.0, SUN_TIGHT_M + half)
                flags[j, i] |= SUN_EDGE | SUN_AROUND if near else SUN_AROUND
