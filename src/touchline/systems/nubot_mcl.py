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

from touchline.geometry import FloatArray, Pose
from touchline.localization.fusion.pose_filter import PoseFilter
from touchline.localization.matching.matcher import Match, as_pose
from touchline.localization.particles.nubot_particles import NubotParticles, NubotParticleSettings
from touchline.systems.matching_tracker import MatchingTracker, TrackerSettings
from touchline.systems.setup import RobotSetup
from touchline.types import Frame, LinePoints, Prior, Status


class NubotMclSettings(TrackerSettings):
    """Everything that the paper fixes, and everything that it leaves open."""

    particles: NubotParticleSettings = NubotParticleSettings()
    followed_by: Literal["matching", "particles"] = Field(
        "matching", description="who follows the robot once the particles have converged; particles: MCL alone"
    )
    accepted_error: float = Field(
        0.1,
        gt=0,
        le=1,
        description="weighted mean error with matching's c, at the match that their mean leads to, below which the "
        "converged particles are believed, as nubot-mti's global search; above it they start anew. 1 believes them "
        "always, as the paper does",
    )
    most_cycles: int = Field(
        15,
        ge=1,
        description="cycles after which particles that have not converged start anew: they converge within 5",
    )
    confirmations: int = Field(
        3,
        ge=1,
        description="times in a row that a new start must come back to a pose until it is believed though it was "
        "not accepted, as nubot-mti's global search: real calibrations may leave more than accepted_error everywhere",
    )
    same_m: float = Field(
        0.5,
        gt=0,
        description="distance (m) within which two poses are the same, the odometry's motion between them taken off: "
        "less than that of two clusters",
    )
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

    def __init__(self, setup: RobotSetup, settings: NubotMclSettings, rng: np.random.Generator) -> None:
        """rng: all chance comes from it."""
        super().__init__(setup, settings)
        self.settings = settings
        self.alone = settings.followed_by == "particles"
        field = setup.field
        self.particles = NubotParticles(
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
        """The odometry carries every particle on, too, while they are in use, and the pose that is to be confirmed."""
        super()._predict(frame)
        if self.motion is None:
            return
        if self.cycles:
            self.particles.predict(self.motion)
        if self.doubtful is not None:
            self.doubtful = self.doubtful.compose(self.motion.pose)

    def _match_from_prediction(self, points: LinePoints, weights: FloatArray, compass_rad: float | None) -> Match:
        """Matching as both papers have it, or one more cycle of the particles."""
        if not self.alone:
            return super()._match_from_prediction(points, weights, compass_rad)
        if not self.cycles:
            self._start(compass_rad, around=True)
        return self._cycle(points, weights, compass_rad)

    def _fuse(self, points: LinePoints, weights: FloatArray, match: Match, compass_rad: float | None) -> None:
        """Kalman fusion; particles have the odometry in them already."""
        if not self.alone:
            super()._fuse(points, weights, match, compass_rad)

    def _failed(self, match: Match | None, points: LinePoints, weights: FloatArray, compass_rad: float | None) -> bool:
        """The paper's five bad cycles, and a better place."""
        if match is not None and self.alone:
            match = self._match_at_mean(points, weights)  # what the place has to offer, as any other place is judged
        failed = super()._failed(match, points, weights, compass_rad)
        if failed and self.settings.keep_unless_better and match is not None:
            stays = self._may_face(self.filter.pose.heading, compass_rad)
            return not stays or self._fits_elsewhere(points, weights, match, compass_rad)
        return failed

    def _match_at_mean(self, points: LinePoints, weights: FloatArray) -> Match:
        """The match that the mean of the particles leads to. It speaks for particles alone only if it is near."""
        positions_m, mean = self.tilt.corrected(points.positions_m), self.particles.estimate().pose
        pose, error, _ = self.matcher.descend(positions_m, weights, mean.as_array())
        if self.alone and mean.distance_to(as_pose(pose)) > self.settings.same_m:
            pose, error = mean.as_array(), self.matcher.error(positions_m, weights, mean.as_array())
        return self.matcher.assess(positions_m, weights, pose, error)

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
        found = self._match_at_mean(points, weights)
        if not self.alone:
            match = found = self._upright(points, weights, found.pose.as_array(), found.error)
            self.filter = PoseFilter(match.pose, match.covariance, self.settings.fusion)
        if found.error < self.settings.accepted_error or self._confirmed(found.pose):
            self.side_known = self._knows_the_side(compass_rad)
            self.placed = True
            self._believe()
            self.cycles = self.cycles if self.alone else 0
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
        mean = self.particles.update(positions_m, weights, corrected)
        self.filter = PoseFilter(mean.pose, mean.covariance, self.settings.fusion)
        pose = mean.pose.as_array()
        return self.matcher.assess(positions_m, weights, pose, self.matcher.error(positions_m, weights, pose))
