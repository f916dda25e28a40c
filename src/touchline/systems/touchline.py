"""touchline: our own system, line points at the statistical bound; no paper's.

image ─▶ line points ─▶ registration from every hypothesis ─▶ filters, weights ─▶ the best ─▶ estimate
              │                      ▲ odometry                   │                 ▲
              └─▶ search of the whole field ─▶ new hypotheses ◀───┘ undecided       └─ compass: which end
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from pydantic import Field

from touchline.config import Settings
from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.localization.camera_errors.mirror_head import MirrorHead
from touchline.localization.estimator.compass_witness import CompassPulse
from touchline.localization.estimator.end_odds import EndOdds
from touchline.localization.estimator.exact_mirror import ExactMirror
from touchline.localization.estimator.image_delay import UNKNOWN_S, ImageDelay
from touchline.localization.estimator.joint_filter import JointFilter, Unknown
from touchline.localization.estimator.pose_hypotheses import Member, PoseHypotheses, is_shove
from touchline.localization.registration.covariance import is_observed
from touchline.localization.registration.registration import Registration
from touchline.localization.search.pose_search import Known, Mode, PoseSearch, contradiction
from touchline.motion import CompassTrackSettings, MotionHistory, OdometrySettings
from touchline.motion.delayed import Delayed, delayed, until_stamp
from touchline.motion.driven import Scales
from touchline.perception import LearningSettings, LinePointSettings, SelfLearningDetector, observe
from touchline.systems.setup import RobotSetup, system_text
from touchline.systems.stopwatch import Stopwatch
from touchline.types import Estimate, Frame, Hypothesis, Observation, Prior, Status, as_prior

WIDE = 0.6  # standard deviation (m, rad) of a told pose from which it is a zone: registration reaches no farther
CLEARLY = 2.0  # logarithm of the odds of one end from which a zone decides it
SAID_OFTEN = 10.0  # images over which what others say repeats itself
WATCHED_PARTS = 3  # of the headings: a third of them, in a third of the images, delays none by a whole search
LEARNED = 0.3  # of what an image says of the camera's errors: points of neighbouring images err together
HOPELESS = 40.0  # logarithm of odds of the points against the pose that is followed from which another is not tried
UNKNOWN = np.diag(np.square([10.0, 10.0, 3.0]))  # covariance of a pose that may be anywhere


class TouchlineSettings(Settings):
    """The few things that somebody would tune; all else are constants beside their use."""

    min_points: int = Field(10, ge=1, le=10_000, description="line points without which an image tells nothing")
    min_explained: float = Field(
        0.6, gt=0, lt=1, description="share of the points that a pose must explain, or the whole field is searched"
    )
    min_probability: float = Field(
        0.9, gt=0.5, lt=1, description="probability from which the likeliest pose is tracked, twin not counted"
    )
    blind_frames: int = Field(
        2, ge=1, le=1_000, description="images in a row without points after which the pose is in doubt"
    )
    search_every: int = Field(
        15,
        ge=1,
        le=1_000,
        description="images in which the whole field is searched once, in parts, though nothing is wrong",
    )
    compass_sigma_rad: float = Field(
        0.15, gt=0, description="standard deviation of a compass heading (rad), drift and magnetic fields included"
    )
    gate: float = Field(
        16.3, gt=0, description="squared Mahalanobis distance from the prediction from which the robot was shoved"
    )
    start_position_m: float = Field(0.3, gt=0, description="standard deviation of x and y of a pose that is told (m)")
    start_heading_rad: float = Field(0.15, gt=0, description="standard deviation of a heading that is told (rad)")
    self_calibration: bool = Field(
        True,
        description="learn from the lines what a camera differs by from its camera.yaml: a mirror's tilt, centre and "
        "ranges, a perspective camera's roll, pitch, height and focal length",
    )
    odometry: OdometrySettings = OdometrySettings()
    compass_track: CompassTrackSettings = CompassTrackSettings()

    @property
    def start_covariance(self) -> FloatArray:
        """(3, 3) of a pose that is told without one, (m, m, rad)."""
        return np.diag(np.square([self.start_position_m, self.start_position_m, self.start_heading_rad]))

    def motion_history(self) -> MotionHistory:
        """The motion without the errors of its scales, which the filters find out."""
        free = {"forward_scale": 0.0, "sideways_scale": 0.0, "turn_scale": 0.0}
        return MotionHistory(self.odometry.model_copy(update=free), self.compass_track)


class FieldSearch(Protocol):
    """What a search of the whole field is asked; as `PoseSearch`."""

    def everywhere(
        self, positions_m: FloatArray, covariances_m2: FloatArray, known: Sequence[Known], part: tuple[int, int]
    ) -> tuple[Mode, ...]: ...


class Touchline:
    """The system as sources and sinks know it: `reset` and `step`."""

    __repr__ = system_text

    def __init__(self, setup: RobotSetup, settings: TouchlineSettings, rng: np.random.Generator) -> None:
        """rng is not needed: nothing here is left to chance."""
        field, camera, s = setup.field, setup.camera, settings
        self.setup = setup
        self.settings = settings
        self.detector = (
            None
            if camera is None
            else SelfLearningDetector(camera, LinePointSettings(), LearningSettings(), field.line_width)
        )
        self.max_range_m = setup.max_range_m
        self.history = s.motion_history()
        distance_map = field.distance_map()
        self._lines = distance_map.table
        registration = Registration(distance_map)
        self.search: FieldSearch = PoseSearch(field, registration)
        head = MirrorHead(camera)
        self.exact = ExactMirror(camera, head)
        scales = Scales(s.odometry.forward_scale, s.odometry.sideways_scale, s.odometry.turn_scale)
        self.unknown = Unknown(scales, head.unknown, LEARNED if s.self_calibration else 0.0, UNKNOWN_S)
        start = self._filter_at(Pose(0.0, 0.0, 0.0), None)
        self.hypotheses = PoseHypotheses(registration, field.line_tables, start, head, s.gate)
        self.delay = ImageDelay()
        self.end, self.pulse = EndOdds(field.is_symmetric), CompassPulse()
        self.reset()

    def reset(self, prior: Prior | None = None) -> None:
        """Forget everything but the prior."""
        prior = as_prior(prior)
        if self.detector is not None:
            self.detector.reset()
        self.history.clear()
        self.delay.reset()
        self.pulse.reset()
        self.hypotheses.members, self.hypotheses.confirmed = [], False
        self.hypotheses.head.reset()
        self.own_half = prior.own_half
        self.zone: Known | None = None
        placed = prior.pose is not None
        self.end.reset(told=placed)
        if prior.pose is not None and prior.covariance is not None and _is_wide(prior.covariance):
            self.zone, placed = Known(prior.pose.as_array(), np.linalg.inv(prior.covariance)), False
        elif prior.pose is not None:
            self.hypotheses.members = [Member(self._filter_at(prior.pose, prior.covariance), 0.0)]
        self.status = Status.TRACKING if placed else Status.SEARCHING
        self.blind, self.since_search, self.watched, self.last_ns = 0, 0, 0, 0
        self.problems: tuple[str, ...] = ()

    def step(self, frame: Frame) -> Estimate:
        """Take one frame, return where the robot stands at its time stamp."""
        clock = Stopwatch()
        # predict: the odometry carries every hypothesis on
        self.hypotheses.predict(self._moved(frame), self.delay.wandering_s)
        observation = clock.perception(observe, frame, self.detector, self.max_range_m)  # observe: line points
        self.pulse.hear(frame.compass)
        compass_rad = None if self.pulse.sticks else self.history.at(self._taken_ns(frame)).heading_rad
        if len(observation.points) >= self.settings.min_points:
            self.hypotheses.update(observation.points)  # register, fuse, weigh
            self.hypotheses.hear(frame.evidence, 1.0 / SAID_OFTEN)
            part = self._searched_now()
            if part is not None:
                self._search(observation, compass_rad, part)  # search: every pose that explains the points
        self._judge(frame, observation, compass_rad)  # judge: status, and which end
        self._judge_delay()  # how late the stamps are
        return self._report(observation, clock)

    def _moved(self, frame: Frame) -> Delayed:
        """The robot's motion from when the last image was taken to when this one was, as far as the delay is known."""
        before_ns, best = self.history.clocks.frame_ns, self.hypotheses.best
        self.history.add(frame)
        start_ns = frame.stamp_ns if before_ns is None else before_ns
        return delayed(self.history, start_ns, frame.stamp_ns, 0.0 if best is None else best.filter.late_s)

    def _taken_ns(self, frame: Frame) -> int:
        return frame.stamp_ns - round(1e9 * self.delay.late_s)

    def _judge_delay(self) -> None:
        """How late images are stamped, by the pose that is followed."""
        best = self.hypotheses.best
        if self.status is Status.TRACKING and self.blind == 0 and best is not None:
            unforeseen = self.hypotheses.head.unforeseen  # shaking that the first images' lines were not fitted with
            late = self.delay.update(best.filter.late_s, unforeseen * best.filter.delay_deviation_s)
            self.problems += () if late is None else (late,)

    def _searched_now(self) -> tuple[int, int] | None:
        """Which of so many parts of the headings is searched in this frame: in doubt all of them, else each in turn."""
        best = self.hypotheses.best
        self.since_search += 1
        doubted = self.status is not Status.TRACKING or self.blind >= self.settings.blind_frames
        if doubted or best is None or best.explained < self.settings.min_explained:
            return 0, 1
        parts = min(WATCHED_PARTS, self.settings.search_every)
        if self.since_search * parts < self.settings.search_every:
            return None
        self.watched = (self.watched + 1) % parts
        return self.watched, parts

    def _search(self, observation: Observation, compass_rad: float | None, part: tuple[int, int]) -> None:
        self.since_search = 0
        points, before = observation.points, self.hypotheses.best
        upright = self.hypotheses.upright(points)
        modes = self.search.everywhere(upright, points.covariances_m2, self._known(compass_rad), part)
        if part != (0, 1) and before is not None and before.fit is not None:
            least = before.fit.log_likelihood - HOPELESS
            modes = tuple(mode for mode in modes if mode.log_likelihood > least)
        if self.own_half and before is None:
            modes = tuple(mode for mode in modes if mode.pose.x <= 0.0)
        if self.end.symmetric:
            modes = self._at_one_end(modes)
        self.hypotheses.add(modes, points)
        best = self.hypotheses.best
        if best is None or best is before or self._goes_on_jumping(before, best):
            return
        told = before is None and (self.own_half or self._is_in_zone(best.filter.pose))  # found, or found elsewhere
        self.end.begin(told, self._compass_error(best.filter.pose, compass_rad))
        self.zone = None
        if self.end.symmetric and self.end.log_odds < 0.0:  # the compass has probably failed
            self._turn()

    def _goes_on_jumping(self, before: Member | None, best: Member) -> bool:
        """Whether a pose is the rest of a jump that has left the end open; it stays so."""
        if before is None or not self.end.undecided:
            return False
        return is_shove(best.filter.pose.as_array() - before.filter.pose.as_array())

    def _known(self, compass_rad: float | None) -> tuple[Known, ...]:
        """What a compass says of every pose, and what was told of where the robot is found."""
        told = () if self.zone is None else (self.zone,)
        if compass_rad is None or self.end.compass.is_suspect:
            return told
        information = np.diag([0.0, 0.0, 1.0 / self.settings.compass_sigma_rad**2])
        return (Known(np.array([0.0, 0.0, compass_rad]), information), *told)

    def _is_in_zone(self, pose: Pose) -> bool:
        """Whether a pose is where the robot was told to be, and its twin clearly is not."""
        if self.zone is None:
            return False
        return contradiction(pose.mirrored(), self.zone) - contradiction(pose, self.zone) > CLEARLY

    def _at_one_end(self, modes: tuple[Mode, ...]) -> tuple[Mode, ...]:
        """Of each pair of twins the likelier one, or the one that is nearer to a pose that is followed."""
        kept: list[Mode] = []
        followed = [one.filter.pose for one in self.hypotheses.members]
        for mode in sorted(modes, key=lambda one: -sum(_near(one.pose, pose) for pose in followed)):
            if not any(_near(mode.pose.mirrored(), other.pose) for other in kept):
                kept.append(mode)
        return tuple(kept)

    def _judge(self, frame: Frame, observation: Observation, compass_rad: float | None) -> None:
        """The status, and the end of the field by what the compass and others say."""
        self.blind = 0 if len(observation.points) >= self.settings.min_points else self.blind + 1
        seconds = 1e-9 * max(observation.stamp_ns - self.last_ns, 0) if self.last_ns else 0.0
        self.last_ns, self.problems = observation.stamp_ns, ()
        best = self.hypotheses.best
        if best is None:
            return
        if best.shoved:
            self.end.jumped()
        decided = self.hypotheses.probability >= self.settings.min_probability
        observed = is_observed(best.filter.covariance)
        explained = best.explained >= self.settings.min_explained
        if decided and observed and explained and self.blind == 0:  # a pose in doubt says nothing of a compass
            self.end.update(self._compass_error(best.filter.pose, compass_rad), seconds)
        self.end.hear(frame.evidence, best.filter.pose, seconds)
        if self.end.is_refuted:
            self.problems = (f"{' and '.join(self.end.against)}: the robot is at the other end of the field",)
            self._turn()
        decided = decided and not (self.end.symmetric and self.end.undecided)
        least = 0.5 if self.status is Status.TRACKING else 1.0  # of what else would be doubted
        explained = self.blind > 0 or best.explained >= least * self.settings.min_explained
        if decided and explained and observed and self.blind < self.settings.blind_frames:
            self.status = Status.TRACKING
            self.hypotheses.confirmed = True
        else:
            self.status = Status.SEARCHING if self.status is not Status.TRACKING or decided else Status.LOST

    def _turn(self) -> None:
        """The twin is the pose from now on."""
        self.hypotheses.turn()
        self.end.turn()

    @staticmethod
    def _compass_error(pose: Pose, compass_rad: float | None) -> float | None:
        return None if compass_rad is None else wrap_angle(compass_rad - pose.heading)

    def _filter_at(self, pose: Pose, covariance: FloatArray | None) -> JointFilter:
        told = self.settings.start_covariance if covariance is None else covariance
        return JointFilter(pose, told, self.unknown)

    def _at_stamp(self, one: JointFilter, stamp_ns: int) -> JointFilter:
        """A filter carried from when the last image was taken to its stamp."""
        late_s = self.delay.late_s
        return one.ahead(until_stamp(self.history, stamp_ns, late_s)) if late_s else one

    def _report(self, observation: Observation, clock: Stopwatch) -> Estimate:
        best, end = self.hypotheses.best, self.end.probability
        count = len(observation.points)
        residuals_m = self.hypotheses.mean_distances_m(observation.points, self._lines)
        if best is None:
            pose, covariance, residual_m, probability = Pose(0.0, 0.0, 0.0), UNKNOWN, float("nan"), None
        else:
            probability = self.hypotheses.probability * end
            now = self._at_stamp(best.filter, observation.stamp_ns)
            pose, covariance = self.exact.pose_of(now)
            covariance = covariance + self.hypotheses.head.unseen(now)
            residual_m = residuals_m[0]
        others: list[Hypothesis] = []
        for one, left_m in zip(self.hypotheses.members, residuals_m, strict=True):
            share = self.hypotheses.probability * float(np.exp(one.log_odds))
            now = self._at_stamp(one.filter, observation.stamp_ns)
            place, spread = (pose if one is best else now.pose), now.covariance
            if one is not best:
                others.append(Hypothesis(place, left_m, share * end, spread.copy()))
            if end < 1.0:
                others.append(Hypothesis(place.mirrored(), left_m, share * (1.0 - end)))
        tracked = self.status is Status.TRACKING
        return Estimate(
            observation.stamp_ns,
            pose,
            covariance.copy() if tracked else covariance + UNKNOWN,
            self.status,
            residual_m,
            count,
            tuple(others),
            probability,
            clock.perception_ms,
            clock.localization_ms,
            observation,
            problems=self.problems,
            odometry=None if best is None else best.filter.odometry,
        )


def _is_wide(covariance: FloatArray) -> bool:
    """Whether a pose that is told is a zone to search rather than one to begin at."""
    return bool(np.diagonal(covariance).max() > WIDE**2)


def _near(one: Pose, other: Pose) -> bool:
    return one.distance_to(other) < 0.5 and abs(wrap_angle(one.heading - other.heading)) < 0.5
