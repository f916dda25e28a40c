"""Where each ray first meets the world: one compiled loop over rays and the bodies in their cell.

A ray runs from its origin along a horizontal unit direction; s is the horizontal distance run, `rise` the height gained
per metre. Codes of what was met: the number of a solid, or one of those below.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.geometry import FloatArray
from touchline.simulation.meeting import meet_ball, meet_upright

_NOWHERE_M = 1e6  # beyond every hall
_CREASE = 1.3  # distances vary by so much more within a pixel than along its middle
CARPET, FLOOR, BOARD, WALL, CEILING = -1, -2, -3, -4, -8  # walls: east -4, west -5, north -6, south -7


@njit(cache=True, error_model="numpy")
def trace_rays(
    cast: npt.NDArray[np.float32],
    extents: npt.NDArray[np.float32],
    shift: float,
    rest: npt.NDArray[np.int32],
    solids: FloatArray,
    starts: npt.NDArray[np.int32],
    items: npt.NDArray[np.int16],
    near: FloatArray,
    room: FloatArray,
    net_angle: float,
    hits: npt.NDArray[np.float32],
    codes: npt.NDArray[np.int32],
    ground: npt.NDArray[np.int32],
    ground_count: int,
    edges: npt.NDArray[np.bool_],
) -> tuple[int, int]:
    """Find what those of the cast rays (9, N) meet that `rest` (M,) lists; count the upright hits and the ground's.

    extents (3, N): see `casting.spread_rays`; all zero: the rays are samples, and no edges are looked for. edges (N,)
    is set where the rays of a pixel may meet different things; nothing else is told of these. room (6,): half length
    and width of carpet and of hall, ceiling, height of the board around the carpet (m). net_angle (rad): over which
    nets are smoothed. The rays that end on the carpet are appended to `ground`. The others stay in `rest`, and so do
    those that pass nets, with codes (M,) and hits (M, 8): x, y, z of the point (m, field frame), s, horizontal
    direction x and y, across (m per m), share of light that nets let by.
    """
    count = 0
    for listed in rest:
        i = np.uint32(listed)
        ox, oy, oz = float(cast[0, i]), float(cast[1, i]), float(cast[2, i])
        ux, uy, rise = float(cast[3, i]), float(cast[4, i]), float(cast[5, i])
        across, steep, deep = float(extents[0, i]), float(extents[1, i]), float(extents[2, i])
        marking, s, code, edge = across > 0.0, float(cast[6, i]), CARPET, False
        behind = deep if marking and rise < 0.0 else 0.0
        nets, open_share, cell = False, 1.0, np.uint32(cast[7, i])
        for entry in range(starts[cell], starts[cell + np.uint32(1)]):
            k = np.uint32(items[entry])
            if near[k] > s + behind or (edge and marking):
                break
            ex, ey = solids[k, 1] - ox, solids[k, 2] - oy
            lateral, along = ux * ey - uy * ex, ux * ex + uy * ey
            reach = along + solids[k, 9]
            aside, lift = reach * across + shift, reach * steep + shift
            if abs(lateral) >= solids[k, 9] + aside or reach <= 0.0:
                continue
            if solids[k, 0] == 3.0:
                nets = True
                continue
            if solids[k, 0] == 2.0:
                width = max(aside, lift / np.sqrt(1.0 + rise * rise)) * 1.5
                vary = 0.0
                found, edge = meet_ball(
                    along, lateral, oz - solids[k, 9], rise, solids[k, 9], width if marking else 0.0, s + behind
                )
            else:
                found, edge, vary = meet_upright(
                    solids,
                    int(k),
                    along,
                    lateral,
                    ex,
                    ey,
                    oz,
                    ux,
                    uy,
                    rise,
                    aside,
                    lift,
                    steep,
                    s + behind + 2.0 * aside,
                )
            vary = _CREASE * vary + aside
            if 0.0 < found < s + behind + vary:
                edge = edge or (code >= 0 and abs(s - found) < behind + vary)
                if found < s:
                    s, code, behind = found, int(k), vary
        if not (marking and edge) and (
            code < 0 or _may_be_hidden(ox + s * ux, oy + s * uy, oz + s * rise - s * steep, room, behind + 0.1)
        ):
            met, found, edge = _background(
                ox, oy, oz, ux, uy, rise, float(cast[6, i]), across, steep, deep, shift, room,
                s if code >= 0 else _NOWHERE_M, behind,
            )  # fmt: skip
            if met < 0:
                s, code = found, met
        if nets and not (marking and edge):
            for entry in range(starts[cell], starts[cell + np.uint32(1)]):
                k = np.uint32(items[entry])
                if solids[k, 0] == 3.0:
                    share, near_by_net = _net(
                        solids, int(k), ox, oy, oz, ux, uy, rise, across, steep, shift, net_angle, s, behind
                    )
                    open_share, edge = open_share * share, edge or near_by_net
        if marking and edge:
            edges[i] = True
            continue
        if code == CARPET:
            ground[ground_count] = i
            ground_count += 1
            if open_share == 1.0:
                continue
        rest[count] = i
        hits[count, 0], hits[count, 1], hits[count, 2] = ox + s * ux, oy + s * uy, oz + s * rise
        hits[count, 3], hits[count, 4], hits[count, 5] = s, ux, uy
        hits[count, 6], hits[count, 7] = across * s + shift, open_share
        codes[count] = code
        count += 1
    return count, ground_count


@njit(cache=True, error_model="numpy", inline="always")
def _may_be_hidden(x: float, y: float, z: float, room: FloatArray, reach: float) -> bool:
    """Whether a body's point (m) may lie behind the board around the carpet or the wall, or `reach` from them."""
    x, y = abs(x), abs(y)
    return bool(
        x + reach > room[2]
        or y + reach > room[3]
        or (z < room[5] + reach and (x + reach > room[0] or y + reach > room[1]))
    )


@njit(cache=True, error_model="numpy", inline="always")
def _background(
    ox: float,
    oy: float,
    oz: float,
    ux: float,
    uy: float,
    rise: float,
    ground: float,
    across: float,
    steep: float,
    deep: float,
    shift: float,
    room: FloatArray,
    limit: float,
    behind: float,
) -> tuple[int, float, bool]:
    """Code and distance of carpet, board, floor, wall or ceiling, and whether an edge of theirs is near.

    ground: distance (m) of the ground; deep: how far (m) a pixel reaches along it. limit: distance (m) of the body that
    the ray meets, whose surface may reach `behind` (m) further; 0 instead of a code if none of the above is nearer.
    """  # fmt: skip
    x, y, border = abs(ox + ground * ux) - room[0], abs(oy + ground * uy) - room[1], False
    if rise < 0.0 and across > 0.0 and 2.0 * (steep - rise) * (room[2] + room[3]) > oz:
        wide = across * ground + shift
        over_x, over_y = abs(ux) * deep + abs(uy) * wide, abs(uy) * deep + abs(ux) * wide
        border = x < over_x and y < over_y and (abs(x) < over_x or abs(y) < over_y)
    if rise < 0.0 and x <= 0.0 and y <= 0.0:
        return (CARPET, ground, border) if ground < limit else (0, limit, False)
    per_x, per_y = 1.0 / (abs(ux) + 1e-12), 1.0 / (abs(uy) + 1e-12)
    along_x, along_y = (ox if ux > 0.0 else -ox), (oy if uy > 0.0 else -oy)
    wall_x, wall_y = (room[2] - along_x) * per_x, (room[3] - along_y) * per_y
    wall = min(wall_x, wall_y)
    height, up = oz + wall * rise, _lift_on_wall(wall, rise, across, steep, shift, per_x if wall_x < wall_y else per_y)
    s, code, edge = ground, FLOOR, border or abs(height) < up or abs(height - room[4]) < up
    if wall < s:
        s = wall
        side = WALL - (0 if ux > 0.0 else 1)
        code = side if wall_x <= wall_y else WALL - (2 if uy > 0.0 else 3)
        edge = edge or abs(wall_x - wall_y) * abs(ux * uy) < across * wall + shift
        if rise > 0.0 and height > room[4]:
            s, code = (room[4] - oz) / rise, CEILING
    if limit < _NOWHERE_M:
        edge = abs(s - limit) < behind + (across * s + shift) * (per_x + per_y) or (edge and s < limit)
        if s >= limit:
            s, code = limit, 0
    if room[5] > 0.0 and abs(ox) < room[0] and abs(oy) < room[1]:
        board_x, board_y = (room[0] - along_x) * per_x, (room[1] - along_y) * per_y
        board = min(board_x, board_y)
        per = per_x if board_x < board_y else per_y
        height, up = oz + board * rise, _lift_on_wall(board, rise, across, steep, shift, per)
        crossed = height < room[5] + up and abs(board - limit) < behind + _CREASE * (across * board + shift) * per
        if board < s and abs(height) >= up and height < room[5] - up:
            s, code, edge = board, BOARD, crossed
        else:
            edge = edge or crossed or (board < s and height < room[5] + up)
            if board < s and height < room[5]:
                s, code = board, BOARD
    return code, s, bool(edge and across > 0.0)


@njit(cache=True, error_model="numpy", inline="always")
def _lift_on_wall(s: float, rise: float, across: float, steep: float, shift: float, per: float) -> float:
    """How far (m) a pixel reaches up a wall whose normal lies at an angle of cosine 1 / per to the ray."""
    return s * steep + shift + abs(rise) * (across * s + shift) * per


@njit(cache=True, error_model="numpy")
def _net(
    solids: FloatArray,
    k: int,
    ox: float,
    oy: float,
    oz: float,
    ux: float,
    uy: float,
    rise: float,
    across: float,
    steep: float,
    shift: float,
    net_angle: float,
    limit: float,
    behind: float,
) -> tuple[float, bool]:
    """Share of a pixel that is not thread where a ray passes net k, and whether the edge of a thread is near.

    Threads are box-filtered over net_angle (rad). What the ray meets is at `limit`, and reaches `behind` (m) further.
    """  # fmt: skip
    ex, ey, c, s = solids[k, 1] - ox, solids[k, 2] - oy, solids[k, 3], solids[k, 4]
    lx, ly, vx, vy = ex * c + ey * s, ey * c - ex * s, ux * c + uy * s, uy * c - ux * s
    aside = across * (np.hypot(ex, ey) + solids[k, 5]) + shift
    if solids[k, 5] * abs(vy) < 2.0 * aside:  # seen from the edge
        return 1.0, abs(ux * ey - uy * ex) < 3.0 * aside
    if vy == 0.0:
        return 1.0, False
    far = ly / vy
    aside = across * far + shift
    wide = aside / abs(vy)
    if not 0.0 < far < limit + wide + behind:
        return 1.0, False
    up = far * steep + shift + abs(rise * vx) * wide
    along, height = far * vx - lx, oz + far * rise
    inside = min(solids[k, 5] - abs(along) + wide, height - solids[k, 7] + up, solids[k, 8] - height + up)
    if inside < 0.0:
        return 1.0, False
    mesh, thread, width = solids[k, 11], solids[k, 12], far * net_angle
    broad = width / max(abs(vy), 0.1)
    if across == 0.0:
        return (1.0 - _grating(along, mesh, thread, broad)) * (1.0 - _grating(height, mesh, thread, width)), False
    over, above = _off_thread(along, mesh, thread), _off_thread(height, mesh, thread)
    edge = inside < 2.0 * max(wide, up) or far > limit - wide - behind
    wide, up = wide + 0.25 * broad, up + 0.25 * width
    if not edge and (over < -wide or above < -up):
        return 0.0, False
    return 1.0, edge or over < wide or above < up


@njit(cache=True, error_model="numpy")
def _off_thread(position: float, mesh: float, thread: float) -> float:
    """How far (m) a position on a net is from the nearest thread; negative within it."""
    return float(abs(position - mesh * np.floor(position / mesh + 0.5)) - 0.5 * thread)


@njit(cache=True, error_model="numpy")
def _grating(position: float, period: float, line: float, width: float) -> float:
    """Mean over [position - width / 2, position + width / 2] of a grating: 1 on lines of that width at each period."""
    if width >= period:
        return line / period
    offset = position - period * np.floor(position / period + 0.5)
    low, high = max(offset - 0.5 * width, -0.5 * line), min(offset + 0.5 * width, 0.5 * line)
    return float(max(0.0, high - low) / width)
