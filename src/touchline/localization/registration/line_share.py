"""Share of what is seen that a pose lays on lines of the field, where a thing that is no line counts as one thing.

Points on a robot, a net or a cable are many, and say one thing: here is something that is no line. So cells of the
ground are counted, not points, and cells off the lines that hang together count for little where they reach less far
than a line does. What a wrong field leaves off the lines are lines, and a wrong scale leaves it beside them. Lines of
another field are parallel to these: a long thing at another angle is a cable or a bar.
"""

import math

import numba
import numpy as np

from touchline.localization.camera_errors.base import placed_points
from touchline.localization.registration.line_likeness import CELL_M, cells_of

SIGMAS2, FLOOR2_M2 = 9.0, 0.02**2  # within which a point is on a line
LINKED2 = 3.4**2  # in cells: so near cells hang together
LINE_CELLS = 1.5 / CELL_M  # diagonal from which what hangs together is a line
LINE, BESIDE, THING = 1.7, 1.0, 0.2  # cells on lines as which one of a line that is not there counts, or of a thing
BESIDE_M = 0.5  # from a line, within which a thing's cell may be of that line
MAX_MINOR2, MIN_SKEW = 1.5**2, math.radians(7.0)  # variance across (cells), and angle to the field's axes, of a bar
MAX_CURVATURE = CELL_M / 8.0  # of a bar (1/cells): a quarter of that of a centre circle


@numba.njit(cache=True, error_model="numpy")
def on_lines(points_m, covariances_m2, pose, lines):  # type: ignore[no-untyped-def]
    """Whether points (N, 2), covariances (N, 2, 2), robot frame of a pose (3,), are on a line each, their distances to
    the nearest (m), and where they are in the field (N, 2). lines: the field's table.
    """
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    placed, distances_m = np.empty_like(points_m), np.empty(points_m.shape[0])
    on_line = np.zeros(points_m.shape[0], dtype=np.bool_)
    for i in range(points_m.shape[0]):
        placed[i, 0] = pose[0] + cosine * points_m[i, 0] - sine * points_m[i, 1]
        placed[i, 1] = pose[1] + sine * points_m[i, 0] + cosine * points_m[i, 1]
        column = (placed[i, 0] - lines.origin_x) * lines.samples_per_m + 0.5  # the nearest sample will do
        row = (placed[i, 1] - lines.origin_y) * lines.samples_per_m + 0.5
        column = min(column, lines.values.shape[1] - 1.0) if column > 0.0 else 0.0  # NaN becomes no index
        row = min(row, lines.values.shape[0] - 1.0) if row > 0.0 else 0.0
        x, y = lines.values[int(row), int(column)]
        variance = 0.5 * (covariances_m2[i, 0, 0] + covariances_m2[i, 1, 1]) + FLOOR2_M2
        distances_m[i] = math.hypot(x, y)
        on_line[i] = distances_m[i] ** 2 < SIGMAS2 * variance
    return on_line, distances_m, placed


@numba.njit(cache=True, error_model="numpy")
def line_share(points_m, covariances_m2, pose, lines):  # type: ignore[no-untyped-def]
    """Of points (N, 2), covariances (N, 2, 2), robot frame of a pose (3,); 0 of none. lines: the field's table."""
    on_line, distances_m, placed = on_lines(points_m, covariances_m2, pose, lines)
    cells, slots = cells_of(placed, CELL_M)
    explained, summed_m = np.zeros(cells.shape[0], dtype=np.int64), np.zeros(cells.shape[0])
    for i in range(len(slots)):
        explained[slots[i]] += on_line[i]
        summed_m[slots[i]] += distances_m[i]
    right, n, off = 0.0, 0, np.empty((cells.shape[0], 3), dtype=np.int64)
    for k in range(cells.shape[0]):
        if cells[k, 2] == 0:
            continue
        if 2 * explained[k] >= cells[k, 2]:
            right += 1.0
        else:
            off[n, 0], off[n, 1], off[n, 2] = cells[k, 0], cells[k, 1], summed_m[k] < BESIDE_M * cells[k, 2]
            n += 1
    counted, skew = _counted(off[:n])
    return right / max(right + counted + (THING if right >= skew else LINE) * skew, 1.0)


@numba.njit(cache=True, error_model="numpy")
def share_at(points_m, covariances_m2, state, response, lines):  # type: ignore[no-untyped-def]
    """`line_share` of points as they were seen, at a state: a pose and errors of the camera."""
    return line_share(placed_points(points_m, state[3:], response), covariances_m2, state[:3], lines)


@numba.njit(cache=True, error_model="numpy")
def _counted(off):  # type: ignore[no-untyped-def]
    """As how many cells those off the lines count, rows (N, 3) of x, y and whether one is beside a line, and how many
    are of bars that no field has; their order changes: what hangs together comes together.
    """
    counted, skew, begin = 0.0, 0, 0
    while begin < off.shape[0]:
        end, i = begin + 1, begin
        low_x = high_x = off[begin, 0]
        low_y = high_y = off[begin, 1]
        while i < end:
            x, y = off[i, 0], off[i, 1]
            low_x, high_x, low_y, high_y = min(low_x, x), max(high_x, x), min(low_y, y), max(high_y, y)
            for j in range(end, off.shape[0]):
                dx, dy = off[j, 0] - x, off[j, 1] - y
                if dx * dx + dy * dy <= LINKED2:
                    for k in range(3):
                        off[j, k], off[end, k] = off[end, k], off[j, k]
                    end += 1
            i += 1
        if math.hypot(high_x - low_x, high_y - low_y) < LINE_CELLS:
            beside = off[begin:end, 2].sum()
            counted += BESIDE * beside + THING * (end - begin - beside)
        elif _is_skew(off[begin:end, :2]):
            skew += end - begin
        else:
            counted += LINE * (end - begin)
        begin = end
    return counted, skew


@numba.njit(cache=True, error_model="numpy")
def _is_skew(cells):  # type: ignore[no-untyped-def]
    """Whether cells (N, 2) lie along one straight line that is parallel to no axis of the field."""
    x, y, n = cells[:, 0].mean(), cells[:, 1].mean(), cells.shape[0]
    xx = xy = yy = 0.0
    for i in range(n):
        dx, dy = cells[i, 0] - x, cells[i, 1] - y
        xx, xy, yy = xx + dx * dx, xy + dx * dy, yy + dy * dy
    turn = 0.5 * math.atan2(2.0 * xy, xx - yy)  # to the x axis, up to a right angle
    along2, bend, spread = 0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy), 0.0, 0.0
    if min(abs(turn), 0.5 * math.pi - abs(turn)) < MIN_SKEW or xx + yy - along2 > MAX_MINOR2 * n:
        return False
    cosine, sine = math.cos(turn), math.sin(turn)
    for i in range(n):  # a parabola across, of the curvature of an arc
        dx, dy = cells[i, 0] - x, cells[i, 1] - y
        u2 = (cosine * dx + sine * dy) ** 2 - along2 / n
        bend, spread = bend + u2 * (cosine * dy - sine * dx), spread + u2 * u2
    return 2.0 * abs(bend) < MAX_CURVATURE * spread
