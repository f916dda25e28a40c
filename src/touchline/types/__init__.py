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
    empty_points,
    generic_covariances,
    no_crossings,
    no_landmarks,
    no_lines,
    points_at,
)
from touchline.types.system import (
    Prior,
    System,
    WeightedPose,
    as_prior,
)
