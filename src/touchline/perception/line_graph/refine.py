"""Field lines placed by the pixels: profiles across each one, a robust fit through their middles, and its true ends."""

import math

import numpy as np
from numba import njit

from touchline.geometry import FloatArray, IntArray
from touchline.perception.line_graph.colour_classes import CELL_PX
from touchline.perception.line_graph.image_plane import ImagePlane, grounds_from_pixels, plane_from_pixel, transformed
from touchline.perception.line_graph.lines import fit_line, fit_with_ends
from touchline.perception.line_graph.profiles import LINE, NEAR_PX, NO_LINE, OUTSIDE, PROFILE_ROOM, Pixels, read_profile
from touchline.perception.sorting import median_of

_CELLS_PX = 0.5 * CELL_PX + 1.0  # how far off the cells may have a line
_MAX_MISSED = 0.25  # profiles of such a line without paint, as a share of those with
_STEP_PX = 6.0  # between profiles
_MIN_PROFILES, _MAX_PROFILES = 6, 48
_MIN_POINTS = 4
_ROUNDS = 3
_OUTLIER_PX = 2.0
_MISSES, _GAP_WIDTHS = 2, 4.0  # so many profiles and line widths in a row without a line: it has ended
_MAX_BEYOND = 60
_ROW = 6
COVERED_PX = 3.0  # a candidate whose ends lie this close to a line that is placed already is part of it
_BENT = 0.6  # of the sagitta that a chord of the field's circle has: what bends so much is no line
MIN_SAGITTA_PX = 0.7  # less is noise
_PLAIN = 2.0  # times as much is no line even before it is followed to its ends
_MAX_LEAN_PX = 1.0  # of both halves of a line's points against the whole; the lens leaves less

POINT_COLUMNS = 5
"""Of a point of a line: pixel u, v, the line's number, contrast, width against the expected."""


@njit(cache=True, error_model="numpy")
def refine_line(
    pixels: Pixels, plane: ImagePlane, line: FloatArray, others: tuple[FloatArray, float], points: FloatArray
) -> tuple[float, int]:
    """Place a line (4,) x0, y0, x1, y1 of the image plane by profiles, in place.

    others: lines that are placed already (K, 4), and the radius (m) of the field's circles or 0. Its points go into
    points (P, POINT_COLUMNS), but for the line's number. Returns the share of profiles that show it, 0 where it is none
    or part of those or of a circle, and how many points there are.
    """
    focal = plane.lens.pinhole[0]
    rows = np.empty((_MAX_PROFILES + 2 * _MAX_BEYOND, _ROW))
    use, hits, misses = _along(pixels, plane, line, NEAR_PX, _STEP_PX, rows)
    if not len(use):  # thin lines may lie beside where the cells have them
        use, hits, misses = _along(pixels, plane, line, _CELLS_PX, 2.0 * _STEP_PX, rows)
        if len(use):
            use, hits, misses = _along(pixels, plane, line, NEAR_PX, _STEP_PX, rows)
            if misses > _MAX_MISSED * hits:  # it may be drawn from one line to another
                return 0.0, 0
    if not len(use) or is_covered(line, others[0], COVERED_PX / focal):
        return 0.0, 0
    if is_bent(rows[use, 2:4], line, plane, others[1], _PLAIN * MIN_SAGITTA_PX):
        return 0.0, 0
    for backward in (True, False):
        hits += _extend(pixels, plane, line, backward, rows[hits:])
    use = _fit_robustly(rows[:hits], _OUTLIER_PX / focal, line)
    if focal * _lean_of_halves(rows, use, line) > _MAX_LEAN_PX:
        return 0.0, 0
    count = min(len(use), len(points))
    for k in range(count):
        row = rows[use[k]]
        points[k, 0], points[k, 1], points[k, 3], points[k, 4] = row[2], row[3], row[4], row[5]
    return len(use) / (hits + misses), count


@njit(cache=True, error_model="numpy")
def is_covered(line: FloatArray, others: FloatArray, slack: float) -> bool:
    """Whether both ends of a line (4,) lie on one of the others (K, 4), to within a slack."""
    for k in range(len(others)):
        other = others[k]
        dx, dy = other[2] - other[0], other[3] - other[1]
        length = math.hypot(dx, dy)
        dx, dy = dx / length, dy / length
        on = True
        for end in range(2):
            x, y = line[2 * end] - other[0], line[2 * end + 1] - other[1]
            along = x * dx + y * dy
            on = on and abs(x * dy - y * dx) < slack and -2.0 * slack < along < length + 2.0 * slack
        if on:
            return True
    return False


@njit(cache=True, error_model="numpy")
def _lean_of_halves(rows: FloatArray, use: IntArray, line: FloatArray) -> float:
    """By how much both halves of a line's points lean to the same side of it, at their ends; 0 if they do not.

    Those of two lines side by side do, between which one was laid. Halves of a bent line lean to different sides.
    """
    dx, dy = line[2] - line[0], line[3] - line[1]
    length = math.hypot(dx, dy)
    dx, dy = dx / length, dy / length
    leans = np.zeros(2)
    for half in range(2):
        count, s_sum, e_sum, ss, se = 0, 0.0, 0.0, 0.0, 0.0
        for used in use:
            x, y = rows[used, 0] - line[0], rows[used, 1] - line[1]
            s, e = (x * dx + y * dy) / length - 0.25 - 0.5 * half, y * dx - x * dy
            if abs(s) <= 0.25:
                count, s_sum, e_sum, ss, se = count + 1, s_sum + s, e_sum + e, ss + s * s, se + s * e
        spread = ss - s_sum * s_sum / max(count, 1)
        if count >= 2 and spread > 0.0:
            leans[half] = 0.25 * (se - s_sum * e_sum / count) / spread
    same = leans[0] * leans[1] > 0.0
    return min(abs(leans[0]), abs(leans[1])) if same else 0.0


@njit(cache=True, error_model="numpy")
def _along(
    pixels: Pixels, plane: ImagePlane, line: FloatArray, reach_px: float, step_px: float, rows: FloatArray
) -> tuple[IntArray, int, int]:
    """Profiles along a line (4,), which is placed by those that show it, in place; these go into rows (N, 6).

    Returns those that agree, none where these are not enough, how many show it and how many show none.
    """
    focal = plane.lens.pinhole[0]
    steps = int(focal * math.hypot(line[2] - line[0], line[3] - line[1]) / step_px)
    steps = min(max(steps, _MIN_PROFILES), _MAX_PROFILES)
    found = np.empty(PROFILE_ROOM)
    hits, misses = 0, 0
    for k in range(steps):
        shown = _read_at(pixels, plane, line, (k + 0.5) / steps, reach_px, found)
        if shown == LINE:
            _write(plane, found, rows[hits])
            hits += 1
        misses += shown == NO_LINE
        most = hits + steps - 1 - k
        if most < _MIN_POINTS or most < misses or most < 0.4 * steps:  # as nearly all candidates, that are none
            return np.empty(0, dtype=np.int64), hits, misses
    use = _fit_robustly(rows[:hits], _OUTLIER_PX / focal, line)
    return use[: len(use) if len(use) >= max(_MIN_POINTS, 0.6 * hits) else 0], hits, misses


@njit(cache=True, error_model="numpy")
def _write(plane: ImagePlane, found: FloatArray, row: FloatArray) -> None:
    """What a profile found: where in the plane, which pixel, contrast, width against the expected, into row (6,)."""
    row[0], row[1] = plane_from_pixel(plane.lens, found[0], found[1])
    row[2], row[3], row[4], row[5] = found[0], found[1], found[4], found[2] / found[3]


@njit(cache=True, error_model="numpy", inline="always")
def _read_at(
    pixels: Pixels, plane: ImagePlane, line: FloatArray, share: float, reach_px: float, found: FloatArray
) -> int:
    """The profile at a share of a line's length."""
    dx, dy = line[2] - line[0], line[3] - line[1]
    x, y = line[0] + share * dx, line[1] + share * dy
    gx, gy = transformed(plane.ground, x, y)
    length = math.hypot(dx, dy)
    hx, hy = transformed(plane.ground, x + 1e-3 * dx / length, y + 1e-3 * dy / length)
    tx, ty = hx - gx, hy - gy
    norm = math.hypot(tx, ty)
    if not norm > 0.0:
        return OUTSIDE
    return read_profile(pixels, plane, gx, gy, -ty / norm, tx / norm, found, reach_px)


@njit(cache=True, error_model="numpy")
def _on_ground(plane: ImagePlane, line: FloatArray, one: float, other: float) -> float:
    """Distance (m) on the ground between two shares of a line's length."""
    dx, dy = line[2] - line[0], line[3] - line[1]
    ax, ay = transformed(plane.ground, line[0] + one * dx, line[1] + one * dy)
    bx, by = transformed(plane.ground, line[0] + other * dx, line[1] + other * dy)
    return math.hypot(bx - ax, by - ay)


@njit(cache=True, error_model="numpy")
def is_bent(pixels: FloatArray, line: FloatArray, plane: ImagePlane, radius_m: float, min_px: float) -> bool:
    """Whether the pixels (P, 2) of a line (4,) bend as those of a chord of a circle of the field's radius do, and by
    more than so much.
    """
    if radius_m == 0.0 or len(pixels) < 5:
        return False
    ax, ay = transformed(plane.ground, line[0], line[1])
    bx, by = transformed(plane.ground, line[2], line[3])
    chord = math.hypot(bx - ax, by - ay)
    if chord > 2.0 * radius_m:
        return False
    in_image = sagitta(pixels.copy()) * plane.lens.pinhole[0] * math.hypot(line[2] - line[0], line[3] - line[1])
    if not in_image > min_px:
        return False
    return bool(sagitta(grounds_from_pixels(plane, pixels.copy())) > _BENT * chord / (8.0 * radius_m))


@njit(cache=True, error_model="numpy")
def sagitta(points: FloatArray) -> float:
    """By how much points (N, 2) of a line bend, as a share of its length: the middle's distance from the chord."""
    n = len(points)
    x, y, dx, dy, low, high = fit_with_ends(points, np.arange(n))
    half, middle = 0.5 * (high - low), 0.5 * (low + high)
    # least squares of off = a + b s²; the sums are those of s², s⁴, off and off s²
    squares, fourths, offs, products = 0.0, 0.0, 0.0, 0.0
    for k in range(n):
        square = (((points[k, 0] - x) * dx + (points[k, 1] - y) * dy - middle) / half) ** 2
        off = (points[k, 1] - y) * dx - (points[k, 0] - x) * dy
        squares, fourths = squares + square, fourths + square * square
        offs, products = offs + off, products + off * square
    bend = (products - offs * squares / n) / (fourths - squares * squares / n)
    return abs(bend) / (2.0 * half)


@njit(cache=True, error_model="numpy")
def _fit_robustly(rows: FloatArray, outlier: float, line: FloatArray) -> IntArray:
    """Fit a line to the middles (N, 2 and more), those far off left out, into line (4,); returns which were used."""
    use, off = np.arange(len(rows)), np.empty(len(rows))
    for _ in range(_ROUNDS):
        x, y, dx, dy = fit_line(rows, use)
        for k in range(len(rows)):
            off[k] = abs((rows[k, 0] - x) * dy - (rows[k, 1] - y) * dx)
        limit = max(outlier, 2.5 * median_of(off))
        near = np.empty(len(rows), dtype=np.int64)
        count, same = 0, True
        for k in range(len(rows)):
            if off[k] <= limit:
                same = same and count < len(use) and use[count] == k
                near[count] = k
                count += 1
        if same and count == len(use):  # they would be fitted, and left out, as they were
            break
        use = near[:count]
    x, y, dx, dy, low, high = fit_with_ends(rows, use)
    if (line[2] - line[0]) * dx + (line[3] - line[1]) * dy < 0.0:
        low, high = high, low
    line[0], line[1], line[2], line[3] = x + low * dx, y + low * dy, x + high * dx, y + high * dy
    return use


@njit(cache=True, error_model="numpy")
def _extend(pixels: Pixels, plane: ImagePlane, line: FloatArray, backward: bool, rows: FloatArray) -> int:
    """Profiles beyond an end, until the line has ended, into rows (N, 6); returns how many there are."""
    found = np.empty(PROFILE_ROOM)
    length_px = plane.lens.pinhole[0] * math.hypot(line[2] - line[0], line[3] - line[1])
    gap_m, step, begin = _GAP_WIDTHS * pixels.width_m, _STEP_PX / max(length_px, 1.0), 1.0
    if backward:
        step, begin = -step, 0.0
    missed, hit, count = 0, 0, 0
    for k in range(1, _MAX_BEYOND):
        shown = _read_at(pixels, plane, line, begin + k * step, NEAR_PX, found)
        if shown == OUTSIDE:
            break
        if shown == LINE:
            missed, hit = 0, k
            _write(plane, found, rows[count])
            count += 1
            continue
        missed += 1
        if missed >= _MISSES and _on_ground(plane, line, begin + hit * step, begin + k * step) > gap_m:
            break
    return count
