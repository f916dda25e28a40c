"""Is a fit better than chance? What tells the lines of a field from scatter."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from touchline.geometry import FloatArray
from touchline.localization.one_shot.thinning import thinned, thinned_to
from touchline.localization.published.nubot.matcher import Matcher
from touchline.localization.registration.kernels import Plan
from touchline.localization.registration.registration import CLUTTER_PER_M, Registration
from touchline.localization.registration.weights import normalized
from touchline.localization.search.coarse_search import CoarseSearch, Window

PIECES = 8  # pieces that the view is cut into: some 45° of a full circle, about as much as one line fills
COPIES = 20  # rearranged copies of the points: enough for a mean and a deviation
CANDIDATES = 20  # poses refined for the points and for each copy
MAX_POINTS = 150  # points that take part: more only make a clear case clearer
COARSE_POINTS = 75  # and of these, evenly taken, so many judge the poses of the grid
STEPS = 8  # of Gauss and Newton: twelve find errors that are half a per cent smaller, of points and copies alike
_ALIKE_M2 = 1e-4  # variance of every point: what it is makes no difference


class PermutationTest(NamedTuple):
    """error: least mean error of the points; mean, deviation: of the least errors of their rearranged copies."""

    error: float
    mean: float
    deviation: float

    @property
    def significance(self) -> float:
        """How many deviations the points fit better than their copies."""
        return (self.mean - self.error) / max(self.deviation, 1e-6)


class Refiner:
    """Looks for the pose of points alike in a window of a search, by the error function alone.

    Gauss-Newton on the offsets, each weighed by (c² / (c² + d²))², comes to the least of e(d) in a third of the steps
    of RPROP. candidates: poses of the window that are refined.
    """

    def __init__(self, matcher: Matcher, search: CoarseSearch, window: Window, candidates: int) -> None:
        self.matcher, self.search = matcher, search
        self._window, self._candidates = window, candidates
        self._registration = Registration(matcher.distance_map)
        self._plan = Plan(np.full(STEPS, matcher.settings.c_m), 0.0, 0.0, CLUTTER_PER_M)

    def least_error(self, points: FloatArray) -> float:
        """Least mean error of the points (N, 2), all alike, over the refined best poses of the search."""
        some = np.ascontiguousarray(points[:: -(-len(points) // COARSE_POINTS)])
        starts = self.search.best(some, self._candidates, self._window)
        spreads = np.tile(_ALIKE_M2 * np.eye(2), (len(points), 1, 1))
        weights = normalized(np.ones(len(points)))
        fits = self._registration.register_all(points, spreads, starts, self._plan)
        return min(self.matcher.error(points, weights, pose) for pose in fits.poses)


def permutation_test(refiner: Refiner, points: FloatArray, seed: int) -> PermutationTest:
    """How much better the points (N, 2) fit the field than the same pieces in another arrangement.

    Any cloud of points fits some pose somehow: the best of a hundred thousand poses, on a field full of lines, leaves
    an error that depends on the field, on the number of points, on their ranges and on how they cling together. So the
    same points are asked: ordered by bearing they are cut into pieces of equal number, each piece is turned about
    the robot by a random angle, and the copy is searched in just the same way. This keeps everything that chance
    depends on, heaps and short streaks included, and destroys only what a true fit is made of: that the pieces lie to
    each other as on this field. Scatter is within 3 deviations of its copies whatever its form, because turning a
    piece of scatter changes nothing; lines seen well are 5 to 20 deviations better.

    Neighbours share their fate: ten points in one heap on a line are one piece of evidence, not ten. One point of each
    cell of the size c, the reach of the error function, is kept before the test, for points and copies alike.

    An easier test would let more true but poor scans pass, and scatter with them. Turning each point by itself puts two
    real scans with points noisy by decimetres at 3 and 6 deviations, and heaps of random points at 2 to 6; turning each
    clump of 0.7 m by itself puts those scans at -1 and 2, and the heaps at -1 to 2. Nothing in the points tells them
    apart, so they are refused, and the best pose is named with the refusal.
    """
    spread = thinned_to(thinned(points, refiner.matcher.settings.c_m), MAX_POINTS)
    generator = np.random.default_rng(seed)
    errors = [refiner.least_error(rearranged(spread, PIECES, generator)) for _ in range(COPIES)]
    error = refiner.least_error(spread)
    return PermutationTest(error, float(np.mean(errors)), float(np.std(errors, ddof=1)))


def rearranged(points: FloatArray, pieces: int, generator: np.random.Generator) -> FloatArray:
    """The points (N, 2), cut into pieces of equal number by bearing, each piece turned by an angle of its own."""
    ranges, bearings = np.hypot(points[:, 0], points[:, 1]), np.arctan2(points[:, 1], points[:, 0])
    order = np.roll(np.argsort(bearings), generator.integers(len(points)))
    for piece in np.array_split(order, pieces):
        bearings[piece] += generator.uniform(-np.pi, np.pi)
    return np.column_stack((ranges * np.cos(bearings), ranges * np.sin(bearings)))
