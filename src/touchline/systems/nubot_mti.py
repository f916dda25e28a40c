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

from __future__ import annotations

import numpy as np

from touchline.localization.published.nubot.belief import Belief
from touchline.localization.published.nubot.compass_correction import CompassCorrection
from touchline.localization.published.nubot.doubt import Doubt
from touchline.localization.published.nubot.failure import FailureMonitor
from touchline.localization.published.nubot.global_localizer import Prediction
from touchline.localization.published.nubot.global_search import SAMPLE_C_M, GlobalSearch, GlobalSearchSettings
from touchline.localization.published.nubot.grid_localizer import GridLocalizer
from touchline.localization.published.nubot.match_input import MatchInput, MatchInputs
from touchline.localization.published.nubot.matcher import Match, Matcher
from touchline.localization.published.nubot.pose_filter import Fusion
from touchline.localization.published.nubot.tracker import Tracker
from touchline.motion import MotionHistory
from touchline.perception import SelfLearningDetector, observe
from touchline.systems.nubot import NubotSettings, report
from touchline.systems.setup import RobotSetup, system_text
from touchline.systems.stopwatch import Stopwatch
from touchline.types import Estimate, Frame, Hypothesis, Prior, Status, as_prior


class NubotMtiSettings(NubotSettings):
    """Everything that the paper fixes, and everything that it leaves open."""

    global_search: GlobalSearchSettings = GlobalSearchSettings()


class NubotMti:
    """The system as sources and sinks know it: `reset` and `step`."""

    __repr__ = system_text

    def __init__(self, setup: RobotSetup, settings: NubotMtiSettings, rng: np.random.Generator) -> None:
        """rng is not needed: nothing here is left to chance."""
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
        c_m = SAMPLE_C_M if s.global_search.paper.one_c else s.matching.c_m
        matcher = Matcher(field.distance_map(), s.matching.model_copy(update={"c_m": c_m}))
        search = GlobalSearch(matcher, field.length, field.width, s.global_search, field.is_symmetric)
        self.tracker = Tracker(matcher, s.fusion, s.odometry)
        self.failure = FailureMonitor(search, s.failure)
        self.doubt = Doubt(search, s.failure)
        self.localizer = GridLocalizer(search, s.failure.paper.doubts)
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
        self.tracker.predict(motion)  # predict: the odometry carries the pose on (4.2)
        observation = clock.perception(observe, frame, self.detector, self.max_range_m)  # observe: line points (4.1)
        view = self.inputs.of(observation)
        match = self.tracker.match(view)  # match: from the prediction, equation (3)
        rivals: tuple[Hypothesis, ...] = ()
        if self.belief.is_tracking:
            fusion = self.tracker.follow(view, match)  # fuse: Kalman filter; the lines correct the compass (4.2)
            if self._has_failed(view, match, fusion, motion.missing_s):  # judge (4.2)
                self.belief.lose(self.compass_correction.trusted)
                self.compass_correction.lose()
        if view.usable and not self.belief.is_tracking:
            match, rivals = self._localize(view, match)  # search: global localization (4.1)
        return report(observation, self.tracker.filter, self.belief, match, rivals, clock, self.tracker.unseen(view))

    def _has_failed(self, view: MatchInput, match: Match | None, fusion: Fusion, missing_s: float) -> bool:
        """Whether the pose counts as wrong, by the papers' rule or because another place alone fits far better."""
        refuted = self.doubt.refutes(view, match, self.tracker.filter, fusion)
        self.belief.doubts = (*self.doubt.reasons, *self.compass_correction.either_end)
        self.belief.notes = self.compass_correction.doubts
        return self.failure.has_failed(view, match, self.tracker.filter.pose, missing_s) or refuted

    def _localize(self, view: MatchInput, match: Match | None) -> tuple[Match | None, tuple[Hypothesis, ...]]:
        """The best pose of the search, or the tracked one if no other is better; tracked once it is confirmed."""
        lost = self.belief.status is Status.LOST
        prediction = Prediction(self.tracker.filter.pose, self.tracker.filter.covariance, lost, match)
        found = self.localizer.localize(view, prediction, self.belief.region)
        if found is None:
            return None, ()
        other_end = self.compass_correction.is_other_end(found.pose.heading, view.compass_rad)
        if other_end and self.belief.symmetric and not found.kept:
            found = found.at_other_end()
        if found.kept and self.tracker.fuse(view, found.match) is not Fusion.CONTRADICTS:
            self.compass_correction.learn(found.match, view.compass_rad)
        else:
            self.tracker.start_at(found.pose, found.covariance)
        self.belief.take(found, view.heading_rad)
        if found.confirmed:
            self.failure.count_anew()
            self.doubt.reset(held_error=found.match.error if found.kept else 0.0)
            self.compass_correction.start_anew()
        return found.match, found.hypotheses
