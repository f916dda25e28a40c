"""The settings that NuBot's systems share: line points, matching, failure, odometry and compass."""

from __future__ import annotations

from pydantic import Field

from touchline.config import Settings
from touchline.localization.fusion.compass_correction import CompassSettings
from touchline.localization.fusion.failure import FailureSettings
from touchline.localization.fusion.pose_filter import FusionSettings
from touchline.localization.matching.matcher import MatchingSettings
from touchline.localization.matching.mirror_tilt import MirrorTiltSettings
from touchline.localization.matching.weights import WeightSettings
from touchline.motion import CompassTrackSettings, OdometrySettings
from touchline.perception import LearningSettings, LinePointSettings


class MapSettings(Settings):
    """The table of distances to the lines."""

    resolution_m: float = Field(0.025, gt=0, description="distance of its samples (m)")
    margin_m: float = Field(3.0, gt=0, description="how far it reaches beyond the lines (m)")


class NubotSettings(Settings):
    """What both papers fix of perception, matching and tracking, and what they leave open."""

    line_points: LinePointSettings = LinePointSettings()
    learning: LearningSettings = LearningSettings()
    map: MapSettings = MapSettings()
    weights: WeightSettings = WeightSettings()
    matching: MatchingSettings = MatchingSettings()
    mirror_tilt: MirrorTiltSettings = MirrorTiltSettings()
    fusion: FusionSettings = FusionSettings()
    compass: CompassSettings = CompassSettings()
    failure: FailureSettings = FailureSettings()
    odometry: OdometrySettings = OdometrySettings()
    compass_track: CompassTrackSettings = CompassTrackSettings()
