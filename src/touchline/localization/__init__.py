"""Estimators: matching, global search, Kalman fusion, failure detection, and the pose of one observation."""

from touchline.localization.fusion.compass_correction import CompassCorrection, CompassSettings
from touchline.localization.fusion.failure import FailureDetector, FailureSettings
from touchline.localization.fusion.pose_filter import FusionSettings, PoseFilter
from touchline.localization.matching.global_search import (
    OWN_HALF,
    GlobalFix,
    GlobalSearch,
    GlobalSearchSettings,
    Region,
)
from touchline.localization.matching.matcher import Match, Matcher, MatchingSettings
from touchline.localization.matching.weights import WeightSettings, precision_weights, range_weights
from touchline.localization.one_shot.locate import (
    LocateSettings,
    Location,
    NotSignificantError,
    PoorFitError,
    locate,
    locate_points,
)

__all__ = [
    "OWN_HALF",
    "CompassCorrection",
    "CompassSettings",
    "FailureDetector",
    "FailureSettings",
    "FusionSettings",
    "GlobalFix",
    "GlobalSearch",
    "GlobalSearchSettings",
    "LocateSettings",
    "Location",
    "Match",
    "Matcher",
    "MatchingSettings",
    "NotSignificantError",
    "PoorFitError",
    "PoseFilter",
    "Region",
    "WeightSettings",
    "locate",
    "locate_points",
    "precision_weights",
    "range_weights",
]
