"""Crossings (section 4.1): candidates from key nodes and lines, verified by the colours on circles about them.

A state machine walks round the candidate and confirms the transitions from green to white and back: so many arms of
paint leave it, in these directions. On the ground, so that a circle in the image is an ellipse.
"""

import math

import numpy as np
from numba import njit

from touchline.geometry import FloatArray
from touchline.matrices import uncounted
from touchline.perception.line_graph.arms import STRAIGHT_RAD, arms_meet, judge_arms
from touchline.perception.line_graph.cell_crossings import crossings_in_cells
from touchline.perception.line_graph.field_lines import cell_pixels
from touchline.perception.line_graph.image_plane import (
    ImagePlane,
    ground_covariances,
    grounds_from_pixels,
    pixel_from_ground,
    pixels_from_grounds,
)
from touchline.perception.line_graph.key_nodes import key_nodes
from touchline.perception.line_graph.profiles import (
    LINE,
    NEAR_PX,
    NO_LINE,
    OUTSIDE,
    PROFILE_ROOM,
    Pixels,
    is_carpet,
    read_profile,
    signal_at,
)
from touchline.perception.line_graph.settings import LineGraphSettings
from touchline.perception.line_graph.structure import Structure
from touchline.perception.sorting import order_of
from touchline.types import Crossings, Lines

_SAMPLES = 96
_CIRCLE = np.array([(math.cos(a), math.sin(a)) for a in (2.0 * math.pi * k / _SAMPLES for k in range(_SAMPLES))])
_KINDS = {2: "L", 3: "T", 4: "X"}  # by the number of arms
_MAX_CROSSINGS = 40
_MAX_ARMS = 6
_WHITE, _GREEN = 0.45, 0.35  # signal above which paint and below which carpet is seen
_RIGHT_RAD = math.radians(60.0)  # lines that meet at less are no candidates
_SLACK_M = 0.25  # how far beyond a line's visible end it may meet another
_SAME_WIDTHS = 4.0  # candidates closer than so many line widths are one crossing
# radii of both circles about a candidate, in line widths, and the confidence: far off only wide ones leave the paint
# about the crossing itself, beside a post only narrow ones show nothing else
_CIRCLES = ((3.0, 5.0, 0.9), (5.0, 8.0, 0.9), (2.0, 3.2, 0.7))
_TURNS = 4
_MAX_MOVE, _SETTLED = 5.0, 0.3  # line widths
_STRAY_RAD = math.radians(30.0)  # an arm's directions on both circles differ by no more
_MIN_WIDTH, _MAX_WIDTH, _BLUR_PX = 0.55, 1.6, 2.0  # of an arc, in line widths and pixels: a post is wider
_PATH_FIRST, _PATH_STEP, _PATH_STEPS = 2.0, 1.0, 9  # of profiles along an arm, in line widths
_PATH_ENOUGH, _PATH_NEAR, _PATH_BARE = 4, 5, 2
_CARPET = 0.7  # least share of carpet in what is no paint


def find_crossings(
    structure: Structure, lines: Lines, pixels: Pixels, plane: ImagePlane, settings: LineGraphSettings
) -> Crossings:
    """Crossings of an image: candidates where lines meet and at key nodes, each verified."""
    if not settings.paper.circles_in_image:
        return _as_crossings(crossings_in_cells(structure, plane, settings.crossing_m), plane, settings)
    _, corners = key_nodes(structure.graph)
    ends_m = lines.ends_m
    meetings = _meetings(ends_m if settings.paper.meetings else ends_m[:0], _SLACK_M)
    at_nodes = grounds_from_pixels(plane, cell_pixels(corners[:, :2]))
    found = np.empty((_MAX_CROSSINGS, 5))
    candidates = np.concatenate((meetings, at_nodes))
    by_paths = len(meetings) if settings.paper.paths else 0
    count = _verify(pixels, plane, candidates, by_paths, ends_m, settings.crossing_m, found)
    return _as_crossings(found[:count], plane, settings)


def _as_crossings(found: FloatArray, plane: ImagePlane, settings: LineGraphSettings) -> Crossings:
    """Rows of `verified` (K, 5) as crossings."""
    if not len(found):
        return Crossings.none()
    places = np.ascontiguousarray(found[:, 1:3])
    uv = pixels_from_grounds(plane, places)
    covariances = ground_covariances(plane, uv, settings.noise_px, settings.noise_m)
    kinds = np.array([_KINDS[int(arms)] for arms in found[:, 0]], dtype="U1")
    return Crossings(kinds, places, found[:, 3].copy(), covariances, found[:, 4].copy(), uv)


@njit(cache=True, error_model="numpy")
def _verify(pixels, plane, candidates, by_paths, ends_m, max_range_m, found):  # type: ignore[no-untyped-def]
    """Verify candidates (C, 2), of which the first so many may be told by paths; see `verified` for a row of found."""
    pixels, plane, candidates, ends_m, found = uncounted((pixels, plane, candidates, ends_m, found))
    count = 0
    for k in range(len(candidates)):
        x, y = candidates[k]
        if not math.hypot(x, y) <= max_range_m or count == len(found) or _is_known(x, y, found[:count], pixels):
            continue
        sure = verified(pixels, plane, x, y, found[count])
        if not sure and k < by_paths:
            sure = _along_lines(pixels, plane, x, y, ends_m, found[count])
        if sure and not _is_known(found[count, 1], found[count, 2], found[:count], pixels):
            count += 1
    return count


@njit(cache=True)
def _is_known(x: float, y: float, found: FloatArray, pixels: Pixels) -> bool:
    known = False
    for row in found:
        known = known or math.hypot(x - row[1], y - row[2]) <= _SAME_WIDTHS * pixels.width_m
    return known


@njit(cache=True)
def _meetings(ends_m: FloatArray, slack_m: float) -> FloatArray:
    """Ground points (M, 2) where two lines (L, 2, 2) meet roughly at right angles, or would if a little longer."""
    found = np.empty((len(ends_m) * len(ends_m), 2))
    count = 0
    for i in range(len(ends_m)):
        for k in range(i):
            ax, ay = ends_m[i, 1, 0] - ends_m[i, 0, 0], ends_m[i, 1, 1] - ends_m[i, 0, 1]
            bx, by = ends_m[k, 1, 0] - ends_m[k, 0, 0], ends_m[k, 1, 1] - ends_m[k, 0, 1]
            la, lb, cross = math.hypot(ax, ay), math.hypot(bx, by), ax * by - ay * bx
            if abs(cross) <= math.sin(_RIGHT_RAD) * la * lb:
                continue
            ox, oy = ends_m[k, 0, 0] - ends_m[i, 0, 0], ends_m[k, 0, 1] - ends_m[i, 0, 1]
            a, b = (ox * by - oy * bx) / cross, (ox * ay - oy * ax) / cross
            if -slack_m <= a * la <= la + slack_m and -slack_m <= b * lb <= lb + slack_m:
                found[count, 0], found[count, 1] = ends_m[i, 0, 0] + a * ax, ends_m[i, 0, 1] + a * ay
                count += 1
    return found[:count]


@njit(cache=True, error_model="numpy")
def verified(pixels: Pixels, plane: ImagePlane, x: float, y: float, found: FloatArray) -> bool:
    """Whether two circles about a candidate's ground point show the same crossing.

    The candidate is moved to where the arms meet, and looked at again. Beside a goal post only the smaller circles
    show nothing else. Writes number of arms, x, y, orientation and confidence into found (5,).
    """
    inner, outer = np.empty((_MAX_ARMS, 3)), np.empty((_MAX_ARMS, 3))
    for radii in _CIRCLES:
        cx, cy = x, y
        for turn in range(_TURNS):
            count = _both_circles(pixels, plane, cx, cy, radii, inner, outer)
            if count < 2:
                break
            ax, ay = arms_meet(inner[:count], outer[:count])
            moved, cx, cy = math.hypot(ax - cx, ay - cy), ax, ay
            if not moved < _MAX_MOVE * pixels.width_m:
                break
            if moved < _SETTLED * pixels.width_m or turn == _TURNS - 1:
                one, _ = judge_arms(inner[:count, 0].copy(), STRAIGHT_RAD)
                other, orientation = judge_arms(outer[:count, 0].copy(), STRAIGHT_RAD)
                if one > 0 and one == other:
                    found[0], found[1], found[2], found[3], found[4] = one, cx, cy, orientation, radii[2]
                    return True
                break
    return False


@njit(cache=True, error_model="numpy")
def _along_lines(pixels: Pixels, plane: ImagePlane, x: float, y: float, ends_m: FloatArray, found: FloatArray) -> bool:
    """Whether a T is where two lines (L, 2, 2) meet beside something that no circle gets round: white paths along both.

    An arm is there where profiles show a line, and not where there is carpet; without a word on each there is none.
    """
    distance = np.empty(len(ends_m))
    for k in range(len(ends_m)):
        dx, dy = ends_m[k, 1, 0] - ends_m[k, 0, 0], ends_m[k, 1, 1] - ends_m[k, 0, 1]
        distance[k] = abs((x - ends_m[k, 0, 0]) * dy - (y - ends_m[k, 0, 1]) * dx) / math.hypot(dx, dy)
    angles, count = np.empty(4), 0
    for k in order_of(distance)[:2]:
        heading = math.atan2(ends_m[k, 1, 1] - ends_m[k, 0, 1], ends_m[k, 1, 0] - ends_m[k, 0, 0])
        for angle in (heading, heading + math.pi):
            shown = read_arm(pixels, plane, x, y, angle)
            if shown == OUTSIDE:
                return False
            if shown == LINE:
                angles[count] = angle
                count += 1
    arms, orientation = judge_arms(angles[:count], STRAIGHT_RAD)
    found[0], found[1], found[2], found[3], found[4] = arms, x, y, orientation, 0.7
    return bool(arms == 3)


@njit(cache=True, error_model="numpy")
def read_arm(pixels: Pixels, plane: ImagePlane, x: float, y: float, angle: float) -> int:
    """Whether an arm of paint leaves a ground point at an angle: LINE, NO_LINE (carpet), or OUTSIDE where unknown."""
    found = np.empty(PROFILE_ROOM)
    c, s = math.cos(angle), math.sin(angle)
    painted, near, bare = 0, 0, 0
    width, height = plane.size[0], plane.size[1]
    for k in range(_PATH_STEPS):
        distance = (_PATH_FIRST + k * _PATH_STEP) * pixels.width_m
        px, py = x + distance * c, y + distance * s
        if read_profile(pixels, plane, px, py, -s, c, found, NEAR_PX) == LINE:
            painted += 1
            near += k < _PATH_NEAR
            continue
        u, v = pixel_from_ground(plane, px, py)
        if 0.0 <= u <= width - 1.0 and 0.0 <= v <= height - 1.0:
            bare += signal_at(pixels, u, v) < _GREEN and is_carpet(pixels, u, v)
    if painted >= _PATH_ENOUGH and bare == 0:
        return LINE
    if bare >= _PATH_BARE and near == 0:
        return NO_LINE
    return OUTSIDE


@njit(cache=True, error_model="numpy")
def _both_circles(pixels, plane, x, y, radii, inner, outer):  # type: ignore[no-untyped-def]
    """Arms on both circles, those of the outer one in the order of the inner; how many, 0 where they don't agree."""
    count, wide = walk_round(pixels, plane, x, y, radii[0] * pixels.width_m, inner)
    if count < 2:
        return 0
    beyond, wider = walk_round(pixels, plane, x, y, radii[1] * pixels.width_m, outer)
    # what is no line may hide an arm: then only a T is certain, as there is hardly an X beside a post
    if beyond != count or ((wide or wider) and count != 3):
        return 0
    for k in range(count):
        best, at = np.inf, k
        for m in range(k, count):
            off = outer[m, 0] - inner[k, 0]
            off = abs(math.atan2(math.sin(off), math.cos(off)))
            if off < best:
                best, at = off, m
        if best > _STRAY_RAD:
            return 0
        for column in range(3):
            outer[k, column], outer[at, column] = outer[at, column], outer[k, column]
    return count


@njit(cache=True, error_model="numpy")
def walk_round(
    pixels: Pixels, plane: ImagePlane, x: float, y: float, radius_m: float, arms: FloatArray
) -> tuple[int, bool]:
    """Walk round a ground point; writes angle, x and y of the middle of each white arc into arms (MAX_ARMS, 3).

    Returns how many there are, -1 where the circle leaves the image or shows much that is neither paint nor carpet; and
    whether there were arcs wider than a line, which are left out.
    """
    width, height = plane.size[0], plane.size[1]
    values, places = np.empty(_SAMPLES), np.empty((_SAMPLES, 2))
    for k in range(_SAMPLES):
        u, v = pixel_from_ground(plane, x + radius_m * _CIRCLE[k, 0], y + radius_m * _CIRCLE[k, 1])
        if not (0.0 <= u <= width - 1.0 and 0.0 <= v <= height - 1.0):
            return -1, False
        places[k, 0], places[k, 1] = u, v
    plain, carpet = 0, 0
    for k in range(_SAMPLES):
        u, v = places[k, 0], places[k, 1]
        values[k] = signal_at(pixels, u, v)
        if values[k] < _GREEN:
            plain += 1
            carpet += is_carpet(pixels, u, v)
    start = 0
    for k in range(_SAMPLES):
        start = k if values[k] < values[start] else start
    if values[start] > _GREEN or carpet < _CARPET * plain:
        return -1, False
    count, inside, begin, wide = 0, False, 0.0, False
    for k in range(1, _SAMPLES + 1):
        here, before = values[(start + k) % _SAMPLES], values[(start + k - 1) % _SAMPLES]
        if not inside and here > _WHITE:
            inside = True
            begin = k - (here - 0.5 * (_WHITE + _GREEN)) / max(here - before, 1e-6)
        elif inside and here < _GREEN:
            inside = False
            end = k - 1 + (before - 0.5 * (_WHITE + _GREEN)) / max(before - here, 1e-6)
            scale = _metres_per_pixel(places, start + int(begin), radius_m)
            arc_m = (end - begin) * 2.0 * math.pi * radius_m / _SAMPLES
            if arc_m > _MAX_WIDTH * pixels.width_m + _BLUR_PX * scale:
                wide = True
                continue
            if arc_m < _MIN_WIDTH * pixels.width_m - 0.5 * _BLUR_PX * scale:
                return -1, wide
            if count == len(arms):
                return -1, wide
            angle = 2.0 * math.pi * (start + 0.5 * (begin + end)) / _SAMPLES
            arms[count, 0] = angle
            arms[count, 1], arms[count, 2] = x + radius_m * math.cos(angle), y + radius_m * math.sin(angle)
            count += 1
    return count, wide


@njit(cache=True, error_model="numpy")
def _metres_per_pixel(places: FloatArray, k: int, radius_m: float) -> float:
    """How long a pixel is along the circle at one of the places (N, 2) on it."""
    a, b = places[k % len(places)], places[(k + 1) % len(places)]
    return float(2.0 * math.pi * radius_m / len(places) / max(math.hypot(b[0] - a[0], b[1] - a[1]), 1e-6))
