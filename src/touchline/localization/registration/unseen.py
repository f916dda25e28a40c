"""Lines that a pose predicts in view and that no point was seen of.

Points show where lines are, and where none are, as far as was looked. What was looked at is
taken from the points themselves: the bearings at which points were seen, with narrow gaps between them, out to the
farthest. Rays from a pose cross the field's lines there; a crossing is seen where a point lies in its cell of range and
bearing, or beside.
"""

import math
from typing import NamedTuple

import numba
import numpy as np

from touchline.field.distances import LineTables
from touchline.geometry import BoolArray, FloatArray

# how much each unseen crossing contradicts a pose, logarithm of a likelihood ratio: in full images of a match one
# in fourteen is missing, robots hide neighbours together
UNSEEN = 1.0
RAYS = 72  # bearings, 5 degrees apart
GAP = 8  # so many rays between two that saw points, at most, were looked along, too
PER_RING = math.log(1.1)
_MIN_M, _RINGS = 0.3, 40  # cells: a tenth longer from ring to ring, up to 13 m


class View(NamedTuple):
    """looked (RAYS,): whether it was looked along a ray. cells (RAYS, rings): where points are, or beside.

    near_m, far_m: ranges between which lines would have been seen.
    """

    looked: BoolArray
    cells: BoolArray
    near_m: float
    far_m: float


@numba.njit(cache=True, error_model="numpy")
def view_of(points):  # type: ignore[no-untyped-def]
    """The `View` of points (N, 2), robot frame."""
    looked, cells = np.zeros(RAYS, dtype=np.bool_), np.zeros((RAYS, _RINGS), dtype=np.bool_)
    near, far = math.inf, 0.0
    for i in range(points.shape[0]):
        range_m = math.hypot(points[i, 0], points[i, 1])
        near, far = min(near, range_m), max(far, range_m)
        ray = math.floor(math.atan2(points[i, 1], points[i, 0]) * (RAYS / (2.0 * math.pi)) + 0.5)
        ring = _ring(range_m)
        looked[ray % RAYS] = True
        for k in range(-1, 2):
            for r in range(max(ring - 1, 0), min(ring + 2, _RINGS)):
                cells[(ray + k) % RAYS, r] = True
    return View(_filled(looked), cells, near, far)


@numba.njit(cache=True, error_model="numpy")
def _filled(looked):  # type: ignore[no-untyped-def]
    """The rays (RAYS,), with those of narrow gaps between them."""
    filled, last = looked.copy(), -RAYS
    for ray in range(2 * RAYS):
        if looked[ray % RAYS]:
            if ray - last <= GAP:
                for k in range(last + 1, ray):
                    filled[k % RAYS] = True
            last = ray
    return filled


@numba.njit(cache=True, error_model="numpy", inline="always")
def _ring(range_m):  # type: ignore[no-untyped-def]
    return min(max(int(math.log(max(range_m, 1e-3) / _MIN_M) / PER_RING), 0), _RINGS - 1)


@numba.njit(cache=True, error_model="numpy")
def count_unseen(lines, poses, view):  # type: ignore[no-untyped-def]
    """(K, 2) how many crossings of rays and lines each pose (K, 3) predicts in view, and how many were not seen."""
    counts = np.zeros((poses.shape[0], 2))
    for k in range(poses.shape[0]):
        for ray in range(RAYS):
            if view.looked[ray]:
                bearing = poses[k, 2] + ray * (2.0 * math.pi / RAYS)
                _along(lines, (poses[k, 0], poses[k, 1], math.cos(bearing), math.sin(bearing)), ray, view, counts[k])
    return counts


@numba.njit(cache=True, error_model="numpy")
def _along(lines, of, ray, view, counts):  # type: ignore[no-untyped-def]
    """Add the crossings along one ray from x, y in a direction to the counts (2,)."""
    x, y, c, s = of
    for i in range(lines.segments.shape[0]):
        ax, ay, dx, dy = lines.segments[i, 0] - x, lines.segments[i, 1] - y, lines.segments[i, 2], lines.segments[i, 3]
        across = c * dy - s * dx
        if across != 0.0:
            along = (ax * s - ay * c) / across
            if 0.0 <= along <= 1.0:
                _count((ax * dy - ay * dx) / across, ray, view, counts)
    for i in range(lines.arcs.shape[0]):
        ax, ay, radius = lines.arcs[i, 0] - x, lines.arcs[i, 1] - y, lines.arcs[i, 2]
        middle = ax * c + ay * s
        half2 = radius * radius - ax * ax - ay * ay + middle * middle
        if half2 > 0.0:
            half = math.sqrt(half2)
            for side in (-1.0, 1.0):
                range_m = middle + side * half
                ux, uy = range_m * c - ax, range_m * s - ay
                if ux * lines.arcs[i, 3] + uy * lines.arcs[i, 4] >= radius * lines.arcs[i, 5]:
                    _count(range_m, ray, view, counts)


@numba.njit(cache=True, error_model="numpy")
def _count(range_m, ray, view, counts):  # type: ignore[no-untyped-def]
    if view.near_m <= range_m <= view.far_m:
        counts[0] += 1.0
        counts[1] += not view.cells[ray, _ring(range_m)]


def unseen(lines: LineTables, view: View, poses: FloatArray) -> FloatArray:
    """(K,) how many crossings of rays with lines that each pose (K, 3) predicts in view were not seen."""
    return count_unseen(lines, poses, view)[:, 1]


def seen_ratio(lines: LineTables, points_m: FloatArray, pose: FloatArray, far_m: float) -> float:
    """Share of the crossings of all rays with lines, up to a range from a pose (3,), at which points (N, 2), robot
    frame, were seen, whether it was looked there or not; 1 where none is predicted.
    """
    view = view_of(points_m)._replace(looked=np.ones(RAYS, dtype=np.bool_), near_m=_MIN_M, far_m=far_m)
    predicted, missing = count_unseen(lines, pose[np.newaxis], view)[0].tolist()
    return 1.0 - missing / predicted if predicted else 1.0
