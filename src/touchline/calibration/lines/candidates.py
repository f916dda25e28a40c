"""Mirrors that may be: found in the clearest images alone, and judged by all images."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from touchline.calibration.lines.equations import LOG_SCALE, PER_PX, SHAPE, STEEPEST_RAD, Lines, Seen
from touchline.calibration.lines.joint import expected_mirror, fit_in_steps, starting
from touchline.calibration.lines.search import (
    CENTER_PX,
    POSE_STARTS,
    SEARCH_POINTS,
    STARTS,
    Start,
    fitted_starts,
    random_starts,
    search_bounds,
)
from touchline.field import FieldModel
from touchline.geometry import FloatArray

_SEARCHED_IMAGES = 2  # with the most points
_CANDIDATES = 4  # different mirrors of an image that all images judge
_SAME_PX, _SAME_RATIO = 4.0, 0.06  # two mirrors are one: centres, and ranges where points are
_HELD = 1e12
_ROW_PX, _ROW_WIDTH_PX, _ROW_NEIGHBOURS, _ROW_DIRECTIONS = 20.0, 1.2, 3, 24  # what points in a row are
_MIN_POINTS = 60  # that are searched with, in rows or not
_POINTS_RADIUS = 95  # percentile of the points' radii: what lies beyond may be the hall


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
    few: FloatArray = np.ascontiguousarray(mixed[order[: min(in_rows, SEARCH_POINTS)]])
    return few


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
    held = Start(bounds.low, bounds.high, state, np.concatenate((np.full(SHAPE, _HELD), np.zeros(3))))
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
