"""The settings that NuBot's systems share: line points, matching, failure, odometry and compass."""

from __future__ import annotations

from touchline.config import Settings
from touchline.localization.published.nubot.compass_correction import CompassSettings
from touchline.localization.published.nubot.failure import FailureSettings
from touchline.localization.published.nubot.match_input import MirrorTiltSettings
from touchline.localization.published.nubot.matcher import MatchingSettings
from touchline.localization.published.nubot.pose_filter import FusionSettings
from touchline.localization.published.nubot.weights import WeightSettings
from touchline.motion import CompassTrackSettings, OdometrySettings
from touchline.perception import LearningSettings, LinePointSettings


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
