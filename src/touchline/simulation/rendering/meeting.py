"""Where a ray meets one body, and whether rays close beside it may meet another part of it, or miss it.

Bodies are rows of the table in `solids`. Rays run along a horizontal unit direction (ux, uy); s is the horizontal
distance run (m), `rise` the height gained per metre, oz the height of the origin. A pixel's rays reach `aside` (m) to
both sides at the body and change the height there by up to `lift` (m): 0 for a single ray. The loops take numbers, no
arrays: Numba counts references to every array handed on, which costs as much as meeting a body.
"""

from __future__ import annotations

import numpy as np
from numba import njit

Body = tuple[float, float, float, float, float, float, float, float, float, float, float, float, float]
_NOWHERE_M = 1e6  # beyond every hall
_GRAZING = 1e-3
RIM_M = 1e-4  # so near to its upper or lower end a side is shaded as the end is
CREASE = 1.3  # distances of a slanting face vary by so much more within a pixel than along its middle


@njit(cache=True, error_model="numpy", inline="always")
def meet_upright(
    body: Body,
    along: float,
    lateral: float,
    ex: float,
    ey: float,
    oz: float,
    ux: float,
    uy: float,
    rise: float,
    aside: float,
    lift: float,
    across: float,
    steep: float,
    shift: float,
    limit: float,
) -> tuple[float, bool, float, float]:
    """Distance s (m) at which a ray enters a cylinder or box, 1e6 where it misses it, and whether an edge is near.

    Third is how much (m) that distance varies within the pixel; fourth, where this ray misses the body, from where on
    (m) others of the pixel may meet it.

    body: its row. ex, ey: from the ray's origin to the middle, which lies `along` the ray and `lateral` to its left.
    aside, lift: at the far end of the body; across, steep: the same per metre, shift (m): what they begin with. Edges
    that begin beyond `limit` (m) are hidden.
    """  # fmt: skip
    bottom, top = body[7], body[8]
    if body[0] == 0.0:
        outer, inner = body[9] + aside, body[9] * body[9] - lateral * lateral
        half = np.sqrt(max(outer * outer - lateral * lateral, 0.0))
        begin = along - half
        if not _within(begin, along + half, limit, oz, rise, bottom - lift, top + lift):
            return _NOWHERE_M, False, 0.0, 0.0
        half = np.sqrt(max(inner, 0.0))
        found, side = _into_prism(along - half, along + half, oz, rise, bottom, top)
        if aside == 0.0 or found == _NOWHERE_M:
            return found, True, 0.0, _enter_level(begin, oz, rise, bottom - lift, top + lift, steep)
        if side:
            beside = abs(lateral) + across * along + shift
            if beside > body[9]:  # rays further in meet it much nearer
                return found, True, found - begin, 0.0
            vary = half - np.sqrt(body[9] * body[9] - beside * beside)
            near = _near_level(body, oz + found * rise, steep * along + shift + abs(rise) * vary)
            return found, near, vary + aside, 0.0
        deep = (steep * found + shift) / max(abs(rise) - steep, 1e-6)
        near = (found - along) ** 2 + lateral * lateral > max(body[9] - np.sqrt(deep * deep + aside * aside), 0.0) ** 2
        return found, near, deep, 0.0
    c, s = body[3], body[4]
    lx, ly, vx, vy = ex * c + ey * s, ey * c - ex * s, ux * c + uy * s, uy * c - ux * s
    per_x, per_y = 1.0 / (vx if vx != 0.0 else 1e-12), 1.0 / (vy if vy != 0.0 else 1e-12)
    middle_x, middle_y = lx * per_x, ly * per_y
    half_x, half_y = (body[5] + aside) * abs(per_x), (body[6] + aside) * abs(per_y)
    begin, leave = max(middle_x - half_x, middle_y - half_y), min(middle_x + half_x, middle_y + half_y)
    if not _within(begin, leave, limit, oz, rise, bottom - lift, top + lift):
        return _NOWHERE_M, False, 0.0, 0.0
    half_x, half_y = body[5] * abs(per_x), body[6] * abs(per_y)
    enter, leave = max(middle_x - half_x, middle_y - half_y), min(middle_x + half_x, middle_y + half_y)
    found, side = _into_prism(enter, leave, oz, rise, bottom, top)
    if aside == 0.0 or found == _NOWHERE_M:
        return found, True, 0.0, _enter_level(begin, oz, rise, bottom - lift, top + lift, steep)
    if side:
        on_broad_side = middle_y - half_y > middle_x - half_x
        facing, over = (abs(vy), abs(vx)) if on_broad_side else (abs(vx), abs(vy))
        per = 1.0 / max(facing, _GRAZING)
        farthest = (found + shift * per * over) / max(1.0 - across * per * over, 0.05)
        wide = min(across * farthest + shift, aside) * per
        vary, up = wide * over, min(steep * farthest + shift, lift) + abs(rise) * wide * over
        x, y = abs(found * vx - lx), abs(found * vy - ly)
        near = _near_edge_of_box(body, x, y, on_broad_side, oz + found * rise, wide, up)
        return found, near, CREASE * vary + aside, 0.0
    deep = (steep * found + shift) / max(abs(rise) - steep, 1e-6)
    over_x = body[5] - abs(found * vx - lx) < abs(vx) * deep + abs(vy) * aside
    near = over_x or body[6] - abs(found * vy - ly) < abs(vy) * deep + abs(vx) * aside
    return found, near, deep, 0.0


@njit(cache=True, error_model="numpy", inline="always")
def _within(enter: float, leave: float, limit: float, oz: float, rise: float, bottom: float, top: float) -> bool:
    """Whether a ray that is inside an outline over [enter, leave] is between two heights there, before the limit."""
    low, high = oz + max(enter, 0.0) * rise, oz + min(leave, limit) * rise
    return enter < leave and leave > 0.0 and enter <= limit and max(low, high) >= bottom and min(low, high) <= top


@njit(cache=True, error_model="numpy", inline="always")
def _enter_level(enter: float, oz: float, rise: float, bottom: float, top: float, steep: float) -> float:
    """Where rays whose rise is up to `steep` off this one's are first past `enter` and between two heights."""
    if oz > top:
        return max(enter, (oz - top) / max(steep - rise, 1e-9))
    return max(enter, (bottom - oz) / max(steep + rise, 1e-9)) if oz < bottom else enter


@njit(cache=True, error_model="numpy", inline="always")
def _into_prism(enter: float, leave: float, oz: float, rise: float, bottom: float, top: float) -> tuple[float, bool]:
    """Where a ray that is inside an outline over [enter, leave] enters the prism, and whether through its side."""
    if enter >= leave or leave <= 0.0:
        return _NOWHERE_M, False
    height = oz + enter * rise
    if bottom <= height <= top:
        return enter, True
    found = ((top if height > top else bottom) - oz) / (rise if rise != 0.0 else 1e-12)
    return (found if enter < found < leave else _NOWHERE_M), False


@njit(cache=True, error_model="numpy")
def meet_ball(
    along: float, lateral: float, height: float, rise: float, radius: float, reach: float, limit: float
) -> tuple[float, bool]:
    """Distance s (m) of a ball, 1e6 where the ray misses it, and whether its outline is within `reach` (m) of the ray.

    height: of the ray's origin above the ball's middle.
    """
    a = 1.0 + rise * rise
    b = along - height * rise
    inside = b * b - a * (along * along + lateral * lateral + height * height - radius * radius)
    drop = height + rise * along
    edge = abs(np.sqrt(lateral * lateral + drop * drop / a) - radius) < reach and along - radius < limit
    return ((b - np.sqrt(inside)) / a if inside > 0.0 else _NOWHERE_M), edge


@njit(cache=True, error_model="numpy", inline="always")
def _near_edge_of_box(
    body: Body, x: float, y: float, on_broad_side: bool, height: float, wide: float, up: float
) -> bool:
    """Whether a corner, a band's or the decal's edge is near the point where a ray enters a box.

    x, y: distance of the point from the middle in the box's frame. The pixel reaches `wide` along the face, `up` it.
    """
    if (body[5] - x if on_broad_side else body[6] - y) < wide:
        return True
    if on_broad_side and body[12] >= 0.0:
        off_x = x - 0.5 * body[5]
        off_z = abs(height - 0.5 * (body[7] + body[8])) - 0.17 * (body[8] - body[7])
        if max(abs(off_x) - wide, off_z - up) < 0.0 or max(abs(off_z) - up, off_x - wide) < 0.0:
            return True
    return _near_level(body, height, up)


@njit(cache=True, error_model="numpy", inline="always")
def _near_level(body: Body, height: float, up: float) -> bool:
    """Whether the lower or upper end or an edge between bands is within `up` (m) of a height."""
    bottom, top = height - body[7], body[8] - height
    if min(bottom, top) < up + RIM_M:
        return True
    if body[11] == 1.0:
        return False
    band = (bottom + top) / body[11]
    level = bottom / band
    return bool(abs(level - np.round(level)) * band < up)
