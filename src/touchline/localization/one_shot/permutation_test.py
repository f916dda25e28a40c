"""Is a fit better than chance? What tells the lines of a field from scatter."""

from typing import NamedTuple

import numpy as np

from touchline.geometry import FloatArray
from touchline.localization.one_shot.point_search import C_M, PointSearch
from touchline.localization.one_shot.thinning import thinned, thinned_to

PIECES = 8  # pieces that the view is cut into: some 45° of a full circle, about as much as one line fills
COPIES = 20  # rearranged copies of the points: enough for a mean and a deviation
CANDIDATES = 20  # poses refined for the points and for each copy
MAX_POINTS = 150  # points that take part: more only make a clear case clearer


class PermutationTest(NamedTuple):
    """error: least mean error of the points; mean, deviation: of the least errors of their rearranged copies."""

    error: float
    mean: float
    deviation: float

    @property
    def significance(self) -> float:
        """How many deviations the points fit better than their copies."""
        return (self.mean - self.error) / max(self.deviation, 1e-6)


def permutation_test(
    search: PointSearch, points: FloatArray, seed: int, candidates: int = CANDIDATES
) -> PermutationTest:
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
    spread = thinned_to(thinned(points, C_M), MAX_POINTS)
    generator = np.random.default_rng(seed)
    errors = [search.refined(rearranged(spread, PIECES, generator), candidates)[0][1] for _ in range(COPIES)]
    error = search.refined(spread, candidates)[0][1]
    return PermutationTest(error, float(np.mean(errors)), float(np.std(errors, ddof=1)))


def rearranged(points: FloatArray, pieces: int, generator: np.random.Generator) -> FloatArray:
    """The points (N, 2), cut into pieces of equal number by bearing, each piece turned by an angle of its own."""
    ranges, bearings = np.hypot(points[:, 0], points[:, 1]), np.arctan2(points[:, 1], points[:, 0])
    order = np.roll(np.argsort(bearings), generator.integers(len(points)))
    for piece in np.array_split(order, pieces):
        bearings[piece] += generator.uniform(-np.pi, np.pi)
    return np.column_stack((ranges * np.cos(bearings), ranges * np.sin(bearings)))
