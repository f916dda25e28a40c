"""One mirror, the poses of all images and how far each line of the field lies aside, fitted together.

What the points can't tell stays near what is expected.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from touchline.calibration.lines.equations import BEND_X, BEND_Y, SHAPE, Lines, Noise, Seen, linearised
from touchline.calibration.lines.search import GROUND_M, WIDTHS
from touchline.calibration.lines.sides import sides_of
from touchline.geometry import FloatArray

BEND_PER_M = 0.015  # standard deviation of the bend: a mirror 0.3 degrees off per axis
STRAIGHT_M = 1e-6  # of lines that lie where the field says
HELD = 1e12
_ANYWHERE = 1e-4  # of a pose, where no line says: within 100 m
_CLOSE_PX = 6.0  # where the next line is so near, blur draws a point aside: it counts half
_MIN_GAP_M, _MAX_CROWDED = 0.001, 1000.0
_STEPS = 60
_SETTLED = 1e-3


class Expected(NamedTuple):
    """What is expected: of a mirror's parameters the mean (Q,) and the inverse of their covariance (Q, Q); of a line

    how far it usually lies aside (m); of a point the square of its residual, in standard deviations,
    where points that err together count as one; and by what factor (N,) standard deviations are larger than usual.
    """

    mean: FloatArray
    information: FloatArray
    line_m: float = STRAIGHT_M
    noise: float = 1.0
    wider: FloatArray | None = None


class JointFit(NamedTuple):
    """A fit: the mirror's parameters (Q,), a pose (x, y, heading) for each image (M, 3), how far each line lies aside

    (L,) in m, the mean robust error, the points' part of the cost, and the matrix (Q + 3 M + L, Q + 3 M + L) of its
    last step, expectations included.
    """

    mirror: FloatArray
    poses: FloatArray
    aside_m: FloatArray
    error: float
    cost: float
    matrix: FloatArray


class Linearised(NamedTuple):
    """All points: distances (N,) from the line they are nearest to, as it lies (m), their derivatives (N, P) by the

    state, standard deviations (N,) (m), the line's number (N,) and the image's (N,), and places on the field (N, 2).
    """

    distances_m: FloatArray
    rows: FloatArray
    sigmas_m: FloatArray
    line: npt.NDArray[np.intp]
    image: npt.NDArray[np.intp]
    places: FloatArray

    @property
    def residuals(self) -> FloatArray:
        """Distances (N,) in standard deviations: about pixels; infinite beyond the horizon."""
        beyond = ~np.isfinite(self.sigmas_m)
        values: FloatArray = np.where(beyond, np.inf, self.distances_m / np.where(beyond, 1.0, self.sigmas_m))
        return values


def expected_mirror(center: FloatArray, center_px: float, bends: bool) -> Expected:
    """What is expected of a mirror without a spline: a centre (2,) to within center_px, and nearly upright."""
    information = np.zeros((SHAPE, SHAPE))
    information[0, 0] = information[1, 1] = center_px**-2.0
    information[BEND_X, BEND_X] = information[BEND_Y, BEND_Y] = BEND_PER_M**-2.0 if bends else HELD
    return Expected(np.array([*center, 0.0, 0.0, 0.0, 0.0]), information)


def fit_jointly(seen: Sequence[Seen], start: JointFit, expected: Expected, lines: Lines, width: float) -> JointFit:
    """Levenberg's and Marquardt's steps from a start until they settle."""
    size, images = len(start.mirror), len(seen)
    state = np.concatenate((start.mirror, np.ravel(start.poses), start.aside_m))
    total, cost, matrix, vector = _whole(seen, state, size, expected, lines, width)
    damping = 1e-3
    for _ in range(_STEPS):
        damped = matrix + np.diag(damping * np.diag(matrix) + 1e-9)
        trial = state - np.linalg.solve(damped, vector)
        new = _whole(seen, trial, size, expected, lines, width)
        if not new[0] < total:
            damping *= 6.0
            if damping > 1e5:
                break
            continue
        settled = total - new[0] < _SETTLED
        state, (total, cost, matrix, vector) = trial, new
        damping = max(0.2 * damping, 1e-7)
        if settled:
            break
    points = sum(len(one.pixels) for one in seen)
    ends = np.cumsum([size, 3 * images])
    error = cost * expected.noise / (points * width**2)
    return JointFit(state[:size], state[size : ends[1]].reshape(-1, 3), state[ends[1] :], error, cost, matrix)


def fit_in_steps(seen: Sequence[Seen], start: JointFit, expected: Expected, lines: Lines) -> JointFit:
    """`fit_jointly` with a wide robust error, then with the narrowest."""
    wide = fit_jointly(seen, start, expected, lines, 12.0)
    wide = fit_jointly(seen, wide, expected, lines, WIDTHS[-2])
    return fit_jointly(seen, wide, expected, lines, WIDTHS[-1])


def starting(mirror: FloatArray, poses: FloatArray, lines: Lines) -> JointFit:
    """A start for `fit_jointly`, its lines where the field says."""
    aside = np.zeros(len(lines.tables.segments) + len(lines.tables.arcs))
    return JointFit(mirror, poses, aside, 0.0, 0.0, np.zeros((0, 0)))


def linearise(seen: Sequence[Seen], fit: JointFit, lines: Lines) -> Linearised:
    """The points of all images as a fit places them."""
    size, state = len(fit.mirror), np.concatenate((fit.mirror, np.ravel(fit.poses), fit.aside_m))
    parts = [_single(one, state, size, k, len(seen), lines) for k, one in enumerate(seen)]
    return Linearised(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def crowding(seen: Sequence[Seen], fit: JointFit, lines: Lines) -> FloatArray:
    """By what factor (N,) standard deviations are larger where blur draws two lines, or a line and its crossing, closer

    together or apart.
    """
    points = linearise(seen, fit, lines)
    _, _, next_m = sides_of(lines.tables, points.places)
    near = np.where(np.isfinite(points.sigmas_m), _CLOSE_PX * points.sigmas_m / np.maximum(next_m, _MIN_GAP_M), 0.0)
    factor: FloatArray = np.minimum(1.0 + near**4, _MAX_CROWDED)
    return factor


def _whole(
    seen: Sequence[Seen], state: FloatArray, size: int, expected: Expected, lines: Lines, width: float
) -> tuple[float, float, FloatArray, FloatArray]:
    """Cost, the points' part of it, and matrix and vector of a step, expectations included."""
    matrix, vector = _ANYWHERE * np.eye(len(state)), np.zeros(len(state))
    off, aside = state[:size] - expected.mean, state[size + 3 * len(seen) :]
    matrix[:size, :size] = expected.information
    vector[:size] = expected.information @ off
    expectation = float(off @ vector[:size]) + 2.0 * float(np.sum(np.log1p((aside / expected.line_m) ** 2)))
    last = np.arange(len(state) - len(aside), len(state))
    weights = 2.0 / (expected.line_m**2 + aside**2)  # Cauchy's: most lie as the field says, a few far off
    matrix[last, last] = weights
    vector[last] = weights * aside
    cost, first = 0.0, 0
    for k, one in enumerate(seen):
        distances, rows, sigmas = _single(one, state, size, k, len(seen), lines)[:3]
        if expected.wider is not None:
            sigmas = sigmas * expected.wider[first : first + len(sigmas)]
        first += len(sigmas)
        shares = 1.0 / (1.0 + (distances / (width * sigmas)) ** 2)
        shares[~np.isfinite(sigmas)] = 0.0
        weighted = rows * (shares**2 / (sigmas**2 * expected.noise))[:, np.newaxis]
        matrix += weighted.T @ rows
        vector += weighted.T @ distances
        cost += width**2 * float(np.sum(1.0 - shares)) / expected.noise
    return cost + expectation, cost, matrix, vector


def _single(one: Seen, state: FloatArray, size: int, k: int, images: int, lines: Lines) -> Linearised:
    """Those of image k alone."""
    pose = slice(size + 3 * k, size + 3 * k + 3)
    own = np.concatenate((state[:size], state[pose]))
    distances, slopes, sigmas, places = linearised(one, own, lines, Noise(GROUND_M, 1.0))
    line, side, _ = sides_of(lines.tables, places)
    first = size + 3 * images
    rows = np.zeros((len(distances), len(state)))
    rows[:, :size], rows[:, pose] = slopes[:, :size], slopes[:, size:]
    rows[np.arange(len(line)), first + line] = -side
    distances = distances - side * state[first + line]
    return Linearised(distances, rows, sigmas, line, np.full(len(line), k), places)
