"""Where each ray first meets the world: one compiled loop over rays and the bodies in their sector.

A ray runs from its origin along a horizontal unit direction; s is the horizontal distance run, `rise` the height gained
per metre. Codes of what was met: the number of a solid, or one of those below.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.geometry import FloatArray
from touchline.simulation.solids import SECTORS, turn_number

CARPET, FLOOR, BOARD, WALL, CEILING = -1, -2, -3, -4, -8  # walls: east -4, west -5, north -6, south -7
FAR_M = 1e6


@njit(cache=True)
def trace_rays(
    rays: npt.NDArray[np.float32],
    rows: npt.NDArray[np.int32],
    poses: FloatArray,
    solids: FloatArray,
    starts: npt.NDArray[np.int32],
    items: npt.NDArray[np.int16],
    near: FloatArray,
    room: FloatArray,
    pixel_angle: float,
    hits: npt.NDArray[np.float32],
    codes: npt.NDArray[np.int32],
) -> None:
    """Fill hits (N, 8) and codes (N,) for body rays (N, 6): origin (m) and direction (any length).

    rows (N,) selects each ray's pose among poses (P, 12): rotation field_from_body row by row, then its translation (m).
    room (6,): half length and width of carpet and of hall, ceiling, height of the board around the carpet (m).
    hits: x, y, z of the point (m, field frame), s, horizontal direction x and y, rise, share of light that nets let by.
    """
    for i in range(len(rays)):
        p = poses[rows[i]]
        r = rays[i]
        ox = p[0] * r[0] + p[1] * r[1] + p[2] * r[2] + p[9]
        oy = p[3] * r[0] + p[4] * r[1] + p[5] * r[2] + p[10]
        oz = p[6] * r[0] + p[7] * r[1] + p[8] * r[2] + p[11]
        dx = p[0] * r[3] + p[1] * r[4] + p[2] * r[5]
        dy = p[3] * r[3] + p[4] * r[4] + p[5] * r[5]
        dz = p[6] * r[3] + p[7] * r[4] + p[8] * r[5]
        scale = 1.0 / max(np.sqrt(dx * dx + dy * dy), 1e-9)
        ux, uy, rise = dx * scale, dy * scale, dz * scale
        s, code = _background(ox, oy, oz, ux, uy, rise, room)
        open_share = 1.0
        sector = min(int(turn_number(ux, uy) * (SECTORS / 4.0)), SECTORS - 1)
        for entry in range(starts[sector], starts[sector + 1]):
            k = items[entry]
            if near[k] > s:
                break
            found = meet(solids, k, ox, oy, oz, ux, uy, rise)
            if 0.0 < found < s:
                if solids[k, 0] == 3.0:
                    open_share *= _net_gaps(solids, k, ox, oy, oz, ux, uy, rise, found, pixel_angle)
                else:
                    s, code = found, k
        hits[i, 0], hits[i, 1], hits[i, 2] = ox + s * ux, oy + s * uy, oz + s * rise
        hits[i, 3], hits[i, 4], hits[i, 5], hits[i, 6], hits[i, 7] = s, ux, uy, rise, open_share
        codes[i] = code


@njit(cache=True)
def _background(
    ox: float, oy: float, oz: float, ux: float, uy: float, rise: float, room: FloatArray
) -> tuple[float, int]:
    """Distance and code of carpet, board, floor, wall or ceiling."""
    s = FAR_M
    if rise < 0.0:
        s = -oz / rise
        if abs(ox + s * ux) <= room[0] and abs(oy + s * uy) <= room[1]:
            return s, CARPET
    if room[5] > 0.0 and abs(ox) < room[0] and abs(oy) < room[1]:
        edge = min(_exit(ox, ux, room[0]), _exit(oy, uy, room[1]))
        if edge < s and oz + edge * rise < room[5]:
            return edge, BOARD
    wall_x, wall_y = _exit(ox, ux, room[2]), _exit(oy, uy, room[3])
    wall = min(wall_x, wall_y)
    if s < wall:
        return s, FLOOR
    if rise > 0.0 and oz + wall * rise > room[4]:
        return (room[4] - oz) / rise, CEILING
    if wall_x <= wall_y:
        return wall, WALL if ux > 0.0 else WALL - 1
    return wall, WALL - 2 if uy > 0.0 else WALL - 3


@njit(cache=True)
def _exit(o: float, u: float, half: float) -> float:
    """Where a ray leaves the strip |x| < half."""
    if u > 1e-12:
        return (half - o) / u
    if u < -1e-12:
        return (-half - o) / u
    return FAR_M


@njit(cache=True)
def meet(solids: FloatArray, k: int, ox: float, oy: float, oz: float, ux: float, uy: float, rise: float) -> float:
    """Horizontal distance (m) at which a ray enters solid k, FAR_M where it misses it."""
    ex, ey = solids[k, 1] - ox, solids[k, 2] - oy
    kind = solids[k, 0]
    radius = solids[k, 9]
    lateral = ux * ey - uy * ex
    if abs(lateral) > radius:
        return FAR_M
    along = ux * ex + uy * ey
    if kind == 2.0:
        return _meet_ball(along, lateral, oz - radius, rise, radius)
    if kind == 0.0:
        half = np.sqrt(radius * radius - lateral * lateral)
        enter, leave = along - half, along + half
    else:
        c, s = solids[k, 3], solids[k, 4]
        lx, ly = ex * c + ey * s, ey * c - ex * s
        vx, vy = ux * c + uy * s, uy * c - ux * s
        if kind == 3.0:
            if abs(vy) < 1e-9:
                return FAR_M
            enter = ly / vy
            height = oz + enter * rise
            inside = abs(enter * vx - lx) <= solids[k, 5] and solids[k, 7] <= height <= solids[k, 8]
            return enter if inside else FAR_M
        enter, leave = _slab(lx, vx, solids[k, 5])
        enter_y, leave_y = _slab(ly, vy, solids[k, 6])
        enter, leave = max(enter, enter_y), min(leave, leave_y)
    return _meet_upright(enter, leave, oz, rise, solids[k, 7], solids[k, 8])


@njit(cache=True)
def _slab(middle: float, v: float, half: float) -> tuple[float, float]:
    if abs(v) < 1e-12:
        return (-FAR_M, FAR_M) if abs(middle) <= half else (FAR_M, -FAR_M)
    a, b = (middle - half) / v, (middle + half) / v
    return (a, b) if a < b else (b, a)


@njit(cache=True)
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


@njit(cache=True)
def _meet_ball(along: float, lateral: float, height: float, rise: float, radius: float) -> float:
    """height: of the ray's origin above the ball's middle."""
    a = 1.0 + rise * rise
    b = along - height * rise
    inside = b * b - a * (along * along + lateral * lateral + height * height - radius * radius)
    return (b - np.sqrt(inside)) / a if inside > 0.0 else FAR_M


@njit(cache=True)
def _net_gaps(
    solids: FloatArray,
    k: int,
    ox: float,
    oy: float,
    oz: float,
    ux: float,
    uy: float,
    rise: float,
    s: float,
    pixel_angle: float,
) -> float:
    """Share of a pixel that is not thread: threads box-filtered over the pixel's width on the net."""
    along = (ox + s * ux - solids[k, 1]) * solids[k, 3] + (oy + s * uy - solids[k, 2]) * solids[k, 4]
    mesh, thread = solids[k, 11], solids[k, 12]
    width = s * pixel_angle
    return (1.0 - _grating(along, mesh, thread, width)) * (1.0 - _grating(oz + s * rise, mesh, thread, width))


@njit(cache=True)
def _grating(position: float, period: float, line: float, width: float) -> float:
    """Mean over [position - width / 2, position + width / 2] of a grating: 1 on lines of that width at each period."""
    if width >= period:
        return line / period
    offset = position - period * np.floor(position / period + 0.5)
    low, high = max(offset - 0.5 * width, -0.5 * line), min(offset + 0.5 * width, 0.5 * line)
    return max(0.0, high - low) / width
