"""The three values that flow through Touchline: Frame, Observation, Estimate; and what they are made of."""

from touchline.types.estimate import (
    Estimate,
    Hypothesis,
    Look,
    Mode,
    OdometryScales,
    Status,
)
from touchline.types.frame import (
    MAX_VALUE,
    Evidence,
    Frame,
    ImageArray,
    Samples,
)
from touchline.types.game import GameState
from touchline.types.problem import Problem, ProblemCode
from touchline.types.seen import (
    MAX_OBSERVED_POINTS,
    Colors,
    CrossingKind,
    Crossings,
    KindArray,
    LandmarkKind,
    Landmarks,
    LinePoints,
    Lines,
    Observation,
    check_point_count,
    generic_covariances,
    points_at,
)
from touchline.types.system import (
    Prior,
    System,
    WeightedPose,
    as_prior,
)

__all__ = [
    "MAX_OBSERVED_POINTS",
    "MAX_VALUE",
    "Colors",
    "CrossingKind",
    "Crossings",
    "Estimate",
    "Evidence",
    "Frame",
    "GameState",
    "Hypothesis",
    "ImageArray",
    "KindArray",
    "LandmarkKind",
    "Landmarks",
    "LinePoints",
    "Lines",
    "Look",
    "Mode",
    "Observation",
    "OdometryScales",
    "Prior",
    "Problem",
    "ProblemCode",
    "Samples",
    "Status",
    "System",
    "WeightedPose",
    "as_prior",
    "check_point_count",
    "generic_covariances",
    "points_at",
]
