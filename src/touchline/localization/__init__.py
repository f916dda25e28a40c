"""Estimators: matching, global search, Kalman fusion, failure detection, and the pose of one observation."""

from touchline.localization.compass import CompassCorrection, CompassSettings
from touchline.localization.failure import FailureDetector, FailureSettings
from touchline.localization.global_search import OWN_HALF, GlobalFix, GlobalSearch, GlobalSearchSettings, Region
from touchline.localization.locate import LocateSettings, Location, PoorFitError, ScatterError, locate, locate_points
from touchline.localization.matching import Match, Matcher, MatchingSettings
from touchline.localization.tracking import FusionSettings, PoseFilter
from touchline.localization.weights import WeightSettings, precision_weights, range_weights

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
    "PoorFitError",
    "PoseFilter",
    "Region",
    "ScatterError",
    "WeightSettings",
    "locate",
    "locate_points",
    "precision_weights",
    "range_weights",
]
