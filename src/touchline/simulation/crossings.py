"""Where a detector's scan paths cross the field's paint: the geometry of the observation level, in compiled loops.

Rays from the robot and circles about it, as in `touchline.perception.scan_lines`; nothing is drawn at random here.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from touchline.camera import OmniCamera
from touchline.field.distance_map import lookup
from touchline.geometry import FloatArray

# of a crossing: x, y (m, base frame), path, paint along the path (m), metres per pixel along it, whether it is a disc,
# growth of the scale outwards (metres per pixel and metre)
COLUMNS = 7
SCALE_STEP_M = 0.01
_MOST_PER_PATH = 64


@njit(cache=True, error_model="numpy")
def _add(hits, count, where, sine, disc):  # type: ignore[no-untyped-def]
    """Append (where on the path, sine of the crossing's angle or chord of a disc, disc) and return the new count."""
    if count < len(hits):
        hits[count, 0], hits[count, 1], hits[count, 2] = where, sine, disc
        count += 1
    return count


@njit(cache=True, error_model="numpy")
def _on_arc(angle, start, sweep):  # type: ignore[no-untyped-def]
    return (angle - start) % (2.0 * math.pi) <= sweep


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
def hidden(x, y, px, py, bodies):  # type: ignore[no-untyped-def]
    """Whether the ground at px, py is hidden from x, y by one of the bodies (K, 4); field frame, m.

    Each is x, y, radius and `reach`: its top hides the ground up to that multiple of its far side's distance, which is
    the view's height over the view's height above the top; infinite for what is as high as the view.
    """
    dx, dy = px - x, py - y
    distance = math.sqrt(dx * dx + dy * dy)
    for i in range(len(bodies)):
        ox, oy, radius = bodies[i, 0] - x, bodies[i, 1] - y, bodies[i, 2]
        along = (ox * dx + oy * dy) / max(distance, 1e-9)
        if along <= 0.0:
            continue
        square = radius * radius - (ox * ox + oy * oy - along * along)
        if square <= 0.0:
            continue
        half = math.sqrt(square)
        if along - half < distance < (along + half) * bodies[i, 3]:
            return True
    return False


@njit(cache=True, error_model="numpy")
def _green(px, py, least, carpet, grid):  # type: ignore[no-untyped-def]
    """Whether there is carpet without paint at px, py. grid: values, origin x, y, resolution of the distance map."""
    if abs(px) > carpet[0] or abs(py) > carpet[1]:
        return False
    return lookup(grid[0], grid[1], grid[2], grid[3], px, py)[0] > least


@njit(cache=True, error_model="numpy")
def _shadows(x, y, cx, sx, bodies, shadows):  # type: ignore[no-untyped-def]
    """Stretches (K, 2) of a ray, from and to (m), that bodies (K, 4) hide, into shadows; returns how many."""
    count = 0
    for i in range(len(bodies)):
        ox, oy = bodies[i, 0] - x, bodies[i, 1] - y
        along = ox * cx + oy * sx
        square = bodies[i, 2] * bodies[i, 2] - (ox * ox + oy * oy - along * along)
        if along > 0.0 and square > 0.0:
            half = math.sqrt(square)
            shadows[count, 0], shadows[count, 1] = along - half, (along + half) * bodies[i, 3]
            count += 1
    return count


@njit(cache=True, error_model="numpy")
def _ray_is_clear(along, chord, reach_m, scale, ray, view, shadows, width, carpet, grid):  # type: ignore[no-untyped-def]
    """Whether there is green on both sides of a crossing. ray: direction; view: x, y; shadows: hidden stretches."""
    for step in (-0.5 * chord - reach_m, -0.5 * chord - scale, 0.5 * chord + scale, 0.5 * chord + reach_m):
        place = along + step
        for i in range(len(shadows)):
            if shadows[i, 0] < place < shadows[i, 1]:
                return False
        if not _green(view[0] + place * ray[0], view[1] + place * ray[1], 0.5 * width, carpet, grid):
            return False
    return True


@njit(cache=True, error_model="numpy")
def _circle_is_clear(angle, chord, reach_m, scale, reach, view, bodies, width, carpet, grid):  # type: ignore[no-untyped-def]
    """The same on a circle of the radius `reach` about the view; angle: direction of the crossing (field frame)."""
    for step in (-0.5 * chord - reach_m, -0.5 * chord - scale, 0.5 * chord + scale, 0.5 * chord + reach_m):
        turned = angle + step / reach
        px, py = view[0] + reach * math.cos(turned), view[1] + reach * math.sin(turned)
        if not _green(px, py, 0.5 * width, carpet, grid) or hidden(view[0], view[1], px, py, bodies):
            return False
    return True


@njit(cache=True, error_model="numpy")
def find_crossings(  # type: ignore[no-untyped-def]
    pose, rays, circles, limits, paint, bodies, carpet, grid, scales, out
):
    """Paint that a detector could find from a pose (3,), into out (M, COLUMNS); returns how many.

    rays (P, 3): bearing (rad, base frame), nearest and farthest range (m); circles (Q, 2): range (m), pixels of radius.
    limits: line width, longest chord in line widths, flank and blur (pixels). paint: segments, rounds, discs.
    bodies (K, 4), see `hidden`. carpet: half length and half width. scales (T,): see `scale_table`.
    """
    x, y, heading = pose
    view = (x, y)
    width, steepest, flank_px, blur_px = limits
    segments, rounds, discs = paint
    hits, shadows = np.empty((_MOST_PER_PATH, 3)), np.empty((len(bodies), 2))
    found = 0
    for p in range(len(rays)):
        ray = (math.cos(rays[p, 0] + heading), math.sin(rays[p, 0] + heading))
        count = ray_hits(x, y, ray[0], ray[1], segments, rounds, discs, hits)
        dark = _shadows(x, y, ray[0], ray[1], bodies, shadows)
        for h in range(count):
            along = hits[h, 0]
            chord = hits[h, 1] if hits[h, 2] > 0.0 else width / max(hits[h, 1], 1e-6)
            if not rays[p, 1] <= along <= rays[p, 2] or chord > (steepest + blur_px) * width or found >= len(out):
                continue
            bx, by = along * math.cos(rays[p, 0]), along * math.sin(rays[p, 0])
            scale = scale_at(along, scales)
            if math.isnan(scale) or chord > steepest * width + 0.5 * blur_px * scale:
                continue
            near, far = along - 0.5 * chord - flank_px * scale, along + 0.5 * chord + scale
            reach_m = (flank_px + 1.0) * scale
            if (
                near < rays[p, 1]
                or far > rays[p, 2]
                or not _ray_is_clear(along, chord, reach_m, scale, ray, view, shadows[:dark], width, carpet, grid)
            ):
                continue
            row = out[found]
            row[0], row[1], row[2], row[3], row[4], row[5] = bx, by, p, chord, scale, hits[h, 2]
            row[6] = (scale_at(along + SCALE_STEP_M, scales) - scale) / SCALE_STEP_M
            found += 1
    for q in range(len(circles)):
        reach, scale = circles[q, 0], circles[q, 0] / circles[q, 1]
        count = circle_hits(x, y, reach, segments, rounds, discs, hits)
        for h in range(count):
            chord = hits[h, 1] if hits[h, 2] > 0.0 else width / max(hits[h, 1], 1e-6)
            if chord > steepest * width + 0.5 * blur_px * scale or found >= len(out):
                continue
            reach_m = (flank_px + 1.0) * scale
            if not _circle_is_clear(hits[h, 0], chord, reach_m, scale, reach, view, bodies, width, carpet, grid):
                continue
            angle, row = hits[h, 0] - heading, out[found]
            row[0], row[1] = reach * math.cos(angle), reach * math.sin(angle)
            row[2], row[3], row[4], row[5], row[6] = len(rays) + q, chord, scale, hits[h, 2], 0.0
            found += 1
    return found


@njit(cache=True, error_model="numpy")
def scale_at(along, scales):  # type: ignore[no-untyped-def]
    """Metres per pixel outwards at a ground range (m). scales (T,): at ranges SCALE_STEP_M apart from 0 on."""
    position = along / SCALE_STEP_M
    k = int(position)
    if k >= len(scales) - 1:
        return np.nan
    return scales[k] + (position - k) * (scales[k + 1] - scales[k])


def scale_table(camera: OmniCamera, farthest_m: float) -> FloatArray:
    """(T,) metres per pixel outwards at ground ranges SCALE_STEP_M apart from 0 on; the mean over all directions."""
    ranges = camera.range_m.mean(axis=0)
    middles = 0.5 * (ranges[1:] + ranges[:-1])
    scales = np.diff(ranges) / np.diff(camera.radius_px)
    table: FloatArray = np.interp(np.arange(0.0, farthest_m + 2.0 * SCALE_STEP_M, SCALE_STEP_M), middles, scales)
    return table


def round_table(circles: FloatArray, arcs: FloatArray) -> FloatArray:
    """(C + A, 5) cx, cy, radius, start, sweep of circles (C, 3) and arcs (A, 5) with start and end angle (rad)."""
    whole = np.column_stack((circles, np.zeros(len(circles)), np.full(len(circles), 2.0 * math.pi)))
    sweeps = np.mod(arcs[:, 4] - arcs[:, 3], 2.0 * math.pi)
    sweeps[sweeps < 1e-5] = 2.0 * math.pi
    parts = np.column_stack((arcs[:, :4], sweeps))
    return np.ascontiguousarray(np.concatenate((whole.reshape(-1, 5), parts.reshape(-1, 5))))
