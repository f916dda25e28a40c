"""What NuBot's systems share: their settings, and the estimate at the end of a step."""

from __future__ import annotations

from touchline.config import Settings
from touchline.geometry import FloatArray
from touchline.localization.published.nubot.belief import Belief
from touchline.localization.published.nubot.compass_correction import CompassSettings
from touchline.localization.published.nubot.failure import FailureSettings
from touchline.localization.published.nubot.match_input import MirrorTiltSettings
from touchline.localization.published.nubot.matcher import Match, MatchingSettings
from touchline.localization.published.nubot.pose_filter import FusionSettings, PoseFilter
from touchline.localization.registration.weights import WeightSettings
from touchline.motion import CompassTrackSettings, OdometrySettings
from touchline.perception import LearningSettings, LinePointSettings
from touchline.systems.stopwatch import Stopwatch
from touchline.types import Estimate, Hypothesis, Observation


class NubotSettings(Settings):
    """What both papers fix of perception, matching and tracking, and what they leave open."""

    line_points: LinePointSettings = LinePointSettings()
    learning: LearningSettings = LearningSettings()
    weights: WeightSettings = WeightSettings()
    matching: MatchingSettings = MatchingSettings()
    mirror_tilt: MirrorTiltSettings = MirrorTiltSettings()
    fusion: FusionSettings = FusionSettings()
    compass: CompassSettings = CompassSettings()
    failure: FailureSettings = FailureSettings()
    odometry: OdometrySettings = OdometrySettings()
    compass_track: CompassTrackSettings = CompassTrackSettings()

    @property
    def step_noise(self) -> OdometrySettings:
        """The odometry's noise in a step, without the scale errors that the pose filter finds out by itself."""
        if not self.fusion.paper.learn_odometry_scale:
            return self.odometry
        return self.odometry.model_copy(update={"forward_scale": 0.0, "sideways_scale": 0.0, "turn_scale": 0.0})


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
