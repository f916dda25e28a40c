"""What every way to find a lost robot has in common: asked with each frame until its pose is confirmed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

from touchline.field.region import Region
from touchline.geometry import FloatArray, Pose, mirrored_covariance
from touchline.localization.published.nubot.match_input import MatchInput
from touchline.localization.published.nubot.matcher import Match
from touchline.motion import Motion
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


class GlobalLocalizer(Protocol):
    """Finds the robot on the whole field, one frame after the other."""

    def reset(self) -> None:
        """Forget everything."""
        ...

    def predict(self, motion: Motion) -> None:
        """The robot has moved since the last frame."""
        ...

    def localize(self, view: MatchInput, prediction: Prediction, region: Region | None = None) -> Localization | None:
        """Search with one frame; None if nothing fits. region: where the robot is known to be."""
        ...
