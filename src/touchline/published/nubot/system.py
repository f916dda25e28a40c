"""What NuBot's systems share: settings, the parts that follow the robot, and the estimate at the end of a step."""

from typing import Protocol

from touchline.config import Settings
from touchline.field.region import Region
from touchline.geometry import FloatArray
from touchline.localization.registration.weights import WeightSettings
from touchline.motion import CompassTrackSettings, MotionHistory, OdometrySettings
from touchline.perception import LearningSettings, LinePointSettings, SelfLearningDetector
from touchline.published.nubot.belief import Belief
from touchline.published.nubot.compass_correction import CompassCorrection, CompassSettings
from touchline.published.nubot.doubt import Doubt
from touchline.published.nubot.failure import FailureMonitor, FailureSettings
from touchline.published.nubot.global_localizer import Localization, Prediction
from touchline.published.nubot.global_search import GlobalSearch
from touchline.published.nubot.match_input import MatchInput, MatchInputs, MirrorTiltSettings
from touchline.published.nubot.matcher import Match, MatchingSettings
from touchline.published.nubot.pose_filter import Fusion, FusionSettings, PoseFilter
from touchline.published.nubot.tracker import Tracker
from touchline.systems.setup import RobotSetup, open_monitor
from touchline.systems.stopwatch import Stopwatch
from touchline.types import Estimate, Hypothesis, Observation, Prior, Status


class CommonSettings(Settings):
    """What both papers fix of perception, matching and judging, and what they leave open."""

    line_points: LinePointSettings = LinePointSettings()
    learning: LearningSettings = LearningSettings()
    weights: WeightSettings = WeightSettings()
    matching: MatchingSettings = MatchingSettings()
    fusion: FusionSettings = FusionSettings()
    failure: FailureSettings = FailureSettings()
    odometry: OdometrySettings = OdometrySettings()
    compass_track: CompassTrackSettings = CompassTrackSettings()


class NubotSettings(CommonSettings):
    """Those of a system that tracks by matching."""

    mirror_tilt: MirrorTiltSettings = MirrorTiltSettings()
    compass: CompassSettings = CompassSettings()

    @property
    def step_noise(self) -> OdometrySettings:
        """The odometry's noise in a step, without the scale errors that the pose filter finds out by itself."""
        if not self.fusion.paper.learn_odometry_scale:
            return self.odometry
        return self.odometry.model_copy(update={"forward_scale": 0.0, "sideways_scale": 0.0, "turn_scale": 0.0})


class Localizer(Protocol):
    """Finds a lost robot."""

    def localize(self, view: MatchInput, prediction: Prediction, region: Region | None = None) -> Localization | None:
        """What one frame of a search has come to; None: nothing."""
        ...


class Following:
    """The parts of both papers' systems that follow the robot by matching, and say whether it is still there."""

    def __init__(
        self, setup: RobotSetup, settings: NubotSettings, search: GlobalSearch, keep_unless_better: bool = False
    ) -> None:
        """search: of the whole field. keep_unless_better: as of `FailureMonitor`."""
        field, s = setup.field, settings
        self.detector = opened_detector(setup, s)
        self.history = MotionHistory(s.step_noise, s.compass_track)
        self.tilt = s.mirror_tilt.mirror(field, setup.camera)
        self.compass_correction = CompassCorrection(s.compass)
        self.inputs = MatchInputs(self.history, self.tilt, self.compass_correction, s.weights, s.failure.min_points)
        self.tracker = Tracker(search.matcher, s.fusion, s.odometry)
        self.failure = FailureMonitor(search, s.failure, keep_unless_better)
        self.monitor = open_monitor(setup, s.failure.paper.monitor)
        self.doubt = Doubt(search, s.failure)
        self.belief = Belief(field.is_symmetric, s.matching.uncertainty.unknown)

    def reset(self, prior: Prior) -> None:
        """Forget everything but the prior."""
        if self.detector is not None:
            self.detector.reset()
        self.history.clear()
        self.tilt.reset()
        self.compass_correction.reset()
        self.tracker.reset(prior)
        self.doubt.reset()
        self.monitor.reset()
        self.failure.reset(start_pose_unconfirmed=self.tracker.has_pose)
        self.belief.reset(prior)

    def judge(self, view: MatchInput, match: Match | None, fusion: Fusion, missing_s: float) -> None:
        """The pose is lost if it is wrong by the papers' rule, or because another place alone fits far better."""
        refuted = self.doubt.refutes(view, match, self.tracker.filter, fusion)
        self.belief.doubts = (*self.doubt.reasons, *self.compass_correction.either_end)
        self.belief.notes = self.compass_correction.doubts
        if self.failure.has_failed(view, match, self.tracker.filter.pose, missing_s) or refuted:
            self.belief.lose(self.compass_correction.trusted)
            self.compass_correction.lose()

    def search(
        self, localizer: Localizer, view: MatchInput, match: Match | None
    ) -> tuple[Match | None, tuple[Hypothesis, ...]]:
        """One frame of a search, and its other hypotheses. What it finds is tracked once it is confirmed."""
        lost = self.belief.status is Status.LOST
        prediction = Prediction(self.tracker.filter.pose, self.tracker.filter.covariance, lost, match)
        found = localizer.localize(view, prediction, self.belief.region)
        if found is None:
            return None, ()
        other_end = self.compass_correction.is_other_end(found.pose.heading, view.compass_rad)
        if other_end and self.belief.symmetric and not found.kept:
            found = found.at_other_end()
        if found.kept and self.tracker.fuse(view, found.match) is not Fusion.CONTRADICTS:
            self.compass_correction.learn(found.match, view.compass_rad)
        else:
            self.tracker.start_at(found.pose, found.covariance, found.has_pose)
        self.belief.take(found, view.heading_rad)
        if found.confirmed:
            self.failure.count_anew()
            self.doubt.reset(held_error=found.match.error if found.kept else 0.0)
            self.compass_correction.start_anew()
        return found.match, found.hypotheses


def opened_detector(setup: RobotSetup, s: CommonSettings) -> SelfLearningDetector | None:
    """The detector of the papers' systems; None without a camera."""
    if setup.camera is None:
        return None
    return SelfLearningDetector(setup.camera, s.line_points, s.learning, setup.field.line_width)


def report(
    observation: Observation,
    pose_filter: PoseFilter,
    belief: Belief,
    match: Match | None,
    hypotheses: tuple[Hypothesis, ...],
    clock: Stopwatch,
    unseen: FloatArray | None = None,
) -> Estimate:
    """The estimate of a system that matches line points. match: of the points to the lines, None without one.

    unseen: covariance (3, 3) of what every image errs by alike; None: nothing.
    """
    covariance = belief.covariance(pose_filter)
    residual_m = float("nan") if match is None else match.mean_distance_m
    return Estimate(
        observation.stamp_ns,
        pose_filter.pose,
        covariance if unseen is None else covariance + unseen,
        belief.told_status,
        residual_m,
        len(observation.points),
        (*hypotheses, *belief.other_end(pose_filter, residual_m)),
        perception_ms=clock.perception_ms,
        localization_ms=clock.localization_ms,
        observation=observation,
        problems=(*belief.doubts, *belief.notes),
    )
