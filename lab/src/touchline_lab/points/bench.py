"""How well a localizer finds the true poses of a point set, and how close that comes to what is possible at all."""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline_lab.points.localizers import PointLocalizer
from touchline_lab.points.point_set import PointSet

RIGHT_M, RIGHT_RAD = 0.2, 0.0873  # a pose nearer to the truth than 20 cm and 5° is found
_WARM_UP = 2  # answers before the clock runs


@dataclass(frozen=True, slots=True)
class PointScore:
    """Of one way to begin: mean errors over all answers; times_bound: the greater of both over their bounds.

    success: share of the frames whose pose is found. us_per_update: median time of one answer.
    """

    mean_position_m: float
    mean_heading_rad: float
    times_bound: float
    success: float
    us_per_update: float


@dataclass(frozen=True, slots=True)
class PointBench:
    """The three scores, and the bound: mean position (m) and heading error (rad)."""

    bound_position_m: float
    bound_heading_rad: float
    init: PointScore
    compass: PointScore
    none: PointScore

    def to_dict(self) -> dict[str, Any]:
        """The tree of `touchline bench points --json`."""
        tree = asdict(self)
        bound = {key: tree.pop(f"bound_{key}") for key in ("position_m", "heading_rad")}
        return {**tree, "bound": bound}


def bench_points(
    points: PointSet, localizer: PointLocalizer, on_frame: Callable[[], None] = lambda: None
) -> PointBench:
    """Localises every frame from `init`, from `compass` alone and from nothing, where the twin is as right."""
    bound = points.bound()
    ways: tuple[tuple[Callable[[int], Pose | None], bool], ...] = (
        (lambda k: localizer.from_pose(points.points[k], Pose(*points.init[k])), False),
        (lambda k: localizer.from_heading(points.points[k], float(points.compass[k])), False),
        (lambda k: localizer.from_nothing(points.points[k]), points.field.is_symmetric),
    )
    scores = [_score(points, answer, twins, bound, on_frame) for answer, twins in ways]
    return PointBench(*bound, *scores)


def _score(
    points: PointSet,
    answer: Callable[[int], Pose | None],
    twins: bool,
    bound: tuple[float, float],
    on_frame: Callable[[], None],
) -> PointScore:
    for k in range(min(_WARM_UP, len(points))):
        answer(k)
    errors, times_s = np.empty((len(points), 2)), np.empty(len(points))
    for k, truth in enumerate(points.truth):
        begun_s = time.perf_counter()
        pose = answer(k)
        times_s[k] = time.perf_counter() - begun_s
        errors[k] = _errors(pose, Pose(*truth), twins, points)
        on_frame()
    position_m, heading_rad = (float(value) for value in errors.mean(axis=0))
    right = (errors[:, 0] < RIGHT_M) & (errors[:, 1] < RIGHT_RAD)
    times_bound = max(position_m / bound[0], heading_rad / bound[1])
    return PointScore(position_m, heading_rad, times_bound, float(right.mean()), 1e6 * float(np.median(times_s)))


def _errors(pose: Pose | None, truth: Pose, twins: bool, points: PointSet) -> FloatArray:
    """Position (m) and heading error (rad); without an answer those of the centre mark, facing the other way."""
    found = pose or Pose(0.0, 0.0, wrap_angle(truth.heading + np.pi))
    both = [
        np.array([found.distance_to(right), abs(wrap_angle(found.heading - right.heading))])
        for right in ((truth, truth.mirrored()) if twins else (truth,))
    ]
    return min(both, key=lambda errors: float(errors[0]))
