"""The last line of a step: the estimate, and the time that it took."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import ParamSpec, TypeVar

from touchline.geometry import FloatArray
from touchline.localization.published.nubot.belief import Belief
from touchline.localization.published.nubot.matcher import Match
from touchline.localization.published.nubot.pose_filter import PoseFilter
from touchline.types import Estimate, Hypothesis, Observation

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


class Stopwatch:
    """Runs from the beginning of a step; what perception takes is counted by itself."""

    def __init__(self) -> None:
        self._started_s = time.perf_counter()
        self.perception_ms = 0.0

    def perception(self, see: Callable[Arguments, Result], *args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        """The result of a call that belongs to perception."""
        before_s = time.perf_counter()
        result = see(*args, **kwargs)
        self.perception_ms += 1e3 * (time.perf_counter() - before_s)
        return result

    @property
    def localization_ms(self) -> float:
        """Everything so far but perception."""
        return 1e3 * (time.perf_counter() - self._started_s) - self.perception_ms


def report(
    observation: Observation,
    pose_filter: PoseFilter,
    belief: Belief,
    match: Match | None,
    hypotheses: tuple[Hypothesis, ...],
    clock: Stopwatch,
    unseen: FloatArray | None = None,
) -> Estimate:
    """The estimate of a system that matches line points. match: of the points to the lines, None without one.

    unseen: covariance (3, 3) of what every image errs by alike; None: nothing.
    """
    covariance = belief.covariance(pose_filter)
    residual_m = float("nan") if match is None else match.mean_distance_m
    return Estimate(
        observation.stamp_ns,
        pose_filter.pose,
        covariance if unseen is None else covariance + unseen,
        belief.told_status,
        residual_m,
        len(observation.points),
        (*hypotheses, *belief.other_end(pose_filter, residual_m)),
        perception_ms=clock.perception_ms,
        localization_ms=clock.localization_ms,
        observation=observation,
        problems=(*belief.doubts, *belief.notes),
    )
