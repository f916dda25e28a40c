"""Which line points count, and how much: more points on a thing are no more information, and what is no line is none.

Clouds of crude detectors hold what else is white, too, laid on the ground: robots, nets, posts, balls, and hundreds of
points on each metre of a line. Here they are thinned to cells of the ground, a stretch of line counts as a few points,
and a point counts as far as its neighbours lie on a line with it. The points of a detector that looks along scan lines
are hardly denser than that, and keep their places; where they are crowded beyond that they weigh less.
"""

import math
from typing import NamedTuple

import numba
import numpy as np

from touchline.geometry import FloatArray
from touchline.localization.registration.unseen import PER_RING, RAYS
from touchline.matrices import uncounted

CELL_M, PER_CELL = 0.12, 3  # points of a square are one, their mean, where there are more of them
NEAR_M, NEARBY = 0.3, 8.0  # so many points so near count, however many there are
WRAP = 64  # cells of that size, after which the table of them begins anew: what is so far off is no neighbour
MIN_NEIGHBOURS = 4  # fewer don't show a line
STRIP_M, STRIP_SIGMAS = 0.04, 0.5  # half the width of a stretch of line, and its share of the points' deviation
STRIP_RATIO, MAX_REACH_M = 4.0, 0.6  # half its length to half its width
MIN_LENGTH_M = 0.25
# share of the neighbours that lie on the best stretch: mean of a place, in a heap and on lines; of one point, in a heap
# and where two lines meet
NO_LINE, LINE = 0.5, 0.65
NO_CORNER, CORNER = 0.35, 0.5
RADIAL_SINE, RADIAL = math.sin(math.radians(12.0)), 0.3  # what stands is laid on the ground away from the robot
# share of their weight that points of a detector of lines keep, and dense ones of which such a share lies on lines:
# those stay as they are
CLEAN, DENSE, PURE = 0.8, 0.5, 0.95
CROWDED = 4  # times the usual number of a cell of range and bearing: scan lines do not see a thing more often
MAX_POINTS = 40.0  # all of a crude cloud counts as so many points: its lines err together
DIRECTIONS = 12
_ANGLES = np.arange(DIRECTIONS) * math.pi / DIRECTIONS
_COSINES, _SINES = np.cos(_ANGLES), np.sin(_ANGLES)


class Counted(NamedTuple):
    """Points that count: positions_m (M, 2), covariances_m2 (M, 2, 2), weights (M,): as so many points each.

    line_ratio: share of the cells that are seen, as they are weighed, that lies on lines of any kind. crude: whether
    points were left out.
    """

    positions_m: FloatArray
    covariances_m2: FloatArray
    weights: FloatArray
    line_ratio: float
    crude: bool


@numba.njit(cache=True, forceinline=True, error_model="numpy")
def slot(cells, x, y):  # type: ignore[no-untyped-def]
    """Row of cell x, y in a table (K, 3) of x, y, number of points; K a power of two, empty rows without points."""
    mask = cells.shape[0] - 1
    k = ((x * 73856093) ^ (y * 19349663)) & mask
    while cells[k, 2] != 0 and (cells[k, 0] != x or cells[k, 1] != y):
        k = (k + 1) & mask
    return k


@numba.njit(cache=True, error_model="numpy")
def cells_of(points, size_m):  # type: ignore[no-untyped-def]
    """Table of the cells that points (N, 2) lie in, as of `slot`, and the row of each point (N,)."""
    rows = 64
    while rows < 2 * points.shape[0]:
        rows *= 2
    cells, slots = np.zeros((rows, 3), dtype=np.int64), np.empty(points.shape[0], dtype=np.int64)
    for i in range(points.shape[0]):
        x, y = math.floor(points[i, 0] / size_m), math.floor(points[i, 1] / size_m)
        k = slot(uncounted(cells), x, y)
        cells[k, 0], cells[k, 1] = x, y
        cells[k, 2] += 1
        slots[i] = k
    return cells, slots


@numba.njit(cache=True, error_model="numpy")
def _thinned(points, covariances, weights):  # type: ignore[no-untyped-def]
    """The same with one point, their mean, for those of a crowded cell; itself where there is none."""
    cells, slots = cells_of(points, CELL_M)
    n, of_cell = 0, np.full(cells.shape[0], -1)
    positions, spreads, counted = np.zeros_like(points), np.zeros_like(covariances), np.zeros_like(weights)
    for i in range(points.shape[0]):
        k = slots[i]
        row, share, most = n, 1.0, 1.0
        if cells[k, 2] > PER_CELL:
            share, most = 1.0 / cells[k, 2], float(PER_CELL)
            row = n if of_cell[k] < 0 else of_cell[k]
            of_cell[k] = row
        n += row == n
        for a in range(2):  # by hand: arrays of two would be made anew for every point
            positions[row, a] += share * points[i, a]
            for b in range(2):
                spreads[row, a, b] += share * covariances[i, a, b]
        counted[row] += share * most * weights[i]
    for k in range(cells.shape[0]):
        if of_cell[k] >= 0:  # of a line that lies on the edge of two cells, the narrow piece counts less
            densest = cells[k, 2]
            for dx in range(-1, 2):
                for dy in range(-1, 2):
                    densest = max(densest, cells[slot(cells, cells[k, 0] + dx, cells[k, 1] + dy), 2])
            counted[of_cell[k]] *= cells[k, 2] / densest
    return positions[:n], spreads[:n], counted[:n]


@numba.njit(cache=True, forceinline=True, error_model="numpy")
def _strip(xs, ys, half_m):  # type: ignore[no-untyped-def]
    """How many of offsets (K,) lie on the fullest strip of half a width, its length (m), its direction's row."""
    best, direction = 0, 0
    for a in range(DIRECTIONS):
        c, s = _COSINES[a], _SINES[a]
        count = 0
        for j in range(len(xs)):
            count += abs(xs[j] * s - ys[j] * c) < half_m
        if count > best:
            best, direction = count, a
        if best == len(xs):  # no strip is fuller
            break
    c, s, low, high = _COSINES[direction], _SINES[direction], 0.0, 0.0
    for j in range(len(xs)):
        if abs(xs[j] * s - ys[j] * c) < half_m:
            along = xs[j] * c + ys[j] * s
            low, high = min(low, along), max(high, along)
    return best, high - low, direction


@numba.njit(cache=True, forceinline=True, error_model="numpy")
def _neighbours(points, i, lists, reach_m):  # type: ignore[no-untyped-def]
    """Append the neighbours of point i to the lists; the new end."""
    first, after, found, end = lists
    x, y, far_m = points[i, 0], points[i, 1], reach_m + 1e-9
    low_y, high_y = math.floor((y - far_m) / NEAR_M), math.floor((y + far_m) / NEAR_M)
    for gx in range(math.floor((x - far_m) / NEAR_M), math.floor((x + far_m) / NEAR_M) + 1):
        for gy in range(low_y, high_y + 1):
            j = first[gx % WRAP, gy % WRAP]
            while j >= 0:
                dx, dy = points[j, 0] - x, points[j, 1] - y
                found[end] = j  # kept or not: no processor predicts which
                end += (dx * dx + dy * dy < reach_m * reach_m) & (j != i)
                j = after[j]
    return end


@numba.njit(cache=True, error_model="numpy")
def _judged(points, covariances, weights):  # type: ignore[no-untyped-def]
    """(N,) factors of the weights by neighbours: for density, and for how alike a line it is; (N,) which are radial."""
    n, points = points.shape[0], uncounted(points)
    first, after = np.full((WRAP, WRAP), -1, dtype=np.int32), np.empty(n, dtype=np.int32)
    density, ratios, radial = np.ones(n), np.full(n, -1.0), np.zeros(n, dtype=np.bool_)
    xs, ys = np.empty(n), np.empty(n)
    found, ends = np.empty(16 * n + 64, dtype=np.int64), np.zeros(n + 1, dtype=np.int64)
    for i in range(n):
        gx, gy = math.floor(points[i, 0] / NEAR_M) % WRAP, math.floor(points[i, 1] / NEAR_M) % WRAP
        after[i], first[gx, gy] = first[gx, gy], i
    for i in range(n):
        x, y = points[i, 0], points[i, 1]
        half_m = STRIP_M + STRIP_SIGMAS * math.sqrt(0.5 * (covariances[i, 0, 0] + covariances[i, 1, 1]))
        half_m = min(half_m, MAX_REACH_M / STRIP_RATIO)
        if found.shape[0] < ends[i] + n:
            found = np.concatenate((found, np.empty(found.shape[0] + n, dtype=np.int64)))
        lists, reach_m = uncounted((first, after, found, ends[i])), max(NEAR_M, STRIP_RATIO * half_m)
        ends[i + 1] = _neighbours(points, i, lists, reach_m)
        nearby, k = weights[i], ends[i + 1] - ends[i]
        for m in range(k):
            j = found[ends[i] + m]
            xs[m], ys[m] = points[j, 0] - x, points[j, 1] - y
            if xs[m] * xs[m] + ys[m] * ys[m] < NEAR_M * NEAR_M:
                nearby += weights[j]
        if nearby > NEARBY:
            density[i] = NEARBY / nearby
        if k >= MIN_NEIGHBOURS:
            best, length, direction = _strip(uncounted(xs)[:k], uncounted(ys)[:k], half_m)
            ratios[i] = best / k if length >= MIN_LENGTH_M else 0.0
            across = abs(_COSINES[direction] * y - _SINES[direction] * x)
            radial[i] = across < RADIAL_SINE * math.sqrt(x * x + y * y)
    return density, _likeness(ratios, found, ends), radial


@numba.njit(cache=True, error_model="numpy")
def _likeness(ratios, found, ends):  # type: ignore[no-untyped-def]
    """(N,) from 0 to 1, by the share on the best strip of each point (N,), -1 if unknown, and of its neighbours."""
    likeness = np.ones(ratios.shape[0])
    for i in range(ratios.shape[0]):
        known = ratios[i] >= 0.0
        total, count = (ratios[i], 1) if known else (0.0, 0)
        for m in range(ends[i], ends[i + 1]):
            if ratios[found[m]] >= 0.0:
                total += ratios[found[m]]
                count += 1
        if count > 0:
            likeness[i] = min(max((total / count - NO_LINE) / (LINE - NO_LINE), 0.0), 1.0)
        if known:
            likeness[i] *= min(max((ratios[i] - NO_CORNER) / (CORNER - NO_CORNER), 0.0), 1.0)
    return likeness


@numba.njit(cache=True, error_model="numpy")
def _uncrowded(points, weights):  # type: ignore[no-untyped-def]
    """Weights (N,) of points (N, 2): those of a cell of range and bearing count as `CROWDED` times as many as the lower
    quartile of the cells holds, at most.
    """
    polar = np.empty_like(points)
    for i in range(points.shape[0]):
        x, y = points[i, 0], points[i, 1]
        polar[i, 0] = (math.atan2(y, x) * (RAYS / (2.0 * math.pi)) + 0.5) % RAYS
        polar[i, 1] = 0.5 * math.log(max(x * x + y * y, 1e-6)) / PER_RING
    cells, slots = cells_of(polar, 1.0)
    cells_with, below, usual = np.zeros(points.shape[0] + 1, dtype=np.int64), 0, 0  # so many points
    for k in range(cells.shape[0]):
        cells_with[cells[k, 2]] += 1
    while below <= (cells.shape[0] - cells_with[0]) // 4:
        usual += 1
        below += cells_with[usual]
    even = np.empty_like(weights)
    for i in range(points.shape[0]):
        even[i] = weights[i] * min(CROWDED * usual / cells[slots[i], 2], 1.0)
    return even


@numba.njit(cache=True, error_model="numpy")
def count_points(points, covariances, weights):  # type: ignore[no-untyped-def]
    """What counts (`Counted`) of points (N, 2), robot frame, with covariances (N, 2, 2) and weights (N,)."""
    total = whole = left = crowd = 0.0  # sums by hand: array expressions take a second to compile
    if points.shape[0] == 0:
        return Counted(points.copy(), covariances.copy(), weights.copy(), 1.0, False)
    thin, spreads, counts = _thinned(points, covariances, weights)
    density, likeness, radial = _judged(thin, spreads, counts)
    for i in range(weights.shape[0]):
        total += weights[i]
    for i in range(counts.shape[0]):
        counts[i] *= density[i]
        whole += counts[i]
        counts[i] *= likeness[i]
        left += counts[i]
    line_ratio = left / max(whole, 1e-9)
    if left > (DENSE if line_ratio > PURE else CLEAN) * max(total, 1e-9):
        return Counted(points.copy(), covariances.copy(), _uncrowded(points, weights), 1.0, False)
    for i in range(counts.shape[0]):
        counts[i] *= RADIAL if radial[i] else 1.0
        crowd += counts[i]
    scale, kept = min(MAX_POINTS / max(crowd, 1e-9), 1.0), 0
    for i in range(counts.shape[0]):
        counts[kept] = counts[i] * scale
        for a in range(2):
            thin[kept, a] = thin[i, a]
            for b in range(2):
                spreads[kept, a, b] = spreads[i, a, b]
        kept += counts[kept] > 0.0
    return Counted(thin[:kept], spreads[:kept], counts[:kept], line_ratio, True)
