"""nubot-mcl-alone: Monte Carlo localization all the time, without matching, to compare nubot-mcl with.

H. Lu, X. Li, H. Zhang, M. Hu, Z. Zheng: Robust and real-time self-localization based on omnidirectional vision for
soccer robots, Advanced Robotics 2013, section 4.

    image ─▶ line points ─▶ Monte Carlo localization ─▶ mean of the particles ─▶ estimate
                               compass ─┘   └─ odometry        │
                                     ▲                         │
                                     └─ five bad frames in a row
"""

import numpy as np

from touchline.geometry import Pose
from touchline.localization.registration.learned_mirror import LearnedMirror
from touchline.motion import MotionHistory
from touchline.perception import observe
from touchline.published.nubot.belief import Belief
from touchline.published.nubot.compass_correction import CompassCorrection
from touchline.published.nubot.failure import FailureMonitor
from touchline.published.nubot.global_localizer import Localization, Prediction
from touchline.published.nubot.global_search import GlobalSearch
from touchline.published.nubot.match_input import MatchInput, MatchInputs
from touchline.published.nubot.matcher import Match, Matcher
from touchline.published.nubot.pose_filter import PoseFilter
from touchline.published.nubot.system import CommonSettings, opened_detector, report
from touchline.published.nubot_mcl.particle_localizer import (
    ParticleFollower,
    ParticleSearch,
    ParticleSearchSettings,
)
from touchline.published.nubot_mcl.particles import NubotParticles
from touchline.systems.info import SystemInfo
from touchline.systems.setup import RobotSetup, open_monitor, system_text
from touchline.systems.stopwatch import Stopwatch
from touchline.types import Estimate, Frame, Prior, Status, as_prior


class NubotMclAloneSettings(ParticleSearchSettings, CommonSettings):
    """Those of nubot-mcl without tracking; matching only judges what the particles have come to."""


class NubotMclAlone:
    """The system as sources and sinks know it: `reset` and `step`."""

    __repr__ = system_text

    def __init__(self, setup: RobotSetup, settings: NubotMclAloneSettings, rng: np.random.Generator) -> None:
        """rng: all chance comes from it."""
        field, s = setup.field, settings
        self.setup, self.settings, self.max_range_m = setup, settings, setup.max_range_m
        self.detector = opened_detector(setup, s)
        self.history = MotionHistory(s.odometry, s.compass_track)
        matcher = Matcher(field.distance_map(), s.matching)
        whole_field = GlobalSearch(matcher, field.length, field.width)
        self.failure = FailureMonitor(whole_field, s.failure, s.paper.keep_unless_better)
        self.monitor = open_monitor(setup, s.failure.paper.monitor)
        self.particles = NubotParticles(
            matcher, field.length, field.width, rng, s.particles, symmetric=field.is_symmetric
        )
        self.follower = ParticleFollower(ParticleSearch(self.particles, s))
        self.belief = Belief(field.is_symmetric, s.matching.uncertainty.unknown)
        mirror = LearnedMirror(field, enabled=False)
        # Only matches show errors of mirror and compass, and there are none here: both are taken as they are.
        self.inputs = MatchInputs(self.history, mirror, CompassCorrection(), s.weights, s.failure.min_points)
        self.reset()

    def reset(self, prior: Prior | None = None) -> None:
        """Forget everything but the prior."""
        prior = as_prior(prior)
        if self.detector is not None:
            self.detector.reset()
        self.history.clear()
        self.filter = PoseFilter(prior.pose or Pose(0.0, 0.0, 0.0), prior.covariance, self.settings.fusion)
        self.has_pose = prior.pose is not None
        self.failure.reset(start_pose_unconfirmed=self.has_pose)
        self.monitor.reset()
        self.follower.search.reset()
        self.belief.reset(prior)

    def step(self, frame: Frame) -> Estimate:
        """Take one frame, return where the robot stands at its time stamp."""
        clock = Stopwatch()
        motion = self.history.take(frame)
        self.filter.predict(motion.pose, motion.covariance)  # predict: the odometry stands in where nothing is seen
        self.follower.search.predict(motion)  # and moves the particles, by the motion model
        observation = clock.perception(observe, frame, self.detector, self.max_range_m)  # observe: line points
        view = self.inputs.of(observation)
        match = self._follow(view)  # weigh and resample the particles, equations (1) to (3)
        if self.belief.is_tracking:
            nearby = None if match is None else self.follower.match_nearby(view, self.filter.pose)
            if self.failure.has_failed(view, nearby, self.filter.pose, motion.missing_s):  # judge: five cycles
                self.belief.lose()
        if view.usable and not self.belief.is_tracking:
            match = self._localize(view)  # search: the same over the whole field
        estimate = report(observation, self.filter, self.belief, match, (), clock)
        return self.monitor.judged(estimate, frame, self.history)  # ours: does anything contradict the pose?

    def _follow(self, view: MatchInput) -> Match | None:
        """One more cycle about the pose; None without a pose, or without usable points."""
        if not (self.has_pose and view.usable):
            return None
        return self._take(self.follower.follow(view, self._prediction(), self.belief.region))

    def _localize(self, view: MatchInput) -> Match:
        """One cycle of the search."""
        found = self.follower.localize(view, self._prediction(), self.belief.region)
        self.belief.take(found, view.compass_rad)
        if found.confirmed:
            self.failure.count_anew()
        return self._take(found)

    def _prediction(self) -> Prediction:
        return Prediction(self.filter.pose, self.filter.covariance, self.belief.status is Status.LOST)

    def _take(self, found: Localization) -> Match:
        """The mean of the particles is the pose."""
        self.filter = PoseFilter(found.pose, found.covariance, self.settings.fusion)
        self.has_pose = found.has_pose
        return found.match


NUBOT_MCL_ALONE = SystemInfo(
    "nubot-mcl-alone",
    "600 particles find the robot and follow it without matching, to compare nubot-mcl with",
    NubotMclAloneSettings,
    NubotMclAlone,
)
