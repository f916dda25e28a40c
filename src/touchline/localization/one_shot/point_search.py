"""Poses of line points on one field, by the mean error of their distances and nothing else."""

import functools
import math
from collections.abc import Sequence

import numba
import numpy as np

from touchline.field import FieldModel
from touchline.field.distance_map import lookup
from touchline.geometry import FloatArray, Pose, as_pose
from touchline.localization.registration.covariance import Moments, moments
from touchline.localization.registration.kernels import Plan, descend_all
from touchline.localization.registration.registration import CLUTTER_PER_M, Registration
from touchline.localization.search.pose_search import PoseSearch

C_M = 0.25  # width c of the error function e(d) = d² / (c² + d²): Lauer et al. 2006
STEPS = 10  # of Gauss and Newton: more find errors that are half a per cent smaller
COARSE_POINTS = 75  # so many at most, evenly taken, judge the poses of the grid
_USUAL_M2 = 1e-4  # variance of a point of the mean weight: what it is makes no difference


class PointSearch:
    """Looks for the poses at which the mean of e(d) is least, by Gauss-Newton steps from poses of a grid.

    Each offset weighs by (c² / (c² + d²))², so that the steps end at the least of e(d).
    """

    def __init__(self, field: FieldModel, heading: float | None = None, tolerance_rad: float = 0.0) -> None:
        """heading: from a compass (rad, field frame), or None; tolerance_rad: how far a pose may turn from it."""
        self.map = field.distance_map()
        self._heading = None if heading is None else (heading, tolerance_rad)
        self._search = _search_of(field)
        self._plan = Plan(np.full(STEPS, C_M), 0.0, 0.0, CLUTTER_PER_M)

    def refined(self, points: FloatArray, count: int) -> list[tuple[Pose, float]]:
        """Poses that so many of the grid come to, with the mean error of points (N, 2), all alike; the better first."""
        some = np.ascontiguousarray(points[:: -(-len(points) // COARSE_POINTS)])
        return self.at(points, np.full(len(points), 1.0 / len(points)), self._search.starts(some, count, self._heading))

    def at(self, points: FloatArray, weights: FloatArray, starts: FloatArray) -> list[tuple[Pose, float]]:
        """The same from starts (K, 3), of points with weights (N,) that sum to 1."""
        variances = _USUAL_M2 / np.maximum(len(points) * weights, 1e-6)
        spreads = variances[:, np.newaxis, np.newaxis] * np.eye(2)
        ends = descend_all(points, spreads, self._search.registration.table, starts, self._plan)
        poses = [as_pose(pose) for pose in ends]
        return sorted(zip(poses, self.errors(points, weights, poses), strict=True), key=lambda found: found[1])

    def error(self, points: FloatArray, weights: FloatArray, pose: Pose) -> float:
        """Mean of e(d) of points (N, 2) with weights (N,) that sum to 1."""
        return self.errors(points, weights, [pose])[0]

    def errors(self, points: FloatArray, weights: FloatArray, poses: Sequence[Pose]) -> list[float]:
        """The same at each of some poses."""
        placed = np.array([(pose.x, pose.y, math.cos(pose.heading), math.sin(pose.heading)) for pose in poses])
        return [float(weights @ errors) for errors in _errors(points, self.map.table, placed)]

    def moments(self, points: FloatArray, weights: FloatArray, pose: Pose) -> Moments:
        """What each point's error says about the accuracy of a pose."""
        return moments(points, weights, self.map.table, pose.as_array(), C_M)


@functools.lru_cache(maxsize=4)
def _search_of(field: FieldModel) -> PoseSearch:
    """The tables of a field, made once: 3 ms."""
    return PoseSearch(field, Registration(field.distance_map()))


@numba.njit(cache=True, error_model="numpy")
def _errors(points, table, placed):  # type: ignore[no-untyped-def]
    """e(d) (K, N) of points (N, 2), robot frame, at poses (K, 4): x, y (m), cosine and sine of the heading."""
    errors = np.empty((placed.shape[0], points.shape[0]))
    for k in range(placed.shape[0]):
        x, y, cosine, sine = placed[k]
        for i in range(points.shape[0]):
            px, py = points[i]
            d, _, _ = lookup(table, x + cosine * px - sine * py, y + sine * px + cosine * py)
            errors[k, i] = d * d / (d * d + C_M * C_M)
    return errors
