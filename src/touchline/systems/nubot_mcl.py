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

import numpy as np

from touchline.localization.published.nubot.belief import Belief
from touchline.localization.published.nubot.compass_correction import CompassCorrection
from touchline.localization.published.nubot.doubt import Doubt
from touchline.localization.published.nubot.failure import FailureMonitor
from touchline.localization.published.nubot.global_localizer import Prediction
from touchline.localization.published.nubot.global_search import GlobalSearch
from touchline.localization.published.nubot.match_input import MatchInput, MatchInputs
from touchline.localization.published.nubot.matcher import Match, Matcher
from touchline.localization.published.nubot.particle_localizer import (
    ParticleLocalizer,
    ParticleSearch,
    ParticleSearchSettings,
)
from touchline.localization.published.nubot.particles import NubotParticles
from touchline.localization.published.nubot.pose_filter import Fusion
from touchline.localization.published.nubot.tracker import Tracker
from touchline.motion import MotionHistory
from touchline.perception import SelfLearningDetector, observe
from touchline.systems.nubot import NubotSettings, report
from touchline.systems.setup import RobotSetup, system_text
from touchline.systems.stopwatch import Stopwatch
from touchline.types import Estimate, Frame, Prior, Status, as_prior


class NubotMclSettings(ParticleSearchSettings, NubotSettings):
    """Everything that the paper fixes, and everything that it leaves open."""


class NubotMcl:
    """The system as sources and sinks know it: `reset` and `step`."""

    __repr__ = system_text

    def __init__(self, setup: RobotSetup, settings: NubotMclSettings, rng: np.random.Generator) -> None:
        """rng: all chance comes from it."""
        field, camera, s = setup.field, setup.camera, settings
        self.setup = setup
        self.settings = settings
        self.detector = (
            None if camera is None else SelfLearningDetector(camera, s.line_points, s.learning, field.line_width)
        )
        self.max_range_m = setup.max_range_m
        self.history = MotionHistory(s.step_noise, s.compass_track)
        self.tilt = s.mirror_tilt.mirror(field, camera)
        self.compass_correction = CompassCorrection(s.compass)
        self.inputs = MatchInputs(self.history, self.tilt, self.compass_correction, s.weights, s.failure.min_points)
        matcher = Matcher(field.distance_map(), s.matching)
        self.tracker = Tracker(matcher, s.fusion, s.odometry)
        whole_field = GlobalSearch(matcher, field.length, field.width, symmetric=field.is_symmetric)
        self.failure = FailureMonitor(whole_field, s.failure, s.paper.keep_unless_better)
        self.doubt = Doubt(whole_field, s.failure)
        self.particles = NubotParticles(
            matcher, field.length, field.width, rng, s.particles, symmetric=field.is_symmetric
        )
        self.localizer = ParticleLocalizer(
            ParticleSearch(self.particles, s), whole_field if s.failure.paper.doubts else None
        )
        self.belief = Belief(field.is_symmetric, s.matching.uncertainty.unknown)
        self.reset()

    def reset(self, prior: Prior | None = None) -> None:
        """Forget everything but the prior."""
        prior = as_prior(prior)
        if self.detector is not None:
            self.detector.reset()
        self.history.clear()
        self.tilt.reset()
        self.compass_correction.reset()
        self.tracker.reset(prior)
        self.doubt.reset()
        self.failure.reset(start_pose_unconfirmed=self.tracker.has_pose)
        self.localizer.reset()
        self.belief.reset(prior)

    def step(self, frame: Frame) -> Estimate:
        """Take one frame, return where the robot stands at its time stamp."""
        clock = Stopwatch()
        motion = self.history.take(frame)
        self.tracker.predict(motion)  # predict: the odometry carries the pose on, section 4
        self.localizer.predict(motion)  # and the particles, by the motion model
        observation = clock.perception(observe, frame, self.detector, self.max_range_m)  # observe: line points
        view = self.inputs.of(observation)
        match = self.tracker.match(view)  # match: from the prediction
        if self.belief.is_tracking:
            fusion = self.tracker.follow(view, match)  # fuse: Kalman filter; the compass is corrected by the lines
            if self._has_failed(view, match, fusion, motion.missing_s):  # judge: five cycles
                self.belief.lose(self.compass_correction.trusted)
                self.compass_correction.lose()
        if view.usable and not self.belief.is_tracking:
            match = self._localize(view, match)  # search: one cycle of the particles, equations (1) to (3)
        return report(observation, self.tracker.filter, self.belief, match, (), clock, self.tracker.unseen(view))

    def _has_failed(self, view: MatchInput, match: Match | None, fusion: Fusion, missing_s: float) -> bool:
        """Whether the pose counts as wrong, by the papers' rule or because another place alone fits far better."""
        refuted = self.doubt.refutes(view, match, self.tracker.filter, fusion)
        self.belief.doubts = (*self.doubt.reasons, *self.compass_correction.either_end)
        self.belief.notes = self.compass_correction.doubts
        return self.failure.has_failed(view, match, self.tracker.filter.pose, missing_s) or refuted

    def _localize(self, view: MatchInput, match: Match | None) -> Match:
        """The particles' mean; once they have converged, the match that it leads to. Tracking starts if that fits."""
        lost = self.belief.status is Status.LOST
        prediction = Prediction(self.tracker.filter.pose, self.tracker.filter.covariance, lost, match)
        found = self.localizer.localize(view, prediction, self.belief.region)
        other_end = self.compass_correction.is_other_end(found.pose.heading, view.compass_rad)
        if other_end and self.belief.symmetric:
            found = found.at_other_end()
        self.tracker.start_at(found.pose, found.covariance, found.has_pose)
        self.belief.take(found, view.heading_rad)
        if found.confirmed:
            self.failure.count_anew()
            self.doubt.reset()
            self.compass_correction.start_anew()
        return found.match
