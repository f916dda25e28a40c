"""Where light falls: lamps as a map over the hall, sun through windows with hard edges, shadows of bodies."""

import math

import numpy as np
from numba import njit

from touchline.geometry import ByteArray, Float32Array, FloatArray

HAS_PAINT, NEAR_BODY, HAS_SEAM, SUNLIT, SUN_EDGE = 1, 2, 4, 8, 16  # what a flag cell of the ground holds
FLAGS_PER_M = 32.0


@njit(cache=True, error_model="numpy")
def light_at(light: Float32Array, frame: FloatArray, channel: int, x: float, y: float) -> float:
    """Light level of the map (ny, nx, 5) at a point (m, field frame), bilinear; frame: x, y of [0, 0], samples per
    metre.

    channel 0: what falls on the ground; 1: the same times the carpet's brightness there; 2 to 4: its red, green, blue.
    """
    fx = min(max((x - frame[0]) * frame[2], 0.0), light.shape[1] - 1.001)
    fy = min(max((y - frame[1]) * frame[2], 0.0), light.shape[0] - 1.001)
    i, j = np.int64(fx), np.int64(fy)
    a, b = fx - i, fy - j
    top = light[j, i, channel] * (1.0 - a) + light[j, i + 1, channel] * a
    bottom = light[j + 1, i, channel] * (1.0 - a) + light[j + 1, i + 1, channel] * a
    return float(top * (1.0 - b) + bottom * b)


@njit(cache=True, error_model="numpy")
def sun_at(sun: FloatArray, windows: FloatArray, casters: FloatArray, x: float, y: float, z: float) -> bool:
    """Whether the sun shines on a point (m, field frame) through a window and past all casters.

    sun (4,): level, horizontal direction towards it, tangent of its elevation. windows (W, 10): axis (0: wall across
    x, 1: across y), signed distance of the wall, start, end, bottom, top, bars along, bars up, width of a bar, metres
    along the sun's direction per metre towards the wall. casters (M, 4): x, y, radius, height.
    """
    lit = False
    for k in range(len(windows)):
        across_x = windows[k, 0] == 0.0
        run = (windows[k, 1] - (x if across_x else y)) * windows[k, 9]
        if run > 0.0:
            along, height = (y + run * sun[2] if across_x else x + run * sun[1]), z + run * sun[3]
            lit = lit or (
                _passes(along - windows[k, 2], windows[k, 3] - windows[k, 2], windows[k, 6], windows[k, 8])
                and _passes(height - windows[k, 4], windows[k, 5] - windows[k, 4], windows[k, 7], windows[k, 8])
            )
    if lit:
        for m in range(len(casters)):
            ex, ey = casters[m, 0] - x, casters[m, 1] - y
            run = ex * sun[1] + ey * sun[2]
            beside = abs(ex * sun[2] - ey * sun[1]) < casters[m, 2]
            if run > 0.0 and beside and z + (run - casters[m, 2]) * sun[3] < casters[m, 3]:
                return False
    return lit


@njit(cache=True, error_model="numpy")
def _passes(position: float, size: float, bars: float, width: float) -> bool:
    """Whether light passes a window's opening at a position (m) between its frame and evenly spread bars."""
    if not 0.0 < position < size:
        return False
    if bars == 0.0:
        return True
    pane = size / (bars + 1.0)
    nearest = min(max(np.round(position / pane), 1.0), bars)
    return bool(abs(position - nearest * pane) > 0.5 * width)


def sunward(windows: FloatArray, azimuth_rad: float) -> FloatArray:
    """Windows (W, 9) with the last column for `sun_at`, (W, 10)."""
    towards = np.where(windows[:, 0] == 0.0, math.cos(azimuth_rad), math.sin(azimuth_rad))
    return np.column_stack((windows, 1.0 / np.where(towards != 0.0, towards, 1e-9)))


@njit(cache=True, error_model="numpy")
def contact_shadow(casters: FloatArray, x: float, y: float) -> float:
    """Share of the light that reaches the ground beside bodies: 45 % below them, all from three radii on."""
    ratio = 1.0
    for m in range(len(casters)):
        ex, ey = x - casters[m, 0], y - casters[m, 1]
        fade = 1.0 - (ex * ex + ey * ey) / (9.0 * casters[m, 2] * casters[m, 2])
        if fade > 0.0:
            ratio *= 1.0 - 0.55 * fade * fade * fade
    return ratio


def mark_shadows(casters: FloatArray, sun: FloatArray, frame: FloatArray, flags: ByteArray) -> None:
    """Mark the flags (ny, nx) of cells near bodies, and where these may cut off sunlight. frame: x, y of the first."""
    for x, y, radius, height in casters:
        flags[_cells_around(x, y, 3.0 * radius, frame)] |= NEAR_BODY
        if sun[0] > 0.0:
            for run in np.arange(0.0, height / sun[3] + 2.0 * radius, radius):
                cells = flags[_cells_around(x - run * sun[1], y - run * sun[2], 1.1 * radius, frame)]
                cells[cells & SUNLIT > 0] |= SUN_EDGE


def _cells_around(x: float, y: float, reach: float, frame: FloatArray) -> tuple[slice, slice]:
    """Rows and columns of the cells that a square touches."""
    column, row = (x - frame[0]) * FLAGS_PER_M, (y - frame[1]) * FLAGS_PER_M
    half = reach * FLAGS_PER_M
    return (
        slice(max(int(row - half), 0), max(int(row + half) + 1, 0)),
        slice(max(int(column - half), 0), max(int(column + half) + 1, 0)),
    )


@njit(cache=True, error_model="numpy")
def mark_sunlight(sun: FloatArray, windows: FloatArray, frame: FloatArray, flags: ByteArray) -> None:
    """Set in flags (ny, nx) which cells the sun lights (SUNLIT), and in which it ends (SUN_EDGE): by their corners."""
    nobody, rows, columns = np.zeros((0, 4)), flags.shape[0], flags.shape[1]
    for j in range(rows + 1):
        for i in range(columns + 1):
            lit = sun_at(sun, windows, nobody, frame[0] + i / FLAGS_PER_M, frame[1] + j / FLAGS_PER_M, 0.0)
            for v in range(max(j - 1, 0), min(j + 1, rows)):
                for u in range(max(i - 1, 0), min(i + 1, columns)):
                    flags[v, u] |= SUNLIT if lit else SUN_EDGE
    for j in range(rows):  # an edge is where some corners are lit and some are not
        for i in range(columns):
            if not flags[j, i] & SUNLIT:
                flags[j, i] &= ~SUN_EDGE
