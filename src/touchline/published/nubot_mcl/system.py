"""nubot-mcl: particles to find the robot, matching to follow it.

H. Lu, X. Li, H. Zhang, M. Hu, Z. Zheng: Robust and real-time self-localization based on omnidirectional vision for
soccer robots, Advanced Robotics 2013, figure 3.

    image ─▶ line points ─┬─▶ Monte Carlo localization ─▶ converged? ─▶ pose
                          │      compass ─┘   └─ odometry                │
                          └─▶ matching from the prediction ◀─ odometry ◀─┘
                                 ├─▶ Kalman fusion ─▶ estimate
                                 └─▶ five bad frames in a row ─▶ Monte Carlo localization again
"""

import numpy as np

from touchline.perception import observe
from touchline.published.nubot.global_search import GlobalSearch
from touchline.published.nubot.matcher import Matcher
from touchline.published.nubot.system import Following, NubotSettings, report
from touchline.published.nubot_mcl.particle_localizer import (
    ParticleLocalizer,
    ParticleSearch,
    ParticleSearchSettings,
)
from touchline.published.nubot_mcl.particles import NubotParticles
from touchline.systems.info import SystemInfo
from touchline.systems.setup import RobotSetup, system_text
from touchline.systems.stopwatch import Stopwatch
from touchline.types import Estimate, Frame, Prior, as_prior


class NubotMclSettings(ParticleSearchSettings, NubotSettings):
    """Everything that the paper fixes, and everything that it leaves open."""


class NubotMcl:
    """The system as sources and sinks know it: `reset` and `step`."""

    __repr__ = system_text

    def __init__(self, setup: RobotSetup, settings: NubotMclSettings, rng: np.random.Generator) -> None:
        """rng: all chance comes from it."""
        field, s = setup.field, settings
        self.setup, self.settings, self.max_range_m = setup, settings, setup.max_range_m
        matcher = Matcher(field.distance_map(), s.matching)
        whole_field = GlobalSearch(matcher, field.length, field.width, symmetric=field.is_symmetric)
        self.following = Following(setup, s, whole_field, s.paper.keep_unless_better)
        self.detector, self.history = self.following.detector, self.following.history
        self.particles = NubotParticles(
            matcher, field.length, field.width, rng, s.particles, symmetric=field.is_symmetric
        )
        self.localizer = ParticleLocalizer(
            ParticleSearch(self.particles, s), whole_field if s.failure.paper.doubts else None
        )
        self.reset()

    def reset(self, prior: Prior | None = None) -> None:
        """Forget everything but the prior."""
        self.following.reset(as_prior(prior))
        self.localizer.reset()

    def step(self, frame: Frame) -> Estimate:
        """Take one frame, return where the robot stands at its time stamp."""
        clock, tracker, belief = Stopwatch(), self.following.tracker, self.following.belief
        motion = self.history.take(frame)
        tracker.predict(motion)  # predict: the odometry carries the pose on, section 4
        self.localizer.search.predict(motion)  # and the particles, by the motion model
        observation = clock.perception(observe, frame, self.detector, self.max_range_m)  # observe: line points
        view = self.following.inputs.of(observation)
        match = tracker.match(view)  # match: from the prediction
        if belief.is_tracking:
            fusion = tracker.follow(view, match)  # fuse: Kalman filter; the compass is corrected by the lines
            self.following.judge(view, match, fusion, motion.missing_s)  # judge: five cycles
        if view.usable and not belief.is_tracking:
            match, _ = self.following.search(self.localizer, view, match)  # search: a cycle of particles, (1) to (3)
        estimate = report(observation, tracker.filter, belief, match, (), clock, tracker.unseen(view))
        return self.following.monitor.judged(estimate, frame, self.history)  # ours: does anything contradict the pose?


NUBOT_MCL = SystemInfo(
    "nubot-mcl",
    "600 particles find the robot; RPROP matching, Kalman fusion with odometry follow it (Lu et al. 2013)",
    NubotMclSettings,
    NubotMcl,
)
