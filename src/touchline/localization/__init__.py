"""Estimators: matching, global search, Kalman fusion, failure detection, and the pose of one observation."""

from touchline.localization.one_shot.locate import (
    LocateSettings,
    Location,
    NotSignificantError,
    PoorFitError,
    locate,
    locate_points,
)
from touchline.localization.published.nubot.compass_correction import CompassCorrection, CompassSettings
from touchline.localization.published.nubot.failure import FailureDetector, FailureSettings
from touchline.localization.published.nubot.global_search import (
    OWN_HALF,
    GlobalFix,
    GlobalSearch,
    GlobalSearchSettings,
    Region,
)
from touchline.localization.published.nubot.matcher import Match, Matcher, MatchingSettings
from touchline.localization.published.nubot.pose_filter import FusionSettings, PoseFilter
from touchline.localization.published.nubot.weights import WeightSettings, precision_weights, range_weights

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
