"""The last line of a step: the estimate, and the time that it took."""

from __future__ import annotations

from touchline.geometry import FloatArray
from touchline.localization.published.nubot.belief import Belief
from touchline.localization.published.nubot.matcher import Match
from touchline.localization.published.nubot.pose_filter import PoseFilter
from touchline.systems.stopwatch import Stopwatch
from touchline.types import Estimate, Hypothesis, Observation


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
