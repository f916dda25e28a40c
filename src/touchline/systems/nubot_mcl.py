"""nubot-mcl: particles to find the robot, matching to follow it.

H. Lu, X. Li, H. Zhang, M. Hu, Z. Zheng: Robust and real-time self-localization based on omnidirectional vision for
soccer robots, Advanced Robotics 2013, figure 3.

    image ─▶ line points ─┬─▶ Monte Carlo localization ─▶ converged? ─▶ pose
                          │      compass ─┘   └─ odometry                │
                          └─▶ matching from the prediction ◀─ odometry ◀─┘
                                 ├─▶ Kalman fusion ─▶ estimate
                                 └─▶ five bad frames in a row ─▶ Monte Carlo localization again
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from touchline.camera import OmniCamera
from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose
from touchline.localization.matching import Match
from touchline.localization.particles import MonteCarlo, MonteCarloSettings
from touchline.localization.tracking import PoseFilter
from touchline.systems.matching_tracker import MatchingTracker, TrackerSettings
from touchline.types import Frame, LinePoints, Prior, Status


class NubotMclSettings(TrackerSettings):
    """Everything that the paper fixes, and everything that it leaves open."""

    particles: MonteCarloSettings = MonteCarloSettings()
    followed_by: Literal["matching", "particles"] = Field(
        "matching", description="who follows the robot once the particles have converged; particles: MCL alone"
    )
    accepted_error: float = Field(
        0.1,
        gt=0,
        le=1,
        description="weighted mean error with matching's c below which the converged particles are believed, as "
        "nubot-mti's global search; above it they start anew. 1 believes them always, as the paper does",
    )
    most_cycles: int = Field(
        15,
        ge=1,
        description="cycles after which particles that have not converged start anew: they converge within 5",
    )
    confirmations: int = Field(
        3,
        ge=1,
        description="starts in a row after which the same pose is believed though it was not accepted, as nubot-mti's "
        "global search: real calibrations may leave more than accepted_error everywhere",
    )
    same_m: float = Field(0.5, gt=0, description="distance (m) within which that is the same pose: a frame's travel")
    keep_unless_better: bool = Field(
        True,
        description="start the particles after bad frames only if some other place explains the points far better: "
        "near a goal that hidden sectors cut in two, clutter makes frames bad at the right pose, too. The paper starts "
        "them in any case",
    )
    widening: float = Field(
        2.0,
        ge=1,
        description="factor by which every new start widens the first headings about the compass, which may err by "
        "more than thought; 1 as in the paper",
    )


class NubotMcl(MatchingTracker):
    """The system as sources and sinks know it: `reset` and `step`."""

    def __init__(
        self, field: FieldModel, camera: OmniCamera | None, settings: NubotMclSettings, rng: np.random.Generator
    ) -> None:
        """camera: None if frames bring their points. rng: all chance comes from it."""
        super().__init__(field, camera, settings)
        self.settings = settings
        self.particles = MonteCarlo(
            self.matcher, field.length, field.width, rng, settings.particles, symmetric=field.is_symmetric
        )
        self.reset()

    def reset(self, prior: Prior | None = None) -> None:
        """Forget everything but the prior."""
        super().reset(prior)
        self.cycles = 0
        self.starts = 0
        self.doubtful: Pose | None = None
        self.confirmations = 0

    def _predict(self, frame: Frame) -> None:
        """The odometry carries every particle on, too, while they are in use."""
        super()._predict(frame)
        if self.cycles and self.motion is not None:
            self.particles.move(self.motion)

    def _match_from_prediction(self, points: LinePoints, weights: FloatArray, compass_rad: float | None) -> Match:
        """Matching as both papers have it, or one more cycle of the particles."""
        if self.settings.followed_by == "matching":
            return super()._match_from_prediction(points, weights, compass_rad)
        if not self.cycles:
            self._start(compass_rad, around=True)
        return self._cycle(points, weights, compass_rad)

    def _fuse(self, points: LinePoints, weights: FloatArray, match: Match, compass_rad: float | None) -> None:
        """Kalman fusion; particles have the odometry in them already."""
        if self.settings.followed_by == "matching":
            super()._fuse(points, weights, match, compass_rad)

    def _failed(self, match: Match | None, points: LinePoints, weights: FloatArray, compass_rad: float | None) -> bool:
        """The paper's five bad cycles, and a better place."""
        failed = super()._failed(match, points, weights, compass_rad)
        keeps = self.settings.keep_unless_better and self.settings.followed_by == "matching"
        if failed and keeps and match is not None and self._may_face(self.filter.pose.heading, compass_rad):
            return self._fits_elsewhere(points, weights, match, compass_rad)
        return failed

    def _localize(
        self, points: LinePoints, weights: FloatArray, compass_rad: float | None, held: Match | None
    ) -> Match | None:
        """One cycle of Monte Carlo localization; tracking starts once the particles agree on a pose that fits."""
        if self.status is Status.LOST or not self.cycles:
            self.starts = self.confirmations = 0
            self.doubtful = None
            self._start(compass_rad)
        elif self.cycles >= self.settings.most_cycles:
            self._start(compass_rad)
        self.status, self.placed = Status.SEARCHING, False
        match = self._cycle(points, weights, compass_rad)
        if not self.particles.converged:
            return match
        alone = self.settings.followed_by == "particles"
        if not alone:
            positions_m = self.tilt.corrected(points.positions_m)
            pose, error, _ = self.matcher.descend(positions_m, weights, self.particles.pose.as_array())
            match = self._upright(points, weights, pose, error)
            self.filter = PoseFilter(match.pose, match.covariance, self.settings.fusion)
        if alone or match.error < self.settings.accepted_error or self._confirmed(match.pose):
            self.side_known = self._knows_the_side(compass_rad)
            self.placed = True
            self._believe()
            self.cycles = self.cycles if alone else 0
        else:
            self.cycles = self.settings.most_cycles  # a wrong end: start anew with the next frame
        return match

    def _confirmed(self, pose: Pose) -> bool:
        """Whether the particles have come to the same doubtful pose several times in a row."""
        same = self.doubtful is not None and pose.distance_to(self.doubtful) < self.settings.same_m
        self.confirmations = self.confirmations + 1 if same else 0
        self.doubtful = pose
        return self.confirmations >= self.settings.confirmations

    def _start(self, compass_rad: float | None, around: bool = False) -> None:
        """Spread the particles; around: a pose that was told, else over the field."""
        corrected = None if compass_rad is None else self.correction.heading(compass_rad)
        known = around or self.status is Status.LOST or self.starts > 0
        known = known and self._may_face(self.filter.pose.heading, compass_rad)
        near = (self.filter.pose, self.filter.covariance) if known else None
        widening = self.settings.widening**self.starts
        self.particles.restart(corrected, self.region, near, widening=widening, everything_near=around)
        self.cycles = 0
        self.starts += 1

    def _cycle(self, points: LinePoints, weights: FloatArray, compass_rad: float | None) -> Match:
        """Weights, mean, resampling; the particles were moved by the odometry before. The mean is the estimate."""
        self.cycles += 1
        positions_m = self.tilt.corrected(points.positions_m)
        corrected = None if compass_rad is None else self.correction.heading(compass_rad)
        pose = self.particles.cycle(None, positions_m, weights, corrected)
        self.filter = PoseFilter(pose, self.particles.covariance, self.settings.fusion)
        error = self.matcher.error(positions_m, weights, pose.as_array())
        return self.matcher.assess(positions_m, weights, pose.as_array(), error)
