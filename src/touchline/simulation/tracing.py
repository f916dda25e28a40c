"""Where each ray first meets the world: one compiled loop over rays and the bodies in their sector.

A ray runs from its origin along a horizontal unit direction; s is the horizontal distance run, `rise` the height gained
per metre. Codes of what was met: the number of a solid, or one of those below.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.geometry import FloatArray
from touchline.simulation.casting import FAR_M
from touchline.simulation.solids import SECTORS

CARPET, FLOOR, BOARD, WALL, CEILING = -1, -2, -3, -4, -8  # walls: east -4, west -5, north -6, south -7


@njit(cache=True, error_model="numpy")
def trace_rays(
    cast: npt.NDArray[np.float32],
    rest: npt.NDArray[np.int32],
    solids: FloatArray,
    starts: npt.NDArray[np.int32],
    items: npt.NDArray[np.int16],
    near: FloatArray,
    room: FloatArray,
    pixel_angle: float,
    hits: npt.NDArray[np.float32],
    codes: npt.NDArray[np.int32],
) -> None:
    """Fill hits (M, 8) and codes (M,) for those of the cast rays (8, N) that rest (M,) lists; see `cast_rays`.

    room (6,): half length and width of carpet and of hall, ceiling, height of the board around the carpet (m).
    hits: x, y, z of the point (m, field frame), s, horizontal direction x and y, rise, share of light that nets let by.
    """
    for i in range(len(rest)):
        r = rest[i]
        ox, oy, oz = float(cast[0, r]), float(cast[1, r]), float(cast[2, r])
        ux, uy, rise = float(cast[3, r]), float(cast[4, r]), float(cast[5, r])
        s, code = _background(ox, oy, oz, ux, uy, rise, float(cast[6, r]), room)
        sector = min(int(cast[7, r]), SECTORS - 1)
        open_share = 1.0
        for entry in range(starts[sector], starts[sector + 1]):
            k = items[entry]
            if near[k] > s:
                break
            ex, ey = solids[k, 1] - ox, solids[k, 2] - oy
            lateral = ux * ey - uy * ex
            if abs(lateral) > solids[k, 9]:
                continue
            found = meet(solids[k], ex, ey, lateral, oz, ux, uy, rise)
            if 0.0 < found < s:
                if solids[k, 0] == 3.0:
                    open_share *= _net_gaps(
                        solids[k], found * ux - ex, found * uy - ey, oz + found * rise, found * pixel_angle
                    )
                else:
                    s, code = found, k
        hits[i, 0], hits[i, 1], hits[i, 2] = ox + s * ux, oy + s * uy, oz + s * rise
        hits[i, 3], hits[i, 4], hits[i, 5], hits[i, 6], hits[i, 7] = s, ux, uy, rise, open_share
        codes[i] = code


@njit(cache=True, error_model="numpy", inline="always")
def _background(
    ox: float, oy: float, oz: float, ux: float, uy: float, rise: float, ground: float, room: FloatArray
) -> tuple[float, int]:
    """Distance and code of carpet, board, floor, wall or ceiling; ground: distance (m) of the ground."""
    s = ground
    code = CARPET
    if rise >= 0.0 or abs(ox + s * ux) > room[0] or abs(oy + s * uy) > room[1]:
        code = FLOOR
        per_x, per_y = 1.0 / (abs(ux) + 1e-12), 1.0 / (abs(uy) + 1e-12)
        along_x, along_y = (ox if ux > 0.0 else -ox), (oy if uy > 0.0 else -oy)
        wall_x, wall_y = (room[2] - along_x) * per_x, (room[3] - along_y) * per_y
        wall = min(wall_x, wall_y)
        if wall < s:
            s = wall
            side = WALL - (0 if ux > 0.0 else 1)
            code = side if wall_x <= wall_y else WALL - (2 if uy > 0.0 else 3)
            if rise > 0.0 and oz + wall * rise > room[4]:
                s, code = (room[4] - oz) / rise, CEILING
        if room[5] > 0.0 and abs(ox) < room[0] and abs(oy) < room[1]:
            edge = min((room[0] - along_x) * per_x, (room[1] - along_y) * per_y)
            if edge < s and oz + edge * rise < room[5]:
                s, code = edge, BOARD
    return s, code


@njit(cache=True, error_model="numpy")
def meet(
    solid: FloatArray, ex: float, ey: float, lateral: float, oz: float, ux: float, uy: float, rise: float
) -> float:
    """Horizontal distance (m) at which a ray enters a solid (row of the table), FAR_M where it misses it.

    ex, ey: from the ray's origin to the solid's middle; lateral: distance of the middle to the left of the ray, less than
    the bounding radius.
    """
    kind, radius = solid[0], solid[9]
    along = ux * ex + uy * ey
    if kind == 2.0:
        return _meet_ball(along, lateral, oz - radius, rise, radius)
    if kind == 0.0:
        half = np.sqrt(radius * radius - lateral * lateral)
        return _meet_upright(along - half, along + half, oz, rise, solid[7], solid[8])
    c, s = solid[3], solid[4]
    lx, ly = ex * c + ey * s, ey * c - ex * s
    vx, vy = ux * c + uy * s, uy * c - ux * s
    if kind == 3.0:
        if abs(vy) < 1e-9:
            return FAR_M
        enter = ly / vy
        height = oz + enter * rise
        inside = abs(enter * vx - lx) <= solid[5] and solid[7] <= height <= solid[8]
        return enter if inside else FAR_M
    enter, leave = _slab(lx, vx, solid[5])
    enter_y, leave_y = _slab(ly, vy, solid[6])
    return _meet_upright(max(enter, enter_y), min(leave, leave_y), oz, rise, solid[7], solid[8])


@njit(cache=True, error_model="numpy")
def _slab(middle: float, v: float, half: float) -> tuple[float, float]:
    if abs(v) < 1e-12:
        return (-FAR_M, FAR_M) if abs(middle) <= half else (FAR_M, -FAR_M)
    a, b = (middle - half) / v, (middle + half) / v
    return (a, b) if a < b else (b, a)


@njit(cache=True, error_model="numpy")
def _meet_upright(enter: float, leave: float, oz: float, rise: float, bottom: float, top: float) -> float:
    """First meeting with an upright body over [enter, leave] between two heights."""
    if enter >= leave or leave <= 0.0:
        return FAR_M
    height = oz + enter * rise
    if bottom <= height <= top:
        return enter
    if height > top and rise < 0.0:
        s = (top - oz) / rise
    elif height < bottom and rise > 0.0:
        s = (bottom - oz) / rise
    else:
        return FAR_M
    return s if s < leave else FAR_M


@njit(cache=True, error_model="numpy")
def _meet_ball(along: float, lateral: float, height: float, rise: float, radius: float) -> float:
    """height: of the ray's origin above the ball's middle."""
    a = 1.0 + rise * rise
    b = along - height * rise
    inside = b * b - a * (along * along + lateral * lateral + height * height - radius * radius)
    return (b - np.sqrt(inside)) / a if inside > 0.0 else FAR_M


@njit(cache=True, error_model="numpy")
def _net_gaps(net: FloatArray, x: float, y: float, height: float, width: float) -> float:
    """Share of a pixel that is not thread, at x, y from the net's middle: threads box-filtered over the pixel's width."""
    along = x * net[3] + y * net[4]
    return float((1.0 - _grating(along, net[11], net[12], width)) * (1.0 - _grating(height, net[11], net[12], width)))


@njit(cache=True, error_model="numpy")
def _grating(position: float, period: float, line: float, width: float) -> float:
    """Mean over [position - width / 2, position + width / 2] of a grating: 1 on lines of that width at each period."""
    if width >= period:
        return line / period
    offset = position - period * np.floor(position / period + 0.5)
    low, high = max(offset - 0.5 * width, -0.5 * line), min(offset + 0.5 * width, 0.5 * line)
    return max(0.0, high - low) / width
