"""One mirror, the poses of all images and how far each line of the field lies aside, fitted together.

What the points can't tell stays near what is expected.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from touchline.calibration.bundle import Equations, NormalEquations, minimise, prior_block, residual_block
from touchline.calibration.lines.equations import (
    BEND_X,
    BEND_Y,
    GROUND_M,
    SHAPE,
    WIDTHS,
    Lines,
    Noise,
    Seen,
    linearised,
)
from touchline.calibration.nearest_line import nearest_line, outward
from touchline.geometry import FloatArray, IndexArray

BEND_PER_M = 0.015  # standard deviation of the bend: a mirror 0.3 degrees off per axis
STRAIGHT_M = 1e-6  # of lines that lie where the field says
HELD = 1e12
_ANYWHERE = 1e-4  # of a pose, where no line says: within 100 m
_CLOSE_PX = 6.0  # where the next line is so near, blur draws a point aside: it counts half
_MIN_GAP_M, _MAX_CROWDED = 0.001, 1000.0


class Expected(NamedTuple):
    """What is expected: of a mirror's parameters the mean (Q,) and the inverse of their covariance (Q, Q); of a line

    how far it usually lies aside (m), and of all how far they lie towards their outer edges; of a point the square of
    its residual, in standard deviations, where points that err together count as one; and by what factor (N,) standard
    deviations are larger than usual. together: a fit that tells how far lines may lie aside, and their edges.
    """

    mean: FloatArray
    information: FloatArray
    line_m: float = STRAIGHT_M
    edge_m: float = STRAIGHT_M
    noise: float = 1.0
    wider: FloatArray | None = None
    together: "JointFit | None" = None


class JointFit(NamedTuple):
    """A fit: the mirror's parameters (Q,), a pose (x, y, heading) for each image (M, 3), how far each line lies aside

    (L,) in m, how far all lie towards their outer edges, the mean robust error, the points' part of the cost, and the
    matrix (Q + 3 M + L + 1, Q + 3 M + L + 1) of its last step, expectations included.
    """

    mirror: FloatArray
    poses: FloatArray
    aside_m: FloatArray
    edge_m: float
    error: float
    cost: float
    matrix: FloatArray


class Linearised(NamedTuple):
    """Points: distances (N,) from the line they are nearest to, as it lies (m), their derivatives (N, P) by the

    state, standard deviations (N,) (m), the line's number (N,) and the image's (N,), and places on the field (N, 2).
    """

    distances_m: FloatArray
    rows: FloatArray
    sigmas_m: FloatArray
    line: IndexArray
    image: IndexArray
    places: FloatArray

    @property
    def residuals(self) -> FloatArray:
        """Distances (N,) in standard deviations: about pixels; infinite beyond the horizon."""
        beyond = ~np.isfinite(self.sigmas_m)
        return np.where(beyond, np.inf, self.distances_m / np.where(beyond, 1.0, self.sigmas_m))


def expected_mirror(center: FloatArray, center_px: float, bends: bool) -> Expected:
    """What is expected of a mirror without a spline: a centre (2,) to within center_px, and nearly upright."""
    information = np.zeros((SHAPE, SHAPE))
    information[0, 0] = information[1, 1] = center_px**-2.0
    information[BEND_X, BEND_X] = information[BEND_Y, BEND_Y] = BEND_PER_M**-2.0 if bends else HELD
    return Expected(np.array([*center, 0.0, 0.0, 0.0, 0.0]), information)


def fit_jointly(seen: Sequence[Seen], start: JointFit, expected: Expected, lines: Lines, width: float) -> JointFit:
    """Levenberg's and Marquardt's steps from a start until they settle."""
    size = len(start.mirror)
    state, found = minimise(lambda state: _equations(seen, state, size, expected, lines, width), _state(start))
    cost = found.cost - _priors(state, size, len(seen), expected).cost
    poses, aside = np.split(state[size:], [3 * len(seen)])
    error = cost * expected.noise / (sum(len(one.pixels) for one in seen) * width**2)
    matrix = NormalEquations(found.blocks).matrix.toarray()
    return JointFit(state[:size], poses.reshape(-1, 3), aside[:-1], float(aside[-1]), error, cost, matrix)


def _state(fit: JointFit) -> FloatArray:
    return np.concatenate((fit.mirror, np.ravel(fit.poses), fit.aside_m, [fit.edge_m]))


def fit_in_steps(seen: Sequence[Seen], start: JointFit, expected: Expected, lines: Lines) -> JointFit:
    """`fit_jointly` with a wide robust error, then with the narrowest."""
    wide = fit_jointly(seen, start, expected, lines, 12.0)
    wide = fit_jointly(seen, wide, expected, lines, WIDTHS[-2])
    return fit_jointly(seen, wide, expected, lines, WIDTHS[-1])


def starting(mirror: FloatArray, poses: FloatArray, lines: Lines) -> JointFit:
    """A start for `fit_jointly`, its lines where the field says."""
    aside = np.zeros(len(lines.tables.segments) + len(lines.tables.arcs))
    return JointFit(mirror, poses, aside, 0.0, 0.0, 0.0, np.zeros((0, 0)))


def linearise(seen: Sequence[Seen], fit: JointFit, lines: Lines) -> Linearised:
    """The points of all images as a fit places them."""
    state, parts = _state(fit), []
    for k, one in enumerate(seen):
        at, part = _single(one, state, len(fit.mirror), k, len(seen), lines)
        rows = np.zeros((len(part.rows), len(state)))
        rows[:, at] = part.rows
        parts.append(part._replace(rows=rows))
    return Linearised(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def crowding(seen: Sequence[Seen], fit: JointFit, lines: Lines) -> FloatArray:
    """By what factor (N,) standard deviations are larger where blur draws two lines, or a line and its crossing, closer

    together or apart.
    """
    points = linearise(seen, fit, lines)
    next_m = nearest_line(lines.tables, points.places).next_m
    near = np.where(np.isfinite(points.sigmas_m), _CLOSE_PX * points.sigmas_m / np.maximum(next_m, _MIN_GAP_M), 0.0)
    return np.minimum(1.0 + near**4, _MAX_CROWDED)


def _equations(
    seen: Sequence[Seen], state: FloatArray, size: int, expected: Expected, lines: Lines, width: float
) -> Equations:
    """Cost and normal equations at a state, expectations included."""
    blocks, cost = _priors(state, size, len(seen), expected)
    first = 0
    for k, one in enumerate(seen):
        at, part = _single(one, state, size, k, len(seen), lines)
        sigmas = part.sigmas_m
        if expected.wider is not None:
            sigmas = sigmas * expected.wider[first : first + len(sigmas)]
        first += len(sigmas)
        shares = 1.0 / (1.0 + (part.distances_m / (width * sigmas)) ** 2)
        shares[~np.isfinite(sigmas)] = 0.0
        blocks.append(residual_block(at, part.rows, part.distances_m, shares**2 / (sigmas**2 * expected.noise)))
        cost += width**2 * float(np.sum(1.0 - shares)) / expected.noise
    return Equations(blocks, cost)


def _priors(state: FloatArray, size: int, images: int, expected: Expected) -> Equations:
    """What is expected of mirror, poses and lines: most lie as the field says, a few far off (Cauchy's prior)."""
    mirror, poses, asides, edge = np.split(np.arange(len(state)), [size, size + 3 * images, len(state) - 1])
    off, aside, edge_m = state[mirror] - expected.mean, state[asides], state[edge]
    weights, lines_cost = 2.0 / (expected.line_m**2 + aside**2), 2.0 * np.log1p((aside / expected.line_m) ** 2)
    if (fit := expected.together) is not None:
        weights = 2.0 / (expected.line_m**2 + fit.aside_m**2)
        lines_cost, edge_m = weights * aside**2, edge_m - fit.edge_m
    blocks = [
        prior_block(mirror, expected.information, off),
        prior_block(poses, np.full(len(poses), _ANYWHERE), np.zeros(len(poses))),
        prior_block(asides, weights, aside),
        prior_block(edge, np.array([expected.edge_m**-2.0]), edge_m),
    ]
    cost = float(off @ expected.information @ off) + float(np.sum(lines_cost))
    cost += float(edge_m[0] / expected.edge_m) ** 2
    return Equations(blocks, cost)


def _single(
    one: Seen, state: FloatArray, size: int, k: int, images: int, lines: Lines
) -> tuple[IndexArray, Linearised]:
    """The points of image k, and the numbers (K,) of the state's entries that they depend on: columns of the rows."""
    own = np.concatenate((np.arange(size), size + 3 * k + np.arange(3)))
    distances, slopes, sigmas, places = linearised(one, state[own], lines, Noise(GROUND_M, 1.0))
    nearest = nearest_line(lines.tables, places)
    line, side = nearest.line, nearest.side
    met, column = np.unique(line, return_inverse=True)
    by_line = np.where(column[:, np.newaxis] == np.arange(len(met)), -side[:, np.newaxis], 0.0)
    first, to_edge = size + 3 * images, side * outward(lines.tables)[line]
    part = Linearised(
        distances - side * state[first + line] - to_edge * state[-1],
        np.hstack((slopes, by_line, -to_edge[:, np.newaxis])),
        sigmas,
        line,
        np.full(len(line), k),
        places,
    )
    return np.concatenate((own, first + met, [len(state) - 1])), part
