"""Where each ray first meets the world: one loop over rays and the bodies in their cell.

A ray runs from its origin along a horizontal unit direction (ux, uy); s is the horizontal distance run (m), `rise` the
height gained per metre. Codes of what was met: the number of a solid, or one of those below.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.geometry import Float32Array, FloatArray, Int32Array
from touchline_lab.simulation.rendering import solids as body
from touchline_lab.simulation.rendering.scene import SceneArrays

_NOWHERE_M = 1e6  # beyond every hall
CARPET, FLOOR, BOARD, WALL, CEILING = -1, -2, -3, -4, -8  # walls: east -4, west -5, north -6, south -7


class Hits(NamedTuple):
    """What rays met. codes (N,); places (4, N) float32: x, y, z (m, field frame), share of light that nets let by."""

    codes: Int32Array
    places: Float32Array


class Ray(NamedTuple):
    """Origin (m), horizontal unit direction, height gained per metre."""

    x: float
    y: float
    z: float
    ux: float
    uy: float
    rise: float


@njit(cache=True, error_model="numpy")
def trace_rays(scene: SceneArrays, cast: Float32Array, count: int, net_angle: float, hits: Hits) -> None:
    """Fill the first `count` hits of cast rays (9, >= count), see `casting`; net_angle (rad): the width of a ray."""
    solids, starts, items, near = scene.solids, scene.cells.starts, scene.cells.items, scene.cells.near
    for i in range(count):
        ray = Ray(
            float(cast[0, i]), float(cast[1, i]), float(cast[2, i]),
            float(cast[3, i]), float(cast[4, i]), float(cast[5, i]),
        )  # fmt: skip
        code, s = _background(ray, float(cast[6, i]), scene.room)
        cell = np.int64(cast[7, i])
        nets, open_ratio = False, 1.0
        for entry in range(starts[cell], starts[cell + 1]):
            k = items[entry]
            if near[k] > s:
                break
            ex, ey = solids[k, body.X] - ray.x, solids[k, body.Y] - ray.y
            along, lateral = ray.ux * ex + ray.uy * ey, ray.ux * ey - ray.uy * ex
            if abs(lateral) >= solids[k, body.RADIUS] or along + solids[k, body.RADIUS] <= 0.0:
                continue
            if solids[k, body.KIND] == body.NET:
                nets = True
                continue
            found = _meet(solids, k, ray, along, lateral)
            if 0.0 < found < s:
                s, code = found, k
        if nets:
            for entry in range(starts[cell], starts[cell + 1]):
                if solids[items[entry], body.KIND] == body.NET:
                    open_ratio *= net_ratio(solids, items[entry], ray, net_angle, s)
        hits.codes[i] = code
        hits.places[0, i], hits.places[1, i] = ray.x + s * ray.ux, ray.y + s * ray.uy
        hits.places[2, i], hits.places[3, i] = ray.z + s * ray.rise, open_ratio


@njit(cache=True, error_model="numpy")
def _meet(solids: FloatArray, k: int, ray: Ray, along: float, lateral: float) -> float:
    """Distance s (m) at which a ray enters solid k, 1e6 where it misses it.

    Its middle lies `along` the ray and `lateral` to its left (m).
    """
    radius, kind = solids[k, body.RADIUS], solids[k, body.KIND]
    if kind == body.BALL:
        height, a = ray.z - radius, 1.0 + ray.rise * ray.rise
        b = along - height * ray.rise
        inside = b * b - a * (along * along + lateral * lateral + height * height - radius * radius)
        return float((b - np.sqrt(inside)) / a) if inside > 0.0 else _NOWHERE_M
    if kind == body.BOX:
        c, s = solids[k, body.COS], solids[k, body.SIN]
        ex, ey = solids[k, body.X] - ray.x, solids[k, body.Y] - ray.y
        vx, vy = ray.ux * c + ray.uy * s, ray.uy * c - ray.ux * s
        per_x, per_y = 1.0 / (vx if vx != 0.0 else 1e-12), 1.0 / (vy if vy != 0.0 else 1e-12)
        middle_x, middle_y = (ex * c + ey * s) * per_x, (ey * c - ex * s) * per_y
        half_x, half_y = solids[k, body.HALF_LENGTH] * abs(per_x), solids[k, body.HALF_WIDTH] * abs(per_y)
        enter, leave = max(middle_x - half_x, middle_y - half_y), min(middle_x + half_x, middle_y + half_y)
    else:
        half = np.sqrt(max(radius * radius - lateral * lateral, 0.0))
        enter, leave = along - half, along + half
    if enter >= leave or leave <= 0.0:
        return _NOWHERE_M
    bottom, top, height = solids[k, body.BOTTOM], solids[k, body.TOP], ray.z + enter * ray.rise
    if bottom <= height <= top:
        return float(enter)
    found = ((top if height > top else bottom) - ray.z) / (ray.rise if ray.rise != 0.0 else 1e-12)
    return float(found) if enter < found < leave else _NOWHERE_M


@njit(cache=True, error_model="numpy")
def _background(ray: Ray, ground: float, room: FloatArray) -> tuple[int, float]:
    """Code and distance of carpet, board, floor, wall or ceiling. ground: distance (m) of the ground.

    room (8,): half length and width of carpet, of what the board stands around, of hall, then height of the ceiling
    and of the board (m).
    """
    x, y = abs(ray.x + ground * ray.ux), abs(ray.y + ground * ray.uy)
    if ray.rise < 0.0 and x <= room[0] and y <= room[1]:
        return CARPET, ground
    per_x, per_y = 1.0 / (abs(ray.ux) + 1e-12), 1.0 / (abs(ray.uy) + 1e-12)
    along_x, along_y = (ray.x if ray.ux > 0.0 else -ray.x), (ray.y if ray.uy > 0.0 else -ray.y)
    if room[7] > 0.0 and abs(ray.x) < room[2] and abs(ray.y) < room[3]:
        board = min((room[2] - along_x) * per_x, (room[3] - along_y) * per_y)
        if board < ground and ray.z + board * ray.rise < room[7]:
            return BOARD, board
    wall_x, wall_y = (room[4] - along_x) * per_x, (room[5] - along_y) * per_y
    wall = min(wall_x, wall_y)
    if ground < wall:
        return FLOOR, ground
    if ray.rise > 0.0 and ray.z + wall * ray.rise > room[6]:
        return CEILING, (room[6] - ray.z) / ray.rise
    if wall_x <= wall_y:
        return WALL - (0 if ray.ux > 0.0 else 1), wall
    return WALL - (2 if ray.uy > 0.0 else 3), wall


@njit(cache=True, error_model="numpy")
def net_ratio(solids: FloatArray, k: int, ray: Ray, net_angle: float, limit: float) -> float:
    """Share of a ray, net_angle (rad) wide, that passes between the threads of net k before it ends at `limit` (m)."""
    c, s = solids[k, body.COS], solids[k, body.SIN]
    ex, ey = solids[k, body.X] - ray.x, solids[k, body.Y] - ray.y
    vx, vy = ray.ux * c + ray.uy * s, ray.uy * c - ray.ux * s
    if vy == 0.0:
        return 1.0
    far = (ey * c - ex * s) / vy
    along, height = far * vx - (ex * c + ey * s), ray.z + far * ray.rise
    inside = abs(along) <= solids[k, body.HALF_LENGTH] and solids[k, body.BOTTOM] <= height <= solids[k, body.TOP]
    if not 0.0 < far < limit or not inside:
        return 1.0
    mesh, thread, width = solids[k, body.BANDS], solids[k, body.DECAL], far * net_angle
    upright = _grating(along, mesh, thread, width / max(abs(vy), 0.1))
    return (1.0 - upright) * (1.0 - _grating(height, mesh, thread, width))


@njit(cache=True, error_model="numpy")
def _grating(position: float, period: float, line: float, width: float) -> float:
    """Mean over [position - width / 2, position + width / 2] of a grating: 1 on lines of that width at each period."""
    if width >= period:
        return line / period
    offset = position - period * np.floor(position / period + 0.5)
    low, high = max(offset - 0.5 * width, -0.5 * line), min(offset + 0.5 * width, 0.5 * line)
    return float(max(0.0, high - low) / width)
