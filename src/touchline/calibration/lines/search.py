"""The search for mirrors that may be, from nothing: found in the clearest images alone, and judged by all images.

In an image there are many random starts, each followed down to its own best fit.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from touchline.calibration.lines.equations import (
    LOG_SCALE,
    PER_PX,
    SHAPE,
    STEEPEST_RAD,
    WIDTHS,
    Lines,
    Noise,
    Seen,
    equations,
)
from touchline.calibration.lines.joint import HELD, expected_mirror, fit_in_steps, starting
from touchline.field import FieldModel
from touchline.geometry import FloatArray

STARTS = 3000
POSE_STARTS = 400  # of the pose alone, once a mirror is given
SEARCH_POINTS = 200  # of an image that the search looks at
KEPT = 0.4  # of the states after each width
STEPS = 15  # of Gauss and Newton at each width
SEARCH_GROUND_M = 0.001  # of the search: with more, a mirror that shrinks all points to one spot would fit well
CENTER_PX = 0.06  # standard deviation of the centre about the mirror's circle or the points, as a share of its radius
SCALE_M = (0.4, 4.0)  # bounds of a in r = a tan(b rho): it is about twice a mirror's height
TURN_RAD = (0.6, 1.53)  # bounds of b rho at the outermost point
BEYOND_M = 1.0  # how far beside the field the robot may stand
_SEARCHED_IMAGES = 2  # with the most points
_CANDIDATES = 4  # different mirrors of an image that all images judge
_SAME_PX, _SAME_RATIO = 4.0, 0.06  # two mirrors are one: centres, and ranges where points are
_ROW_PX, _ROW_WIDTH_PX, _ROW_NEIGHBOURS, _ROW_DIRECTIONS = 20.0, 1.2, 3, 24  # what points in a row are
_MIN_POINTS = 60  # that are searched with, in rows or not
_POINTS_RADIUS = 95  # percentile of the points' radii: what lies beyond may be the hall


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


class Candidate(NamedTuple):
    """A mirror's parameters (6,), a pose (x, y, heading) in each image (M, 3), and the mean robust error (0..1)."""

    mirror: FloatArray
    poses: FloatArray
    error: float


def find_candidates(
    seen: Sequence[Seen], center: FloatArray, field: FieldModel, lines: Lines, rng: np.random.Generator
) -> list[Candidate]:
    """Different mirrors, best first, that explain line points of images; the mirror's centre is about `center` (2,)."""
    radius = float(np.percentile(np.concatenate([np.hypot(*(one.pixels - center).T) for one in seen]), _POINTS_RADIUS))
    bounds = search_bounds(field, center, radius)
    few = [one._replace(pixels=_few(one.pixels, rng)) for one in seen]
    found: list[Candidate] = []
    for index in np.argsort([-len(one.pixels) for one in seen])[:_SEARCHED_IMAGES]:
        states, _ = fitted_starts(few[index], random_starts(bounds, field, STARTS, rng), bounds, lines)
        for state in _different(states, radius)[:_CANDIDATES]:
            if not any(_alike(state, other.mirror, radius) for other in found):
                found.append(_judged(state, int(index), few, bounds, field, lines, rng))
    together: list[Candidate] = []
    exact = lines._replace(exact=True)
    for one in sorted(found, key=lambda candidate: candidate.error)[:_CANDIDATES]:
        expected = expected_mirror(center, CENTER_PX * radius, bends=len(seen) > 1)
        fit = fit_in_steps(few, starting(one.mirror, one.poses, exact), expected, exact)
        if not any(_alike(fit.mirror, other.mirror, radius) for other in together):
            together.append(Candidate(fit.mirror, fit.poses, fit.error))
    return sorted(together, key=lambda candidate: candidate.error)


def _few(pixels: FloatArray, rng: np.random.Generator) -> FloatArray:
    """At most SEARCH_POINTS of pixels (N, 2), those that lie in rows first: what stands in the hall seldom does."""
    mixed = pixels[rng.permutation(len(pixels))[: 2 * SEARCH_POINTS]]
    steps = mixed[np.newaxis] - mixed[:, np.newaxis]
    lengths = np.hypot(steps[..., 0], steps[..., 1])
    near = (lengths > 0.0) & (lengths < _ROW_PX)
    best = np.zeros(len(mixed))
    for angle in np.pi * np.arange(_ROW_DIRECTIONS) / _ROW_DIRECTIONS:
        aside = np.abs(steps[..., 0] * np.sin(angle) - steps[..., 1] * np.cos(angle))
        best = np.maximum(best, np.sum(near & (aside < _ROW_WIDTH_PX), axis=1))
    order = np.argsort(best < _ROW_NEIGHBOURS, kind="stable")
    in_rows = max(int(np.sum(best >= _ROW_NEIGHBOURS)), min(len(mixed), _MIN_POINTS))
    return np.ascontiguousarray(mixed[order[: min(in_rows, SEARCH_POINTS)]])


def _different(states: FloatArray, radius: float) -> list[FloatArray]:
    kept: list[FloatArray] = []
    for state in states:
        if not any(_alike(state, other, radius) for other in kept):
            kept.append(state)
    return kept


def _alike(one: FloatArray, other: FloatArray, radius: float) -> bool:
    """Whether two mirrors show the same: centres, and ranges at three radii."""
    if np.hypot(*(one[:2] - other[:2])) > _SAME_PX:
        return False
    radii = radius * np.array([0.5, 0.7, 0.9])
    a, b = (s[LOG_SCALE] + np.log(np.tan(np.minimum(s[PER_PX] * radii, STEEPEST_RAD))) for s in (one, other))
    return bool(np.abs(a - b).max() < _SAME_RATIO)


def _judged(
    state: FloatArray,
    index: int,
    seen: Sequence[Seen],
    bounds: Start,
    field: FieldModel,
    lines: Lines,
    rng: np.random.Generator,
) -> Candidate:
    """A mirror found in image `index`, with the best pose in every image."""
    held = Start(bounds.low, bounds.high, state, np.concatenate((np.full(SHAPE, HELD), np.zeros(3))))
    poses, errors = [], []
    for k, one in enumerate(seen):
        starts = state[np.newaxis]
        if k != index:
            starts = random_starts(bounds, field, POSE_STARTS, rng)
            starts[:, :SHAPE] = state[:SHAPE]
        best, error = fitted_starts(one, starts, held, lines)
        poses.append(best[0, SHAPE:])
        errors.append(error[0])
    return Candidate(state[:SHAPE], np.array(poses), float(np.mean(errors)))
