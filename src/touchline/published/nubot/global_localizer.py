"""What a search for a lost robot is given with each frame, and what it has come to."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

from touchline.geometry import FloatArray, Pose, mirrored_covariance
from touchline.published.nubot.matcher import Match
from touchline.types import Hypothesis


class Prediction(NamedTuple):
    """What tracking says of a frame in which the robot is searched for.

    pose and covariance (3, 3): as the odometry has carried them on. lost: the pose was believed until now, so that a
    new search begins. match: the match from the prediction, if there is a pose to start it from.
    """

    pose: Pose
    covariance: FloatArray
    lost: bool
    match: Match | None = None


@dataclass(frozen=True, eq=False, slots=True)
class Localization:
    """What one frame of a search has come to.

    pose and covariance (3, 3): the best guess. match: the points at this pose. confirmed: whether tracking may begin.
    has_pose: whether matching of the next frame may start from it. kept: it is the match from the prediction, to be
    fused with that. hypotheses: other poses that explain the points nearly as well.
    """

    pose: Pose
    covariance: FloatArray
    match: Match
    confirmed: bool
    has_pose: bool
    kept: bool = False
    hypotheses: tuple[Hypothesis, ...] = ()

    def at_other_end(self) -> Localization:
        """The same at the other end of a symmetric field."""
        match = replace(
            self.match, pose=self.match.pose.mirrored(), covariance=mirrored_covariance(self.match.covariance)
        )
        return replace(self, pose=self.pose.mirrored(), covariance=mirrored_covariance(self.covariance), match=match)
