"""The search for mirror and pose, from nothing: many random starts, each followed down to its own best fit."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.calibration.lines.equations import (
    LOG_SCALE,
    PER_PX,
    Lines,
    Noise,
    Seen,
    equations,
)
from touchline.field import FieldModel
from touchline.geometry import FloatArray

STARTS = 3000
POSE_STARTS = 400  # of the pose alone, once a mirror is given
SEARCH_POINTS = 200  # of an image that the search looks at
WIDTHS = (20.0, 6.0, 2.5)  # of the robust error (px), one after the other: the first reaches from line to line
KEPT = 0.4  # of the states after each width
STEPS = 15  # of Gauss and Newton at each width
GROUND_M = 0.01  # carpets and tape measures
SEARCH_GROUND_M = 0.001  # of the search: with more, a mirror that shrinks all points to one spot would fit well
CENTER_PX = 0.06  # standard deviation of the centre about the mirror's circle or the points, as a share of its radius
SCALE_M = (0.4, 4.0)  # bounds of a in r = a tan(b rho): it is about twice a mirror's height
TURN_RAD = (0.6, 1.53)  # bounds of b rho at the outermost point
BEYOND_M = 1.0  # how far beside the field the robot may stand


class Start(NamedTuple):
    """Bounds low, high (9,) of a state, its expected mean (9,), and the weight (9,) with which it is held there."""

    low: FloatArray
    high: FloatArray
    mean: FloatArray
    weight: FloatArray


def search_bounds(field: FieldModel, center: FloatArray, radius_px: float) -> Start:
    """Where mirrors and poses are looked for: about a centre (2,) u, v, points reaching out to a radius (px)."""
    half = np.array([0.5 * field.length + BEYOND_M, 0.5 * field.width + BEYOND_M])
    scales, turns = np.log(SCALE_M), np.array(TURN_RAD) / radius_px
    reach = 4.0 * CENTER_PX * radius_px
    low = np.array([*(center - reach), scales[0], turns[0], 0.0, 0.0, *-half, -np.inf])
    high = np.array([*(center + reach), scales[1], turns[1], 0.0, 0.0, *half, np.inf])
    mean, weight = np.zeros(9), np.zeros(9)
    mean[:2], weight[:2] = center, (CENTER_PX * radius_px) ** -2.0
    return Start(low, high, mean, weight)


def random_starts(bounds: Start, field: FieldModel, count: int, rng: np.random.Generator) -> FloatArray:
    """Random states (count, 9): the mirror about the expected one, the pose anywhere on one half of the field."""
    starts = np.zeros((count, 9))
    starts[:, :2] = bounds.mean[:2] + rng.normal(0.0, 0.4, (count, 2)) * bounds.weight[:2] ** -0.5
    starts[:, LOG_SCALE] = rng.uniform(np.log(0.6), np.log(3.5), count)
    starts[:, PER_PX] = rng.uniform(0.35, 1.0, count) * bounds.high[PER_PX]
    starts[:, 6] = rng.uniform(0.0, bounds.high[6], count)
    starts[:, 7] = rng.uniform(bounds.low[7], bounds.high[7], count)
    starts[:, 8] = rng.uniform(-np.pi, np.pi, count)
    return starts


def fitted_starts(seen: Seen, starts: FloatArray, bounds: Start, lines: Lines) -> tuple[FloatArray, FloatArray]:
    """The best of the states (S, P) after the descent, best first, and their errors (S,)."""
    states = starts.copy()
    for width in WIDTHS:
        errors = _descend_all(seen, states, bounds, lines, Noise(SEARCH_GROUND_M, width), STEPS)
        best = np.argsort(errors)
        if width != WIDTHS[-1]:
            best = best[: max(1, int(KEPT * len(best)))]
        states, errors = np.ascontiguousarray(states[best]), errors[best]
    return states, errors


@njit(cache=True)
def _descend_all(seen, states, bounds, lines, noise, steps):  # type: ignore[no-untyped-def]
    errors = np.empty(len(states))
    for i in range(len(states)):
        errors[i] = _descend(seen, states[i], bounds, lines, noise, steps)
    return errors


@njit(cache=True)
def _descend(seen, state, bounds, lines, noise, steps):  # type: ignore[no-untyped-def]
    """Levenberg's and Marquardt's steps on one state, in place, within bounds; returns its error."""
    size, n = len(state), len(seen.pixels)
    matrix, vector = np.zeros((size, size)), np.zeros(size)
    next_matrix, next_vector = np.zeros((size, size)), np.zeros(size)
    damped, step, trial = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    damping = 1e-2
    error = equations(seen, state, lines, noise, matrix, vector) + _strain(state, bounds, n, noise)
    for _ in range(steps):
        for k in range(size):
            for m in range(size):
                damped[k, m] = matrix[k, m]
            damped[k, k] += damping * (matrix[k, k] + 1e-6) + bounds.weight[k]
            step[k] = -vector[k] - bounds.weight[k] * (state[k] - bounds.mean[k])
        if not _solve(damped, step):
            damping *= 10.0
            continue
        for k in range(size):
            trial[k] = min(max(state[k] + step[k], bounds.low[k]), bounds.high[k])
        new = equations(seen, trial, lines, noise, next_matrix, next_vector) + _strain(trial, bounds, n, noise)
        if new >= error:
            damping *= 8.0
            if damping > 1e4:
                break
            continue
        gained = error - new
        error, damping = new, max(0.2 * damping, 1e-5)
        state[:], matrix[:], vector[:] = trial, next_matrix, next_vector
        if gained < 1e-5:
            break
    return error


@njit(cache=True)
def _strain(state, bounds, n, noise):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(len(state)):
        total += bounds.weight[k] * (state[k] - bounds.mean[k]) ** 2
    return total / (n * noise.width**2)


@njit(cache=True)
def _solve(matrix, vector):  # type: ignore[no-untyped-def]
    """Solve in place by Cholesky's factors; False for a matrix that is not positive definite."""
    size = len(vector)
    for i in range(size):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i == j:
                if total <= 1e-14:
                    return False
                matrix[i, i] = np.sqrt(total)
            else:
                matrix[i, j] = total / matrix[j, j]
    for i in range(size):
        for k in range(i):
            vector[i] -= matrix[i, k] * vector[k]
        vector[i] /= matrix[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            vector[i] -= matrix[k, i] * vector[k]
        vector[i] /= matrix[i, i]
    return True
