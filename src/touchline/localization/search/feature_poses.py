"""Poses from which the features of a frame can be what they are seen as: where random particles start best.

An addition of ours to Schulz and Behnke 2012, as in sensor resetting localization (Lenser and Veloso 2000). A line or
a crossing that is seen gives the heading but for a few quarter turns; then each point feature that is taken for one of
its kind gives a position, and so do two lines that are taken for two of the field's.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.geometry import FloatArray, IntArray
from touchline.localization.registration.feature_model import FeatureModel, FeatureView, LineFeatures
from touchline.localization.search.resampling import low_variance, tempering

PARALLEL = 0.2  # sine of the angle below which lines are parallel
CROSSING = 0.7  # and above which they cross
BEYOND_M = 1.0  # by so much a line may seem longer than the field's
APART_M = 0.3  # error of the distance of two points
HEADINGS_OF_POINTS = 40  # largest number of headings by pairs of points
JITTER = np.array([0.1, 0.1, 0.03])  # standard deviations of particles about such a pose (m, m, rad)
EFFECTIVE = 10.0  # of the poses at least, however much likelier the best one is


class FeaturePoses(NamedTuple):
    """Poses (K, 3), field frame, and the logarithms of their likelihoods (K,)."""

    poses: FloatArray
    log_likelihoods: FloatArray

    def draw(self, rng: np.random.Generator, count: int) -> FloatArray:
        """So many poses (count, 3) about them, more about the likelier ones; K > 0."""
        exponent = float(tempering(self.log_likelihoods, min(EFFECTIVE, 0.5 * len(self.poses))))
        weights = np.exp(exponent * (self.log_likelihoods - self.log_likelihoods.max()))
        drawn: FloatArray = low_variance(self.poses, weights / weights.sum(), float(rng.random()), count)
        return drawn + JITTER * rng.standard_normal((count, 3))


class PoseProposals:
    """Finds the poses of a frame on one field."""

    def __init__(self, model: FeatureModel, reach_m: FloatArray) -> None:
        """reach_m (2,): how far from the centre a robot may stand."""
        self.model, self.reach_m = model, reach_m
        self._members = [np.unique(table[table >= 0]).astype(np.int64) for table in model.tables.nearest]
        self._directions = np.unique(np.arctan2(model.lines[:, 1], model.lines[:, 0]).round(6) % math.pi)

    def of(self, view: FeatureView) -> FeaturePoses:
        """The poses that a view proposes; none if it gives no heading or no position."""
        headings = self._headings(view)
        found = np.concatenate((self._by_points(view, headings), self._by_lines(view, headings)))
        found = found[(np.abs(found[:, :2]) <= self.reach_m).all(axis=1)]
        return FeaturePoses(found, self.model.log_likelihoods(view, found))

    def _headings(self, view: FeatureView) -> FloatArray:
        """By the longest line, else by an oriented crossing, else by the two points that are farthest apart."""
        if len(view.lines.ends_m):
            along = _longest(view.lines)
            seen = math.atan2(along[1], along[0])
            return np.concatenate((self._directions, self._directions + math.pi)) - seen
        oriented = np.flatnonzero(view.points.sets[:, 1] > 1)
        if len(oriented):
            return (np.arange(4) + 0.5) * 0.5 * math.pi - view.points.turns_rad[oriented[0]]
        return self._headings_by_points(view)

    def _headings_by_points(self, view: FeatureView) -> FloatArray:
        positions = view.points.positions_m
        if len(positions) < 2:
            return np.zeros(0)
        apart = np.hypot(*(positions[:, np.newaxis] - positions).transpose(2, 0, 1))
        one, other = np.unravel_index(int(np.argmax(apart)), apart.shape)
        seen, places = positions[other] - positions[one], self.model.tables.places_m
        first, second = self._places(view, int(one)), self._places(view, int(other))
        offsets = (places[second] - places[first][:, np.newaxis]).reshape(-1, 2)
        fits = np.abs(np.hypot(*offsets.T) - apart[one, other]) < APART_M + 0.1 * apart[one, other]
        headings: FloatArray = np.arctan2(offsets[fits, 1], offsets[fits, 0]) - math.atan2(seen[1], seen[0])
        return headings[:HEADINGS_OF_POINTS]

    def _places(self, view: FeatureView, point: int) -> IntArray:
        """All places that a point may be taken for."""
        table, sets, first, end = view.points.sets[point].tolist()
        of_table = self._members[table : table + sets] if table >= 0 else []
        return np.concatenate((*of_table, view.points.candidates[first:end]))

    def _by_points(self, view: FeatureView, headings: FloatArray) -> FloatArray:
        places = [self._places(view, point) for point in range(len(view.points.positions_m))]
        if not places:
            return np.zeros((0, 3))
        counts = np.array([len(each) for each in places])
        return _where_points_fit(
            view.points.positions_m, counts, self.model.tables.places_m[np.concatenate(places)], headings
        )

    def _by_lines(self, view: FeatureView, headings: FloatArray) -> FloatArray:
        """By the longest line and the longest one across it."""
        ends = view.lines.ends_m
        if len(ends) < 2:
            return np.zeros((0, 3))
        along = ends[:, 1] - ends[:, 0]
        length = np.hypot(along[:, 0], along[:, 1])
        one = int(np.argmax(length))
        sine = (along[one, 0] * along[:, 1] - along[one, 1] * along[:, 0]) / (length[one] * length)
        other = int(np.argmax(np.where(np.abs(sine) > CROSSING, length, -1.0)))
        if abs(sine[other]) <= CROSSING:
            return np.zeros((0, 3))
        return _where_lines_fit(ends[one], ends[other], self.model.lines, headings)


@njit(cache=True)
def _where_points_fit(points: FloatArray, counts: IntArray, places: FloatArray, headings: FloatArray) -> FloatArray:
    """Poses (K, 3) of headings (H,) at which one of points (N, 2) lies at one of its places (sum of counts (N,), 2)."""
    poses, k, first = np.empty((len(places) * len(headings), 3)), 0, 0
    for i in range(len(points)):
        for heading in headings:
            c, s = math.cos(heading), math.sin(heading)
            x, y = c * points[i, 0] - s * points[i, 1], s * points[i, 0] + c * points[i, 1]
            for place in places[first : first + counts[i]]:
                poses[k, 0], poses[k, 1], poses[k, 2] = place[0] - x, place[1] - y, heading
                k += 1
        first += counts[i]
    return poses


@njit(cache=True)
def _where_lines_fit(one: FloatArray, other: FloatArray, lines: FloatArray, headings: FloatArray) -> FloatArray:
    """Poses (K, 3) of headings (H,) at which two lines (2, 2) lie on two of the field's (S, 5).

    The normal of each of these times the position is what is missing to its distance from the centre.
    """
    poses, count = np.empty((len(headings) * len(lines) ** 2, 3)), 0
    for heading in headings:
        for k in range(len(lines)):
            missing_k = _missing(other, lines[k], heading)
            for i in range(len(lines) if math.isfinite(missing_k) else 0):
                det = lines[i, 0] * lines[k, 1] - lines[i, 1] * lines[k, 0]
                missing_i = _missing(one, lines[i], heading)
                if abs(det) > CROSSING and math.isfinite(missing_i):
                    poses[count, 0] = (missing_i * lines[k, 0] - missing_k * lines[i, 0]) / det
                    poses[count, 1] = (missing_i * lines[k, 1] - missing_k * lines[i, 1]) / det
                    poses[count, 2] = heading
                    count += 1
    return poses[:count]


@njit(cache=True)
def _missing(seen: FloatArray, line: FloatArray, heading: float) -> float:
    """By how much a line (2, 2) seen from the centre lies off one of the field's (5,); NaN if it is no part of it."""
    c, s = math.cos(heading), math.sin(heading)
    dx, dy = seen[1, 0] - seen[0, 0], seen[1, 1] - seen[0, 1]
    along_x, along_y, length = c * dx - s * dy, s * dx + c * dy, math.hypot(dx, dy)
    if abs(line[0] * along_y - line[1] * along_x) >= PARALLEL * length or line[4] <= length - BEYOND_M:
        return math.nan
    x, y = 0.5 * (seen[0, 0] + seen[1, 0]), 0.5 * (seen[0, 1] + seen[1, 1])
    return line[2] - line[0] * (s * x + c * y) + line[1] * (c * x - s * y)


def _longest(lines: LineFeatures) -> FloatArray:
    """From end to end of the longest line (2,)."""
    along = lines.ends_m[:, 1] - lines.ends_m[:, 0]
    return along[np.argmax((along**2).sum(axis=1))]
