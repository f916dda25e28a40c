"""nubot-mti: omnidirectional vision and compass.

D. Xiong, H. Lu, Z. Zheng: A self-localization method based on omnidirectional vision and MTi for soccer robots.

    image ─▶ line points ─┬─▶ global localization (4.1) ─▶ pose
                          │      compass ─┘                 │
                          └─▶ matching from the prediction ◀┴─ odometry
                                 │
                                 ├─▶ Kalman fusion ─▶ estimate
                                 ├─▶ compass correction
                                 └─▶ failure detection ─▶ global localization again (4.2)
"""

import numpy as np

from touchline.perception import observe
from touchline.published.nubot.global_search import SAMPLE_C_M, GlobalSearch, GlobalSearchSettings
from touchline.published.nubot.matcher import Matcher
from touchline.published.nubot.system import Following, NubotSettings, report
from touchline.published.nubot_mti.grid_localizer import GridLocalizer
from touchline.systems.info import SystemInfo
from touchline.systems.setup import RobotSetup, system_text
from touchline.systems.stopwatch import Stopwatch
from touchline.types import Estimate, Frame, Hypothesis, Prior, as_prior


class NubotMtiSettings(NubotSettings):
    """Everything that the paper fixes, and everything that it leaves open."""

    global_search: GlobalSearchSettings = GlobalSearchSettings()


class NubotMti:
    """The system as sources and sinks know it: `reset` and `step`."""

    __repr__ = system_text

    def __init__(self, setup: RobotSetup, settings: NubotMtiSettings, rng: np.random.Generator) -> None:
        """rng is not needed: nothing here is left to chance."""
        field, s = setup.field, settings
        self.setup, self.settings, self.max_range_m = setup, settings, setup.max_range_m
        c_m = SAMPLE_C_M if s.global_search.paper.one_c else s.matching.c_m
        matcher = Matcher(field.distance_map(), s.matching.model_copy(update={"c_m": c_m}))
        search = GlobalSearch(matcher, field.length, field.width, s.global_search, field.is_symmetric)
        self.following = Following(setup, s, search)
        self.detector, self.history = self.following.detector, self.following.history
        self.localizer = GridLocalizer(search, s.failure.paper.doubts)
        self.reset()

    def reset(self, prior: Prior | None = None) -> None:
        """Forget everything but the prior."""
        self.following.reset(as_prior(prior))
        self.localizer.reset()

    def step(self, frame: Frame) -> Estimate:
        """Take one frame, return where the robot stands at its time stamp."""
        clock, tracker, belief = Stopwatch(), self.following.tracker, self.following.belief
        motion = self.history.take(frame)
        tracker.predict(motion)  # predict: the odometry carries the pose on (4.2)
        observation = clock.perception(observe, frame, self.detector, self.max_range_m)  # observe: line points (4.1)
        view = self.following.inputs.of(observation)
        match = tracker.match(view)  # match: from the prediction, equation (3)
        rivals: tuple[Hypothesis, ...] = ()
        if belief.is_tracking:
            fusion = tracker.follow(view, match)  # fuse: Kalman filter; the lines correct the compass (4.2)
            self.following.judge(view, match, fusion, motion.missing_s)  # judge (4.2)
        if view.usable and not belief.is_tracking:
            match, rivals = self.following.search(self.localizer, view, match)  # search: global localization (4.1)
        estimate = report(observation, tracker.filter, belief, match, rivals, clock, tracker.unseen(view))
        return self.following.monitor.judged(estimate, frame, self.history)  # ours: does anything contradict the pose?


NUBOT_MTI = SystemInfo(
    "nubot-mti",
    "compass heading, 315 grid samples, RPROP matching, Kalman fusion with odometry (Xiong et al.)",
    NubotMtiSettings,
    NubotMti,
)
