"""Where a detector's scan paths cross the field's paint: the geometry of the observation level, in compiled loops.

Rays from the robot and circles about it, as in `touchline.perception.scan_lines`; nothing is drawn at random here.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from touchline.camera.omni import ground_from_pixel, pixel_from_ground
from touchline.field.distance_map import lookup
from touchline.geometry import FloatArray

COLUMNS = 6  # of a crossing: x, y (m, base frame), path, paint across the path (m), metres per pixel along it, disc
_MOST_PER_PATH = 64


@njit(cache=True)
def _add(hits, count, where, sine, disc):  # type: ignore[no-untyped-def]
    """Append (where on the path, sine of the crossing's angle or chord of a disc, disc) and return the new count."""
    if count < len(hits):
        hits[count, 0], hits[count, 1], hits[count, 2] = where, sine, disc
        count += 1
    return count


@njit(cache=True)
def _on_arc(angle, start, sweep):  # type: ignore[no-untyped-def]
    return (angle - start) % (2.0 * math.pi) <= sweep


@njit(cache=True)
def ray_hits(x, y, cx, sx, segments, rounds, discs, hits):  # type: ignore[no-untyped-def]
    """Crossings of a ray from x, y along (cx, sx) with the paint, into hits (K, 3); returns how many.

    segments (S, 4); rounds (R, 5): cx, cy, radius, start, sweep (rad); discs (D, 3); all m, field frame.
    """
    count = 0
    for i in range(len(segments)):
        ax, ay = segments[i, 0] - x, segments[i, 1] - y
        dx, dy = segments[i, 2] - segments[i, 0], segments[i, 3] - segments[i, 1]
        length = math.sqrt(dx * dx + dy * dy)
        cross = cx * dy - sx * dx
        if abs(cross) < 1e-9 * length:
            continue
        along = (ax * dy - ay * dx) / cross
        share = (ax * sx - ay * cx) / cross
        if along > 0.0 and 0.0 <= share <= 1.0:
            count = _add(hits, count, along, abs(cross) / length, 0.0)
    for i in range(len(rounds) + len(discs)):
        disc = i >= len(rounds)
        ox = (discs[i - len(rounds), 0] if disc else rounds[i, 0]) - x
        oy = (discs[i - len(rounds), 1] if disc else rounds[i, 1]) - y
        radius = 0.5 * discs[i - len(rounds), 2] if disc else rounds[i, 2]
        middle = ox * cx + oy * sx
        half = radius * radius - (ox * ox + oy * oy - middle * middle)
        if half <= 0.0:
            continue
        half = math.sqrt(half)
        if disc:
            if middle > 0.0:
                count = _add(hits, count, middle, 2.0 * half, 1.0)
            continue
        for sign in (-1.0, 1.0):
            along = middle + sign * half
            if along <= 0.0:
                continue
            angle = math.atan2(along * sx - oy, along * cx - ox)
            if rounds[i, 4] > 6.2831 or _on_arc(angle, rounds[i, 3], rounds[i, 4]):
                count = _add(hits, count, along, half / radius, 0.0)
    return count


@njit(cache=True)
def circle_hits(x, y, reach, segments, rounds, discs, hits):  # type: ignore[no-untyped-def]
    """Crossings of a circle about x, y with the paint as direction (rad, field frame) and sine; as `ray_hits`."""
    count = 0
    for i in range(len(segments)):
        ax, ay = segments[i, 0] - x, segments[i, 1] - y
        dx, dy = segments[i, 2] - segments[i, 0], segments[i, 3] - segments[i, 1]
        length = math.sqrt(dx * dx + dy * dy)
        dx, dy = dx / length, dy / length
        foot = -(ax * dx + ay * dy)
        off = ax * dy - ay * dx
        half = reach * reach - off * off
        if half <= 0.0:
            continue
        half = math.sqrt(half)
        for sign in (-1.0, 1.0):
            along = foot + sign * half
            if 0.0 <= along <= length:
                angle = math.atan2(ay + along * dy, ax + along * dx)
                count = _add(hits, count, angle, half / reach, 0.0)
    for i in range(len(rounds)):
        ox, oy = rounds[i, 0] - x, rounds[i, 1] - y
        apart, radius = math.sqrt(ox * ox + oy * oy), rounds[i, 2]
        if apart < 1e-9 or not abs(reach - radius) < apart < reach + radius:
            continue
        cosine = (reach * reach + apart * apart - radius * radius) / (2.0 * reach * apart)
        between = (reach * reach + radius * radius - apart * apart) / (2.0 * reach * radius)
        sine = math.sqrt(max(1.0 - between * between, 0.0))
        for sign in (-1.0, 1.0):
            angle = math.atan2(oy, ox) + sign * math.acos(min(max(cosine, -1.0), 1.0))
            place = math.atan2(y + reach * math.sin(angle) - rounds[i, 1], x + reach * math.cos(angle) - rounds[i, 0])
            if rounds[i, 4] > 6.2831 or _on_arc(place, rounds[i, 3], rounds[i, 4]):
                count = _add(hits, count, angle, sine, 0.0)
    for i in range(len(discs)):
        ox, oy, radius = discs[i, 0] - x, discs[i, 1] - y, 0.5 * discs[i, 2]
        off = math.sqrt(ox * ox + oy * oy) - reach
        if abs(off) < radius:
            count = _add(hits, count, math.atan2(oy, ox), 2.0 * math.sqrt(radius * radius - off * off), 1.0)
    return count


@njit(cache=True)
def hidden(x, y, px, py, occluders):  # type: ignore[no-untyped-def]
    """Whether the ground at px, py is hidden from x, y by one of the occluders (K, 4); field frame, m.

    Each is x, y, radius and `reach`: its top hides the ground up to that multiple of its far side's distance, which is
    the view's height over the view's height above the top; infinite for what is as high as the view.
    """
    dx, dy = px - x, py - y
    distance = math.sqrt(dx * dx + dy * dy)
    for i in range(len(occluders)):
        ox, oy, radius = occluders[i, 0] - x, occluders[i, 1] - y, occluders[i, 2]
        along = (ox * dx + oy * dy) / max(distance, 1e-9)
        if along <= 0.0:
            continue
        square = radius * radius - (ox * ox + oy * oy - along * along)
        if square <= 0.0:
            continue
        half = math.sqrt(square)
        if along - half < distance < (along + half) * occluders[i, 3]:
            return True
    return False


@njit(cache=True)
def _green(px, py, least, carpet, grid):  # type: ignore[no-untyped-def]
    """Whether there is carpet without paint at px, py. grid: values, origin x, y, resolution of the distance map."""
    if abs(px) > carpet[0] or abs(py) > carpet[1]:
        return False
    return lookup(grid[0], grid[1], grid[2], grid[3], px, py)[0] > least


@njit(cache=True)
def find_crossings(  # type: ignore[no-untyped-def]
    pose, rays, circles, limits, paint, occluders, carpet, grid, camera, out
):
    """Paint that a detector could find from a pose (3,), into out (M, COLUMNS); returns how many.

    rays (P, 3): bearing (rad, base frame), nearest and farthest range (m); circles (Q, 2): range (m), pixels of radius.
    limits: line width, longest chord in line widths, flank and blur (pixels). paint: segments, rounds, discs. occluders (K, 4).
    carpet: half length and half width. camera: constants, bearings, ranges of an OmniCamera's look-up.
    """
    x, y, heading = pose
    width, steepest, flank_px, blur_px = limits
    segments, rounds, discs = paint
    hits = np.empty((_MOST_PER_PATH, 3))
    found = 0
    for p in range(len(rays) + len(circles)):
        ray = p < len(rays)
        if ray:
            bearing = rays[p, 0] + heading
            cx, sx = math.cos(bearing), math.sin(bearing)
            count = ray_hits(x, y, cx, sx, segments, rounds, discs, hits)
        else:
            reach = circles[p - len(rays), 0]
            count = circle_hits(x, y, reach, segments, rounds, discs, hits)
        for h in range(count):
            if found >= len(out):
                return found
            chord = hits[h, 1] if hits[h, 2] > 0.0 else width / max(hits[h, 1], 1e-6)
            if ray:
                along = hits[h, 0]
                if not rays[p, 1] <= along <= rays[p, 2]:
                    continue
                bx, by = along * math.cos(rays[p, 0]), along * math.sin(rays[p, 0])
                scale = _ray_scale(bx, by, camera)
            else:
                angle = hits[h, 0] - heading
                bx, by = reach * math.cos(angle), reach * math.sin(angle)
                scale = reach / circles[p - len(rays), 1]
            if math.isnan(scale) or chord > steepest * width + 0.5 * blur_px * scale:
                continue
            reach_px = flank_px + 1.0
            if ray and not (
                rays[p, 1] + flank_px * scale <= along - 0.5 * chord and along + 0.5 * chord + scale <= rays[p, 2]
            ):
                continue
            clear = True
            for step in (-0.5 * chord - reach_px * scale, -0.5 * chord - scale, 0.5 * chord + scale,
                         0.5 * chord + reach_px * scale):  # fmt: skip
                if ray:
                    px, py = x + (along + step) * cx, y + (along + step) * sx
                else:
                    turned = hits[h, 0] + step / reach
                    px, py = x + reach * math.cos(turned), y + reach * math.sin(turned)
                if hidden(x, y, px, py, occluders) or not _green(px, py, 0.5 * width, carpet, grid):
                    clear = False
                    break
            if not clear:
                continue
            row = out[found]
            row[0], row[1], row[2], row[3], row[4], row[5] = bx, by, p, chord, scale, hits[h, 2]
            found += 1
    return found


@njit(cache=True)
def _ray_scale(bx, by, camera):  # type: ignore[no-untyped-def]
    """Metres per pixel outwards at a ground point of the base frame; NaN outside the camera's table."""
    u, v = pixel_from_ground(bx, by, camera[0], camera[1], camera[2])
    if math.isnan(u):
        return np.nan
    du, dv = u - camera[0][0], v - camera[0][1]
    radius = math.sqrt(du * du + dv * dv)
    if radius < 1.0:
        return np.nan
    eu, ev = 0.5 * du / radius, 0.5 * dv / radius
    ax, ay = ground_from_pixel(u + eu, v + ev, camera[0], camera[1], camera[2])
    cx, cy = ground_from_pixel(u - eu, v - ev, camera[0], camera[1], camera[2])
    return math.sqrt((ax - cx) ** 2 + (ay - cy) ** 2)


def round_table(circles: FloatArray, arcs: FloatArray) -> FloatArray:
    """(C + A, 5) cx, cy, radius, start, sweep of circles (C, 3) and arcs (A, 5) with start and end angle (rad)."""
    whole = np.column_stack((circles, np.zeros(len(circles)), np.full(len(circles), 2.0 * math.pi)))
    sweeps = np.mod(arcs[:, 4] - arcs[:, 3], 2.0 * math.pi)
    sweeps[sweeps < 1e-5] = 2.0 * math.pi
    parts = np.column_stack((arcs[:, :4], sweeps))
    return np.ascontiguousarray(np.concatenate((whole.reshape(-1, 5), parts.reshape(-1, 5))))
