"""Where each ray first meets the world: one compiled loop over rays and the bodies in their cell.

A ray runs from its origin along a horizontal unit direction; s is the horizontal distance run, `rise` the height gained
per metre. Codes of what was met: the number of a solid, or one of those below.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.geometry import FloatArray
from touchline.simulation.rendering.meeting import CREASE, meet_ball, meet_upright
from touchline.simulation.rendering.nets import OVER_SAMPLES, beside_net, net_share

_NOWHERE_M = 1e6  # beyond every hall
_SLANT = 0.05  # nets before a wall or the board by less than this share of its distance count as touching it
Room = tuple[float, float, float, float, float, float]
CARPET, FLOOR, BOARD, WALL, CEILING = -1, -2, -3, -4, -8  # walls: east -4, west -5, north -6, south -7


@njit(cache=True, error_model="numpy", inline="always")
def trace_rays(
    cast: npt.NDArray[np.float32],
    extents: npt.NDArray[np.float32],
    shift: float,
    rest: npt.NDArray[np.int32],
    solids: FloatArray,
    starts: npt.NDArray[np.int32],
    items: npt.NDArray[np.int16],
    near: FloatArray,
    room: Room,
    net_angle: float,
    hits: npt.NDArray[np.float32],
    codes: npt.NDArray[np.int32],
    plain: npt.NDArray[np.int32],
    ground: npt.NDArray[np.int32],
    ground_count: int,
    bare: npt.NDArray[np.int32],
    bare_count: int,
    edges: npt.NDArray[np.bool_],
    marking: bool,
) -> tuple[int, int, int]:
    """Find what those of the cast rays (9, N) meet that `rest` (M,) lists; count the upright hits, and what
    `ground` and `bare` hold then.

    extents (3, N), shift: see `casting.spread_rays`. marking: edges are looked for; without it the rays are samples,
    and extents are not read. edges (N,) is set where the rays of a pixel may meet different things; nothing else is
    told of these. room (6,): half length and width of carpet and of hall, ceiling, height of the board around the
    carpet (m). net_angle (rad): over which nets are smoothed. The rays that end on the carpet are appended to `bare`
    where it is plain (N,), else to `ground`. The others stay in `rest`, and so do those that pass nets, with codes (M,)
    and hits (M, 8): x, y, z of the point (m, field frame), s, horizontal direction x and y, across (m per m), share of
    light that nets let by (`OVER_SAMPLES`: it varies within the pixel).
    """
    count = 0
    for n in range(len(rest)):
        i = np.uint32(rest[n])
        ox, oy, oz = float(cast[0, i]), float(cast[1, i]), float(cast[2, i])
        ux, uy, rise = float(cast[3, i]), float(cast[4, i]), float(cast[5, i])
        across, steep, deep = 0.0, 0.0, 0.0
        if marking:
            across, steep, deep = float(extents[0, i]), float(extents[1, i]), float(extents[2, i])
        fall, code, edge_s = float(cast[6, i]), CARPET, np.inf
        s, behind = fall, deep if marking and rise < 0.0 else 0.0
        nets, open_share, cell = False, 1.0, np.uint32(cast[7, i])
        first, last = starts[cell], starts[cell + np.uint32(1)]
        for entry in range(first, last):
            k = np.uint32(items[entry])
            if near[k] > min(s + behind, edge_s):
                break
            ex, ey, radius, kind = solids[k, 1] - ox, solids[k, 2] - oy, solids[k, 9], solids[k, 0]
            lateral, along = ux * ey - uy * ex, ux * ex + uy * ey
            reach = along + radius
            aside, lift = (reach * across + shift, reach * steep + shift) if marking else (0.0, 0.0)
            if abs(lateral) >= radius + aside or reach <= 0.0:
                continue
            if kind == 3.0:
                nets = True
                continue
            vary, begin = aside, along - radius - aside
            if kind == 2.0:
                width = max(aside, lift / np.sqrt(1.0 + rise * rise)) * 1.5
                found, near_outline = meet_ball(along, lateral, oz - radius, rise, radius, width, s + behind)
            else:
                body = (
                    kind, solids[k, 1], solids[k, 2], solids[k, 3], solids[k, 4], solids[k, 5], solids[k, 6],
                    solids[k, 7], solids[k, 8], radius, solids[k, 10], solids[k, 11], solids[k, 12],
                )  # fmt: skip
                found, near_outline, vary, begin = meet_upright(
                    body, along, lateral, ex, ey, oz, ux, uy, rise, aside, lift, across, steep, shift,
                    s + behind + 2.0 * aside,
                )  # fmt: skip
            if marking and near_outline:  # edge_s: where the nearest edge begins; what is met before it hides it
                edge_s = min(edge_s, begin if kind == 2.0 or found == _NOWHERE_M else found - vary)
            if 0.0 < found < s + behind + vary:
                if marking and code >= 0 and abs(s - found) < behind + vary:
                    edge_s = min(edge_s, min(s - behind, found - vary))
                if found < s:
                    s, code, behind = found, int(k), vary
        edge = marking and edge_s < s + behind
        if code < 0 or _may_be_hidden(ox + s * ux, oy + s * uy, oz + s * rise - s * steep, room, behind + 0.1):
            met, found, border = _background(
                ox, oy, oz, ux, uy, rise, fall, across, steep, deep, shift, room, s if code >= 0 else _NOWHERE_M, behind
            )
            if met == BOARD and edge:  # the feet of what stands behind the board are hidden
                slant = 2.0 * (across * found + shift) * (1.0 / (abs(ux) + 1e-12) + 1.0 / (abs(uy) + 1e-12))
                edge = edge_s < found + slant
            edge = edge or border
            if met < 0:
                s, code, behind = found, met, behind if met >= FLOOR else _SLANT * found
        if nets and not edge:
            for entry in range(first, last):
                k = np.uint32(items[entry])
                if solids[k, 0] != 3.0:
                    continue
                net = (
                    solids[k, 1] - ox, solids[k, 2] - oy, solids[k, 3], solids[k, 4], solids[k, 5], solids[k, 7],
                    solids[k, 8], solids[k, 11], solids[k, 12],
                )  # fmt: skip
                if marking:
                    thread, near_outline = beside_net(net, oz, ux, uy, rise, across, steep, shift, net_angle, s, behind)
                    edge = edge or near_outline
                    open_share = OVER_SAMPLES if thread else open_share
                else:
                    open_share *= net_share(net, oz, ux, uy, rise, net_angle, s)
        if edge:
            edges[i] = True
            continue
        if code == CARPET:
            if plain[i] != 0:
                bare[bare_count] = i
                bare_count += 1
            else:
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
    return count, ground_count, bare_count


@njit(cache=True, error_model="numpy", inline="always")
def _may_be_hidden(x: float, y: float, z: float, room: Room, reach: float) -> bool:
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
    room: Room,
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
        crossed = height < room[5] + up and abs(board - limit) < behind + CREASE * (across * board + shift) * per
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
