"""Is a fit better than chance? What tells line points from scatter."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from pydantic import Field

from touchline.config import Settings
from touchline.geometry import FloatArray
from touchline.localization.matching import Matcher
from touchline.localization.weights import normalized
from touchline.localization.whole_field import PoseGrid, thinned, thinned_to


class ChanceSettings(Settings):
    """The test against chance, see `chance_test`."""

    shuffles: int = Field(20, ge=5, description="shuffled copies of the points: enough for a mean and a deviation")
    least_significance: float = Field(
        4.0,
        gt=0,
        description="deviations by which the error must lie below that of shuffled points: with 20 copies, chance "
        "alone reaches this once in a thousand times",
    )
    candidates: int = Field(40, ge=1, description="poses refined for the points and for each shuffled copy")
    most_points: int = Field(150, ge=10, description="points that take part: more only make a clear case clearer")


class Chance(NamedTuple):
    """error: least mean error of the points; mean, deviation: of the least errors of their shuffled copies."""

    error: float
    mean: float
    deviation: float

    @property
    def significance(self) -> float:
        """How many deviations the points fit better than shuffled ones."""
        return (self.mean - self.error) / max(self.deviation, 1e-6)


def chance_test(
    matcher: Matcher, grid: PoseGrid, points: FloatArray, sample_c_m: float, settings: ChanceSettings, seed: int
) -> Chance:
    """How much better the points (N, 2) fit the field than points that have nothing to do with it.

    Any cloud of points fits some pose somehow: the best of a hundred thousand poses, on a field full of lines, leaves
    an error that depends on the field, on the number of points and on their ranges. So the same points are asked:
    their ranges stay, their bearings are dealt out anew, and the copy is searched in just the same way. This keeps
    all that chance depends on and destroys only the arrangement, which is what a true fit is made of.

    Neighbours share their fate: ten points in one heap on a line are one piece of evidence, not ten. One point of each
    cell of the size c, the reach of the error function, is kept before the test, for points and copies alike.
    """
    spread = thinned_to(thinned(points, matcher.settings.c_m), settings.most_points)
    ranges, bearings = np.hypot(spread[:, 0], spread[:, 1]), np.arctan2(spread[:, 1], spread[:, 0])
    generator = np.random.default_rng(seed)
    shuffled = []
    for _ in range(settings.shuffles):
        dealt = generator.permutation(bearings)
        copy = np.column_stack((ranges * np.cos(dealt), ranges * np.sin(dealt)))
        shuffled.append(least_error(matcher, grid, copy, sample_c_m, settings.candidates))
    error = least_error(matcher, grid, spread, sample_c_m, settings.candidates)
    return Chance(error, float(np.mean(shuffled)), float(np.std(shuffled, ddof=1)))


def least_error(matcher: Matcher, grid: PoseGrid, points: FloatArray, sample_c_m: float, candidates: int) -> float:
    """Least mean error of the points (N, 2), all alike, over the refined best poses of the grid."""
    weights = normalized(np.ones(len(points)))
    starts = grid.best(matcher.distance_map, points, sample_c_m, candidates)
    return min(matcher.descend(points, weights, start)[1] for start in starts)
