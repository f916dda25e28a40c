"""One mirror and the poses of all images, fitted together; what the lines can't tell stays near what is expected."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from touchline.calibration.lines.equations import (
    BEND_X,
    BEND_Y,
    LOG_SCALE,
    PER_PX,
    SHAPE,
    Lines,
    Noise,
    Seen,
    equations,
)
from touchline.calibration.lines.search import GROUND_M, WIDTHS
from touchline.geometry import FloatArray

BEND_PER_M = 0.015  # standard deviation of the bend: a mirror 0.3 degrees off per axis
KNOTS = 24  # intervals of the spline between the centre and the outermost point
SLOPE = 0.2  # standard deviation of how much the spline changes from knot to knot, where no line says
_HELD = 1e12
_STEPS = 60
_SETTLED = 1e-7


class Expected(NamedTuple):
    """What is expected of a mirror's parameters: mean (Q,) and the inverse of its covariance (Q, Q)."""

    mean: FloatArray
    information: FloatArray


class JointFit(NamedTuple):
    """A fit: the mirror's parameters (Q,), a pose (x, y, heading) for each image (M, 3), the mean robust error, and

    the matrix (Q + 3 M, Q + 3 M) of its last step, expectations included.
    """

    mirror: FloatArray
    poses: FloatArray
    error: float
    matrix: FloatArray


def expected_mirror(center: FloatArray, center_px: float, bends: bool) -> Expected:
    """What is expected of a mirror without a spline: a centre (2,) to within center_px, and nearly upright."""
    information = np.zeros((SHAPE, SHAPE))
    information[0, 0] = information[1, 1] = center_px**-2.0
    information[BEND_X, BEND_X] = information[BEND_Y, BEND_Y] = BEND_PER_M**-2.0 if bends else _HELD
    return Expected(np.array([*center, 0.0, 0.0, 0.0, 0.0]), information)


def with_spline(mirror: FloatArray, expected: Expected, curvature: float) -> tuple[FloatArray, Expected]:
    """The mirror with a spline that is still zero, and what is expected of it.

    curvature: standard deviation of a second difference between knots. The tangent stays as it is from here on: the
    spline says how the range differs from it.
    """
    count = KNOTS + 3
    wide = np.concatenate((mirror[:SHAPE], np.zeros(count)))
    information = np.zeros((len(wide), len(wide)))
    information[:SHAPE, :SHAPE] = expected.information
    first, second = np.diff(np.eye(count), axis=0), np.diff(np.eye(count), n=2, axis=0)
    information[SHAPE:, SHAPE:] = first.T @ first / SLOPE**2 + second.T @ second / curvature**2 + 1e-4 * np.eye(count)
    mean = np.concatenate((expected.mean, np.zeros(count)))
    for k in (LOG_SCALE, PER_PX):
        mean[k], information[k, k] = mirror[k], _HELD
    return wide, Expected(mean, information)


def fit_jointly(
    seen: Sequence[Seen], mirror: FloatArray, poses: FloatArray, expected: Expected, lines: Lines, width: float
) -> JointFit:
    """Levenberg's and Marquardt's steps on the mirror (Q,) and the poses (M, 3) of the images until they settle."""
    noise = Noise(GROUND_M, width)
    state = np.concatenate((mirror, np.ravel(poses)))
    error, matrix, vector = _whole(seen, state, len(mirror), expected, lines, noise)
    damping = 1e-3
    for _ in range(_STEPS):
        damped = matrix + np.diag(damping * np.diag(matrix) + 1e-9)
        trial = state - np.linalg.solve(damped, vector)
        new, new_matrix, new_vector = _whole(seen, trial, len(mirror), expected, lines, noise)
        if new >= error:
            damping *= 6.0
            if damping > 1e5:
                break
            continue
        settled = error - new < _SETTLED * len(seen)
        state, error, matrix, vector = trial, new, new_matrix, new_vector
        damping = max(0.2 * damping, 1e-7)
        if settled:
            break
    size = len(mirror)
    plain = np.mean([_single(one, state, k, size, lines, noise)[0] for k, one in enumerate(seen)])
    return JointFit(state[:size], state[size:].reshape(-1, 3), float(plain), matrix)


def fit_in_steps(
    seen: Sequence[Seen], mirror: FloatArray, poses: FloatArray, expected: Expected, lines: Lines
) -> JointFit:
    """`fit_jointly` with a wide robust error, then with the narrowest."""
    wide = fit_jointly(seen, mirror, poses, expected, lines, 12.0)
    wide = fit_jointly(seen, wide.mirror, wide.poses, expected, lines, WIDTHS[-2])
    return fit_jointly(seen, wide.mirror, wide.poses, expected, lines, WIDTHS[-1])


def _whole(
    seen: Sequence[Seen], state: FloatArray, size: int, expected: Expected, lines: Lines, noise: Noise
) -> tuple[float, FloatArray, FloatArray]:
    """Error, matrix and vector of all images together, expectations included."""
    matrix, vector = np.zeros((len(state), len(state))), np.zeros(len(state))
    off = state[:size] - expected.mean
    matrix[:size, :size] = expected.information
    vector[:size] = expected.information @ off
    points = sum(len(one.pixels) for one in seen)
    total = float(off @ vector[:size])
    for k, one in enumerate(seen):
        error, part, slope = _single(one, state, k, size, lines, noise)
        index = np.concatenate((np.arange(size), size + 3 * k + np.arange(3)))
        matrix[np.ix_(index, index)] += part
        vector[index] += slope
        total += error * len(one.pixels) * noise.width**2
    return total / (points * noise.width**2), matrix, vector


def _single(
    one: Seen, state: FloatArray, k: int, size: int, lines: Lines, noise: Noise
) -> tuple[float, FloatArray, FloatArray]:
    own = np.concatenate((state[:size], state[size + 3 * k : size + 3 * k + 3]))
    matrix, vector = np.zeros((len(own), len(own))), np.zeros(len(own))
    return equations(one, own, lines, noise, matrix, vector), matrix, vector
