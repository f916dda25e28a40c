"""The search for mirror and pose, from nothing: many random starts, each followed down to its own best fit."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

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
    states = starts
    for width in WIDTHS:
        states, errors = _descended(seen, states, bounds, lines, Noise(SEARCH_GROUND_M, width))
        best = np.argsort(errors)
        if width != WIDTHS[-1]:
            best = best[: max(1, int(KEPT * len(best)))]
        states, errors = states[best], errors[best]
    return states, errors


def _descended(
    seen: Seen, states: FloatArray, bounds: Start, lines: Lines, noise: Noise
) -> tuple[FloatArray, FloatArray]:
    """States (S, P) after Levenberg's and Marquardt's steps within bounds, each with a damping of its own, and their
    errors (S,).
    """
    states, going, damping = states.copy(), np.arange(len(states)), np.full(len(states), 1e-2)
    errors, matrices, vectors = _equations_at(seen, states, bounds, lines, noise)
    for _ in range(STEPS):
        diagonals = np.diagonal(matrices[going], axis1=1, axis2=2)
        raised = damping[going, np.newaxis] * (diagonals + 1e-6) + bounds.weight
        pull = vectors[going] + bounds.weight * (states[going] - bounds.mean)
        step = np.linalg.solve(
            matrices[going] + raised[..., np.newaxis] * np.eye(states.shape[1]), pull[..., np.newaxis]
        )
        trial = np.clip(states[going] - step[..., 0], bounds.low, bounds.high)
        new, *equations = _equations_at(seen, trial, bounds, lines, noise)
        gained = errors[going] - new
        better = going[gained > 0.0]
        states[better], errors[better] = trial[gained > 0.0], new[gained > 0.0]
        matrices[better], vectors[better] = (each[gained > 0.0] for each in equations)
        damping[going] = np.where(gained > 0.0, np.maximum(0.2 * damping[going], 1e-5), 8.0 * damping[going])
        going = going[np.where(gained > 0.0, gained >= 1e-5, damping[going] <= 1e4)]
        if not len(going):
            break
    return states, errors


def _equations_at(
    seen: Seen, states: FloatArray, bounds: Start, lines: Lines, noise: Noise
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Errors (S,) of states (S, P), that of their bounds included, with matrices (S, P, P) and vectors (S, P)."""
    errors, matrices, vectors = equations(seen, np.ascontiguousarray(states), lines, noise)
    strain = ((states - bounds.mean) ** 2 @ bounds.weight) / (len(seen.pixels) * noise.width**2)
    return errors + strain, matrices, vectors
