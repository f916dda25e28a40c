"""Poses from which the features of a frame can be what they are seen as: where random particles start best.

An addition of ours to Schulz and Behnke 2012, as in sensor resetting localization (Lenser and Veloso 2000). A line or
a crossing that is seen gives the heading but for a few quarter turns; then each point feature that is taken for one of
its kind gives a position, and so do two lines that are taken for two of the field's.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from touchline.geometry import FloatArray, IntArray
from touchline.localization.particles.resampling import low_variance, tempering
from touchline.localization.registration.feature_model import FeatureModel, FeatureView, LineFeatures

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
        self._members = [np.unique(table[table >= 0]) for table in model.tables.nearest]
        self._directions = np.unique(np.arctan2(model.lines[:, 1], model.lines[:, 0]).round(6) % math.pi)

    def of(self, view: FeatureView) -> FeaturePoses:
        """The poses that a view proposes; none if it gives no heading or no position."""
        headings = self._headings(view)
        found = np.concatenate([np.zeros((0, 3)), *self._by_points(view, headings), *self._by_lines(view, headings)])
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
        of_table = [member for k in range(table, table + sets) for member in self._members[k]] if table >= 0 else []
        return np.concatenate((np.array(of_table, np.int64), view.points.candidates[first:end]))

    def _by_points(self, view: FeatureView, headings: FloatArray) -> Iterator[FloatArray]:
        for point, position in enumerate(view.points.positions_m):
            places = self.model.tables.places_m[self._places(view, point)]
            for heading in headings:
                c, s = math.cos(heading), math.sin(heading)
                moved = (c * position[0] - s * position[1], s * position[0] + c * position[1])
                yield np.column_stack((places - moved, np.full(len(places), heading)))

    def _by_lines(self, view: FeatureView, headings: FloatArray) -> Iterator[FloatArray]:
        """By the longest line and the longest one across it."""
        ends = view.lines.ends_m
        if len(ends) < 2:
            return
        along = ends[:, 1] - ends[:, 0]
        length = np.hypot(along[:, 0], along[:, 1])
        one = int(np.argmax(length))
        sine = (along[one, 0] * along[:, 1] - along[one, 1] * along[:, 0]) / (length[one] * length)
        other = int(np.argmax(np.where(np.abs(sine) > CROSSING, length, -1.0)))
        if abs(sine[other]) <= CROSSING:
            return
        for heading in headings:
            c, s = math.cos(heading), math.sin(heading)
            seen = ends[[one, other]] @ np.array([[c, s], [-s, c]])
            yield self._where_both_fit(seen, heading)

    def _where_both_fit(self, seen: FloatArray, heading: float) -> FloatArray:
        """Poses of a heading at which two lines (2, 2, 2), turned by it, lie on two of the field's."""
        lines = self.model.lines
        first, second = (self._parallel(line) for line in seen)
        one, other = (grid.ravel() for grid in np.meshgrid(first, second))
        # the normal of each of the field's lines times the position is what is missing to its distance from the centre
        normals = np.stack((-lines[:, 1], lines[:, 0]), axis=1)
        missing_one = lines[one, 2] - normals[one] @ seen[0].mean(axis=0)
        missing_other = lines[other, 2] - normals[other] @ seen[1].mean(axis=0)
        matrices = np.stack((normals[one], normals[other]), axis=1)
        crossing = np.abs(np.linalg.det(matrices)) > CROSSING
        right = np.stack((missing_one, missing_other), axis=1)[crossing]
        places = np.linalg.solve(matrices[crossing], right[..., np.newaxis])[..., 0]
        return np.column_stack((places, np.full(len(places), heading)))

    def _parallel(self, line: FloatArray) -> IntArray:
        """Which of the field's lines a line (2, 2) may be part of."""
        lines, along = self.model.lines, line[1] - line[0]
        length = math.hypot(*along)
        sine = (lines[:, 0] * along[1] - lines[:, 1] * along[0]) / length
        return np.flatnonzero((np.abs(sine) < PARALLEL) & (lines[:, 4] > length - BEYOND_M))


def _longest(lines: LineFeatures) -> FloatArray:
    """From end to end of the longest line (2,)."""
    along = lines.ends_m[:, 1] - lines.ends_m[:, 0]
    return along[np.argmax((along**2).sum(axis=1))]
