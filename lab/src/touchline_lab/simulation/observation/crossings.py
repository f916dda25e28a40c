"""Where a detector's scan paths meet the field's paint: the geometry of the observation level, in compiled loops.

Rays from the robot and circles about it, as in `touchline.perception.scan_lines`. What lies side by side on a path
without green between it is one run, as for the detector. Nothing is drawn at random here.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.camera import OmniCamera
from touchline.geometry import FloatArray
from touchline_lab.simulation.observation.runs import BAR, MAX_PER_PATH, circle_runs, near_paint, ray_runs, turned

# of a crossing: x, y (m, base frame), path, paint along the path (m), metres per pixel along it, what it is (LINE, BAR,
# DISC), where it truly begins along the path (pixels; rays only), width of the paint (pixels, at right angles to it),
# sine of the angle between path and paint in the image, place along the path (pixels), what is odd about it, by how
# many pixels it is shorter than the longest that passes for a line
COLUMNS = 12
PLAIN, GRAZED, MIXED = 0.0, 1.0, 2.0  # odd: an edge of a black sector runs along the ray; more than one line
SCALE_STEP_M = 0.01
FLANK = 4  # samples of green wanted on each side, of which one may be another colour (`perception.profiles`)


@njit(cache=True, error_model="numpy")
def scale_at(along, scales, column):  # type: ignore[no-untyped-def]
    """At a ground range (m), from scales (T, 2): metres per pixel outwards (column 0) or the radius in pixels (1)."""
    position = along / SCALE_STEP_M
    k = int(position)
    if k >= len(scales) - 1:
        return np.nan
    return scales[k, column] + (position - k) * (scales[k + 1, column] - scales[k, column])


@njit(cache=True, error_model="numpy")
def range_at(radius, scales, guess):  # type: ignore[no-untyped-def]
    """Ground range (m) at a radius (pixels), from scales (T, 2): see `scale_table`. guess: near which to look (m)."""
    last = len(scales) - 2
    k = min(max(int(guess / SCALE_STEP_M), 0), last) if guess > 0.0 else 0
    while k > 0 and scales[k, 1] > radius:
        k -= 1
    while k < last and scales[k + 1, 1] <= radius:
        k += 1
    return SCALE_STEP_M * (k + (radius - scales[k, 1]) / (scales[k + 1, 1] - scales[k, 1]))


@njit(cache=True, error_model="numpy")
def hidden(x, y, px, py, bodies):  # type: ignore[no-untyped-def]
    """Whether the ground at px, py is hidden from x, y by one of the bodies (K, 4); field frame, m.

    Each is x, y, radius and `reach`: its top hides the ground up to that multiple of its far side's distance, which is
    the view's height over the view's height above the top; infinite for what is as high as the view.
    """
    dx, dy = px - x, py - y
    distance = math.sqrt(dx * dx + dy * dy)
    shorter = 1.0 / max(distance, 1e-9)
    covered = False
    for i in range(len(bodies)):
        covered = covered or _hides(x, y, shorter * dx, shorter * dy, distance, bodies[i])
    return covered


@njit(cache=True, error_model="numpy")
def _hides(x, y, cx, sx, distance, body):  # type: ignore[no-untyped-def]
    """Whether a body (4,) of `hidden` hides the ground at a distance (m) from x, y along (cx, sx)."""
    first, last = _shadow(x, y, cx, sx, body)
    return first < distance < last


@njit(cache=True, error_model="numpy")
def _shadow(x, y, cx, sx, body):  # type: ignore[no-untyped-def]
    """From where to where (m) a body (4,) hides a ray from x, y along (cx, sx); 0, 0 where it stands beside it."""
    ox, oy = body[0] - x, body[1] - y
    along = ox * cx + oy * sx
    square = body[2] * body[2] - (ox * ox + oy * oy - along * along)
    if along <= 0.0 or square <= 0.0:
        return 0.0, 0.0
    half = math.sqrt(square)
    return along - half, (along + half) * body[3]


@njit(cache=True, error_model="numpy")
def _hiding_at(x, y, reach, bodies, near):  # type: ignore[no-untyped-def]
    """Those of the bodies (K, 4) that can hide anything at a distance (m) from x, y, into near (K, 4); how many."""
    count = 0
    for i in range(len(bodies)):
        ox, oy = bodies[i, 0] - x, bodies[i, 1] - y
        distance = math.sqrt(ox * ox + oy * oy)
        if distance - bodies[i, 2] < reach < (distance + bodies[i, 2]) * bodies[i, 3]:
            near[count] = bodies[i]
            count += 1
    return count


@njit(cache=True, error_model="numpy")
def inside_sector(bearing, sectors):  # type: ignore[no-untyped-def]
    """Whether a direction (rad) lies in one of the sectors (B, 2) from, to, counter-clockwise."""
    inside = False
    for i in range(len(sectors)):
        inside = inside or turned(bearing - sectors[i, 0]) <= turned(sectors[i, 1] - sectors[i, 0])
    return inside


@njit(cache=True, error_model="numpy")
def _shadows(x, y, cx, sx, bodies, shadows):  # type: ignore[no-untyped-def]
    """Stretches (K, 2) of a ray, from and to (m), that bodies (K, 4) hide, into shadows; returns how many."""
    count = 0
    for i in range(len(bodies)):
        first, last = _shadow(x, y, cx, sx, bodies[i])
        if last > first:
            shadows[count, 0], shadows[count, 1] = first, last
            count += 1
    return count


@njit(cache=True, error_model="numpy")
def _sorted_runs(runs, count):  # type: ignore[no-untyped-def]
    for i in range(1, count):
        for j in range(i, 0, -1):
            if runs[j, 0] >= runs[j - 1, 0]:
                break
            for c in range(4):
                runs[j, c], runs[j - 1, c] = runs[j - 1, c], runs[j, c]


@njit(cache=True, error_model="numpy")
def _merged(runs, count, gap_px, turn, scales):  # type: ignore[no-untyped-def]
    """Join runs (count, 4), in order, less than gap_px pixels apart; returns how many are left.

    A pixel is `turn` long in the runs' own unit, or, if that is 0, as long as `scales` say.
    """
    left = 0
    for i in range(1, count):
        gap = gap_px * (turn if turn > 0.0 else scale_at(max(runs[left, 1], 0.0), scales, 0))
        if runs[i, 0] - runs[left, 1] < gap:
            runs[left, 1] = max(runs[left, 1], runs[i, 1])
            runs[left, 2] = 0.0
            runs[left, 3] = min(runs[left, 3], runs[i, 3])
        else:
            left += 1
            runs[left] = runs[i]
    return min(left + 1, count)


@njit(cache=True, error_model="numpy")
def _ray_flank(edge, step, view, ray, shadows, carpet):  # type: ignore[no-untyped-def]
    """Whether the samples beyond an edge (m on the ray) are green; step: a pixel away from the paint (m, signed)."""
    missing = 0
    for k in range(FLANK):
        place = edge + (k + 0.8) * step
        px, py = view[0] + place * ray[0], view[1] + place * ray[1]
        seen = abs(px) <= carpet[0] and abs(py) <= carpet[1]
        for i in range(len(shadows)):
            if shadows[i, 0] < place < shadows[i, 1]:
                seen = False
        if not seen:
            missing += 1
    return missing <= 1


@njit(cache=True, error_model="numpy")
def _circle_flank(edge, step, reach, view, heading, bodies, sectors, carpet):  # type: ignore[no-untyped-def]
    """The same on a circle of the radius `reach`; edge and step: directions (rad, field frame)."""
    inside = abs(view[0]) + reach <= carpet[0] and abs(view[1]) + reach <= carpet[1]
    if inside and len(bodies) == 0 and len(sectors) == 0:
        return True
    missing = 0
    for k in range(FLANK):
        angle = edge + (k + 0.8) * step
        cx, sx = math.cos(angle), math.sin(angle)
        seen = inside or (abs(view[0] + reach * cx) <= carpet[0] and abs(view[1] + reach * sx) <= carpet[1])
        for i in range(len(bodies)):
            if seen and _hides(view[0], view[1], cx, sx, reach, bodies[i]):
                seen = False
        if not seen or inside_sector(angle - heading, sectors):
            missing += 1
    return missing <= 1


@njit(cache=True, error_model="numpy")
def through_mouth(x, y, px, py, mouth):  # type: ignore[no-untyped-def]
    """Whether a place px, py in a goal is seen from x, y between its posts, not through a side net (field frame, m).

    mouth (3,): distance of the goal lines from the centre, lowest and highest y between the posts.
    """
    if abs(x) >= mouth[0]:
        return False
    share = (math.copysign(mouth[0], px) - x) / (px - x)
    return mouth[1] < y + share * (py - y) < mouth[2]


@njit(cache=True, error_model="numpy")
def _in_image(chord, sine, width, scale, other, row):  # type: ignore[no-untyped-def]
    """Width of the paint and sine of its crossing in the image, into a row.

    scale, other: metres per pixel on and across the path. For runs that are no plain crossing (sine 0)
    the chord tells how oblique they are.
    """
    slope = sine if sine > 0.0 else min(1.0, width / chord)
    on, across = scale * slope, other * math.sqrt(max(1.0 - slope * slope, 0.0))
    steepness = math.sqrt(on * on + across * across)
    row[7], row[8] = width / steepness, on / steepness


class Ground(NamedTuple):
    """What a detector may find on a field, and where it looks: the same for all images.

    rays (P, 3): bearing (rad, base frame), nearest and farthest range (m); circles (Q, 2): range (m), pixels of radius.
    limits: line width, longest chord in line widths, blur, gap that is bridged and gap that parts (pixels).
    paint: segments, rounds, discs of `runs`. mouth: see `through_mouth`. carpet: half length and half width.
    scales (T, 2): see `scale_table`.
    """

    rays: FloatArray
    circles: FloatArray
    limits: tuple[float, float, float, float, float]
    paint: tuple[FloatArray, FloatArray, FloatArray]
    mouth: FloatArray
    carpet: tuple[float, float]
    scales: FloatArray


@njit(cache=True, error_model="numpy")
def find_crossings(pose, ground, bodies, sectors, out):  # type: ignore[no-untyped-def]
    """Paint that a detector could find from a pose (3,), into out (M, COLUMNS); returns how many.

    bodies (K, 4): see `hidden`. sectors (B, 2): black directions (rad, base frame).
    """
    rays, circles = ground.rays, ground.circles
    farthest = max(rays[:, 2].max() if len(rays) else 0.0, circles[:, 0].max() if len(circles) else 0.0)
    paint = near_paint(pose[0], pose[1], ground.paint, ground.limits[0], farthest)
    found = _on_rays(pose, ground, paint, bodies, sectors, out)
    return _on_circles(pose, ground, paint, bodies, sectors, out, found)


@njit(cache=True, error_model="numpy")
def _on_rays(pose, ground, paint, bodies, sectors, out):  # type: ignore[no-untyped-def]
    """The crossings on rays, from the first row of out on; returns how many."""
    rays, mouth, carpet, scales = ground.rays, ground.mouth, ground.carpet, ground.scales
    x, y, heading = pose
    view = (x, y)
    width, steepest, blur_px, bridged_px, apart_px = ground.limits
    runs, shadows, found = np.empty((MAX_PER_PATH, 4)), np.empty((len(bodies), 2)), 0
    for p in range(len(rays)):
        first, last = rays[p, 1], rays[p, 2]
        grazed = False
        if len(sectors):
            before, after = inside_sector(rays[p, 0] - 0.004, sectors), inside_sector(rays[p, 0] + 0.004, sectors)
            grazed = before != after
            if before and after:
                continue
        ray = (math.cos(rays[p, 0] + heading), math.sin(rays[p, 0] + heading))
        count = ray_runs(x, y, ray[0], ray[1], paint, width, last, runs)
        if count == 0:
            continue
        _sorted_runs(runs, count)
        count = _merged(runs, count, bridged_px, 0.0, scales)
        dark = _shadows(x, y, ray[0], ray[1], bodies, shadows)
        for h in range(count):
            along, chord = 0.5 * (runs[h, 0] + runs[h, 1]), runs[h, 1] - runs[h, 0]
            if not first <= along <= last or found >= len(out):
                continue
            scale = scale_at(along, scales, 0)
            if not chord <= steepest * width + blur_px * scale:  # or no scale known
                continue
            if runs[h, 0] - FLANK * scale < first or runs[h, 1] + FLANK * scale > last:
                continue
            if h > 0 and runs[h, 0] - runs[h - 1, 1] < apart_px * scale:
                continue
            if h + 1 < count and runs[h + 1, 0] - runs[h, 1] < apart_px * scale:
                continue
            lit = _ray_flank(runs[h, 0], -scale, view, ray, shadows[:dark], carpet)
            if not (lit and _ray_flank(runs[h, 1], scale, view, ray, shadows[:dark], carpet)):
                continue
            if runs[h, 3] == BAR and not through_mouth(x, y, x + along * ray[0], y + along * ray[1], mouth):
                continue
            row = out[found]
            radius = scale_at(along, scales, 1)
            row[0], row[1] = along * math.cos(rays[p, 0]), along * math.sin(rays[p, 0])
            row[2], row[3], row[4], row[5] = p, chord, scale, runs[h, 3]
            row[6] = scale_at(max(runs[h, 0], 0.0), scales, 1)
            _in_image(chord, runs[h, 2], width, scale, along / radius, row)
            row[9], row[11] = radius, (steepest * width - chord) / scale + blur_px
            row[10] = GRAZED if grazed else (PLAIN if runs[h, 2] > 0.0 else MIXED)
            found += 1
    return found


@njit(cache=True, error_model="numpy")
def _on_circles(pose, ground, paint, bodies, sectors, out, found):  # type: ignore[no-untyped-def]
    """The crossings on circles, behind the `found` rows of out that are taken; returns how many there are then."""
    rays, circles, mouth, carpet, scales = ground.rays, ground.circles, ground.mouth, ground.carpet, ground.scales
    x, y, heading = pose
    view = (x, y)
    width, steepest, blur_px, bridged_px, apart_px = ground.limits
    runs, near = np.empty((MAX_PER_PATH, 4)), np.empty((len(bodies), 4))
    for q in range(len(circles)):
        reach, scale = circles[q, 0], circles[q, 0] / circles[q, 1]
        count = circle_runs(x, y, reach, paint, width, runs)
        if count == 0:
            continue
        _sorted_runs(runs, count)
        count = _merged(runs, count, bridged_px, 1.0 / circles[q, 1], scales)
        outwards, turn = scale_at(reach, scales, 0), 1.0 / circles[q, 1]
        hiding = near[: _hiding_at(x, y, reach, bodies, near)]
        for h in range(count):
            angle, chord = 0.5 * (runs[h, 0] + runs[h, 1]), (runs[h, 1] - runs[h, 0]) * reach
            if chord > steepest * width + blur_px * scale or found >= len(out):
                continue
            if count > 1:
                before = turned(runs[h, 0] - runs[(h - 1) % count, 1])
                after = turned(runs[(h + 1) % count, 0] - runs[h, 1])
                if min(before, after) < apart_px * turn:
                    continue
            if inside_sector(angle - heading, sectors) or not (
                _circle_flank(runs[h, 0], -turn, reach, view, heading, hiding, sectors, carpet)
                and _circle_flank(runs[h, 1], turn, reach, view, heading, hiding, sectors, carpet)
            ):
                continue
            place = x + reach * math.cos(angle), y + reach * math.sin(angle)
            if runs[h, 3] == BAR and not through_mouth(x, y, place[0], place[1], mouth):
                continue
            row = out[found]
            row[0], row[1] = reach * math.cos(angle - heading), reach * math.sin(angle - heading)
            row[2], row[3], row[4], row[5], row[6] = len(rays) + q, chord, scale, runs[h, 3], 0.0
            _in_image(chord, runs[h, 2], width, scale, outwards, row)
            row[9], row[11] = turned(angle - heading) * circles[q, 1], (steepest * width - chord) / scale + blur_px
            row[10] = PLAIN if runs[h, 2] > 0.0 else MIXED
            found += 1
    return found


def scale_table(camera: OmniCamera, farthest_m: float) -> FloatArray:
    """(T, 2) metres per pixel outwards and radius (pixels) at ground ranges SCALE_STEP_M apart from 0 on.

    The mean over all directions.
    """
    ranges = camera.range_m.mean(axis=0)
    middles, radii = 0.5 * (ranges[1:] + ranges[:-1]), camera.radius_px
    scales = np.diff(ranges) / np.diff(radii)
    at = np.arange(0.0, farthest_m + 2.0 * SCALE_STEP_M, SCALE_STEP_M)
    return np.column_stack((np.interp(at, middles, scales), np.interp(at, ranges, radii)))
