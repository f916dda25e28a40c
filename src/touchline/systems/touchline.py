"""touchline: our own system, at the statistical bound, for every kind of camera; no paper's.

image ─▶ points, lines, features ─▶ registration from every hypothesis ─▶ filters, weights ─▶ the best ─▶ estimate
              │                          ▲ odometry                          │                 ▲
              └─▶ search of the whole field ─▶ new hypotheses ◀──────────────┘ in doubt        └─ which end of the field
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from pydantic import Field

from touchline.geometry import FloatArray, Pose, mirrored_covariance, wrap_angle
from touchline.localization.camera_errors import camera_errors
from touchline.localization.camera_errors.base import CameraErrors, Response, placed_points
from touchline.localization.camera_errors.perspective import HEIGHT_M, ahead
from touchline.localization.estimator.bank import Bank, Image, Member, ShoveTest, could_be_shove
from touchline.localization.estimator.compass_fault import StuckCompass
from touchline.localization.estimator.exact_camera import ExactCamera
from touchline.localization.estimator.field_end import PRIOR_LOG_ODDS, FieldEnd
from touchline.localization.estimator.filter import Filter, InitialUncertainty
from touchline.localization.estimator.gaze import Gaze
from touchline.localization.estimator.integrity import Jump
from touchline.localization.estimator.measurements import MEASUREMENTS
from touchline.localization.estimator.pose_status import Criteria, PoseStatus
from touchline.localization.estimator.safeguard import Safeguard
from touchline.localization.estimator.stamp_delay import INITIAL_DEVIATION_S, StampDelay
from touchline.localization.estimator.statistics import CameraErrorStatistics
from touchline.localization.estimator.step_noise import StepNoise
from touchline.localization.estimator.sway_delay import SwayDelay
from touchline.localization.estimator.watch import Ends, FieldWatch
from touchline.localization.estimator.whereabouts import FALL, LYING, Posture, Whereabouts, joined
from touchline.localization.registration.covariance import ANYWHERE
from touchline.localization.registration.feature_model import FeatureView
from touchline.localization.registration.seen import seen_of
from touchline.localization.search.field_search import FieldSearch
from touchline.localization.search.pose_search import Known, Mode, contradiction
from touchline.motion import CompassTrackSettings, LeanFilter, MotionHistory, OdometrySettings
from touchline.motion.delayed import until_stamp
from touchline.motion.driven import Scales
from touchline.motion.start import StartSettings
from touchline.perception import detector_for, observe
from touchline.systems.game_states import Referee
from touchline.systems.setup import RobotSetup, system_text
from touchline.systems.stopwatch import Stopwatch
from touchline.types import Estimate, Frame, Hypothesis, Observation, Prior, Status, as_prior

ZONE = 0.6  # standard deviation (m, rad) of a given pose from which it is a zone: registration reaches no farther
TOLD_S = 10.0  # for which a pose has to be tracked until the half that was given says no more of where one is found
CLEARLY = 2.0  # logarithm of the odds of one end from which a zone decides it
STEPS_RATIO = 5.0 / 3.0  # of the errors of steps' scales to those of wheels'
YAW_RATE_RAD_S = 0.003  # drift of the heading by a walking robot's odometry: ten degrees a minute


class TouchlineSettings(StartSettings):
    """The few things that somebody would tune; all else are constants beside their use."""

    min_points: int = Field(
        10,
        ge=1,
        le=10_000,
        description="line points without which an image tells nothing, where it shows nothing else",
    )
    min_explained: float = Field(
        0.6,
        gt=0,
        lt=1,
        description="share of what is seen that a pose must explain, or it is doubted and the whole field is searched",
    )
    min_probability: float = Field(
        0.9, gt=0.5, lt=1, description="probability from which the likeliest pose is tracked, twin not counted"
    )
    blind_frames: int = Field(
        2,
        ge=1,
        le=1_000,
        description="images in a row that show nothing after which the pose is in doubt; through a perspective camera, "
        "which may look away, not before 4 s have passed",
    )
    search_every: int = Field(
        15,
        ge=1,
        le=1_000,
        description="images in which the whole field is searched once, in parts, though nothing is wrong",
    )
    compass: bool | None = Field(
        None,
        description="whether the compass counts; by default with a mirror alone: humanoids may have none",
    )
    compass_sigma_rad: float = Field(
        0.15, gt=0, description="standard deviation of a compass heading (rad), drift and magnetic fields included"
    )
    gate: float = Field(
        16.3, gt=0, description="squared Mahalanobis distance from the prediction from which the robot was shoved"
    )
    self_calibration: bool = Field(
        True,
        description="learn from the lines what a camera differs by from its camera.yaml: a mirror's tilt, centre and "
        "ranges, a perspective camera's roll, pitch, height and focal length",
    )
    odometry: OdometrySettings = OdometrySettings()
    compass_track: CompassTrackSettings = CompassTrackSettings()

    def motion_history(self) -> MotionHistory:
        """The motion without the errors of its scales, which the filters find out."""
        free = {"forward_scale": 0.0, "sideways_scale": 0.0, "turn_scale": 0.0}
        return MotionHistory(self.odometry.model_copy(update=free), self.compass_track)


class Touchline:
    """The system as sources and sinks know it: `reset` and `step`."""

    __repr__ = system_text

    def __init__(self, setup: RobotSetup, settings: TouchlineSettings, rng: np.random.Generator) -> None:
        """rng is not needed: nothing here is random."""
        field = setup.field
        self.setup, self.settings = setup, settings
        self.detector = detector_for(setup.camera, field)
        self.max_range_m = setup.max_range_m
        self.history = settings.motion_history()
        self.leaning, self.sway, self.delay, self.stuck = LeanFilter(), SwayDelay(), StampDelay(), StuckCompass()
        self.field_search = FieldSearch(field)
        self.model, self.registration = self.field_search.model, self.field_search.registration
        self.watch = FieldWatch(self.field_search, settings.search_every)
        self.open_parts(camera_errors(setup.camera, setup.height_m))
        self.safeguard = Safeguard(self.registration, field)
        self.end = FieldEnd(field.is_symmetric, self.model, self.features.tell_ends_apart)
        self.referee, self.posture = Referee(field), Posture()
        self.gaze = Gaze(field)
        self.reset()

    def open_parts(self, errors: CameraErrors) -> None:
        """The parts that depend on the camera's errors."""
        s, walks = self.settings, self.setup.walks
        self.errors = errors
        self.features = self.field_search.features_at(errors.height_m)
        more = STEPS_RATIO if walks else 1.0
        scales = Scales(*(more * scale for scale in s.odometry.scales))
        self.initial = InitialUncertainty(
            scales, errors.prior, errors.drift, errors.learned if s.self_calibration else 0.0,
            YAW_RATE_RAD_S if walks else 0.0, 0.0 if walks else INITIAL_DEVIATION_S,
        )  # fmt: skip
        self.statistics, self.exact = CameraErrorStatistics(errors), ExactCamera(errors)
        start = Filter(Pose(0.0, 0.0, 0.0), s.start_covariance, self.initial)
        lines = self.setup.field.line_tables
        self.bank = Bank(self.registration, lines, self.statistics, start, StepNoise(walks), ShoveTest(s.gate))
        criteria = Criteria(s.min_points, s.min_explained, s.min_probability, s.blind_frames)
        self.judged = PoseStatus(criteria, errors.trust)

    def reset(self, prior: Prior | None = None) -> None:
        """Forget everything but the prior; one that keeps something joins what is believed."""
        prior = as_prior(prior)
        if prior.kept:
            return self.join(prior)
        if self.detector is not None:
            self.detector.reset()
        self.history.clear()
        self.leaning.clear()
        self.sway.reset()
        self.delay.reset()
        self.stuck.reset()
        self.own_half, self.zone, start, self.tracked_s = prior.own_half, None, None, 0.0
        if prior.pose is not None and prior.covariance is not None and np.diag(prior.covariance).max() > ZONE**2:
            self.zone = Known(prior.pose.as_array(), np.linalg.inv(prior.covariance))
        elif prior.pose is not None:
            spread = self.settings.start_covariance if prior.covariance is None else prior.covariance
            start = Filter(prior.pose, spread, self.initial)
        self.bank.reset(start)
        self.end.reset(known=prior.pose is not None)
        self.judged.reset(tracking=start is not None)
        self.watch.reset()
        self.safeguard.reset(start, confirmed=prior != Prior())
        self.referee.reset()
        self.posture.reset()
        self.before_ns, self.problems = 0, tuple[str, ...]()
        self.whereabouts: Whereabouts | None = None
        if prior.poses:
            self.join(prior)

    @property
    def camera_errors(self) -> tuple[FloatArray, FloatArray]:
        """What it has learned of the camera (K,), and the covariance (K, K) of that."""
        known = self.bank.knowing
        return known.errors, known.error_covariance

    def recall_camera(self, errors: FloatArray, covariance: FloatArray) -> None:
        """Begin with what was learned of this camera before. Raises InputError for errors of another one."""
        self.bank.start.recall(errors, covariance)

    def join(self, prior: Prior) -> None:
        """Take what has happened to the robot: it may stand elsewhere by now."""
        best = self.bank.best
        if prior.kept == 1.0 and self.whereabouts is None and best is not None and self.judged.images:
            half = math.copysign(PRIOR_LOG_ODDS, -best.filter.pose.x) if prior.own_half else 0.0
            return self.end.take_prior(min(max(self.end.prior_log_odds + half, -PRIOR_LOG_ODDS), PRIOR_LOG_ODDS))
        field = self.setup.field
        area_m2 = (field.length + 1.0) * (field.width + 1.0)
        self.whereabouts = joined(self.bank, self.end.probability, self.whereabouts, prior, area_m2)
        self.zone, self.own_half = None, False
        self.judged.reset(tracking=False)
        self.watch.reset()
        self.safeguard.reset(confirmed=True)

    def step(self, frame: Frame) -> Estimate:
        """Take one frame, return where the robot stands at its time stamp."""
        seconds = self._take(frame)
        shift = self._predict(frame, seconds)  # predict: propagate every hypothesis by the odometry
        self.bank.measure(frame, MEASUREMENTS)  # measure: by further sensors
        frame, observation = self._observe(frame)  # observe: line points, lines, crossings, landmarks
        self._describe_camera(observation)
        image = Image(seen_of(observation, self.features, self.statistics.noise), self.errors.response(frame), shift)
        if self.judged.sees(image.seen):
            self.bank.register(image)  # register: fit the image from every hypothesis
            modes = self._search(frame, observation, image)  # search: in doubt, every pose that explains it
            self.bank.update(image, modes, self._carried(modes), frame.evidence)  # fuse, weigh
            self._judge_end(frame, observation, seconds)  # which end of the field
            self._judge_sensors(frame, image)  # does any sensor contradict the others?
        self._judge_status(seconds)  # is the pose tracked?
        self._judge_delay(frame)  # how late are the stamps?
        return self._report(observation)

    def _take(self, frame: Frame) -> float:
        """Take a frame's samples; seconds since the one before. One from the past is refused and changes nothing."""
        self.clock = Stopwatch()
        before_ns = self.history.clocks.frame_ns
        self.history.add(frame)
        self.before_ns, self.problems = frame.stamp_ns if before_ns is None else before_ns, ()
        seconds = 1e-9 * (frame.stamp_ns - self.before_ns)
        self._take_events(frame, seconds)
        return seconds

    def _take_events(self, frame: Frame, seconds: float) -> None:
        """What the referee says, and whether the robot lies; what it felt of a fall is not believed."""
        for said in frame.game:
            for prior in self.referee.update(said):
                self.join(prior)
        self.posture.update(frame.stamp_ns, None if frame.tilt is None else frame.tilt.values)
        if self.posture.fell:
            self.join(FALL)
        if self.posture.lies and self.whereabouts is not None:
            self.whereabouts.loosen(seconds * LYING)

    @property
    def _estimated_delay_s(self) -> float:
        """How late images are stamped by the filter of the likeliest pose; accepted or not."""
        best = self.bank.best
        return 0.0 if best is None else best.filter.delay_s

    def _predict(self, frame: Frame, seconds: float) -> FloatArray | None:
        """From when the last image was taken to when this one was; (3,) by how much that may be off, robot frame."""
        self.stuck.update(frame.compass)
        if self.posture.lies:
            return None
        moved = self.safeguard.motion(self.history, (self.before_ns, frame.stamp_ns), self._estimated_delay_s)
        self.bank.predict(moved, seconds)
        self.safeguard.carry(moved, seconds)
        if self.whereabouts is not None:
            self.whereabouts.predict(moved, seconds, self.bank.steps.of(moved.motion))
        self.followed = self.bank.best
        self.predicted = np.zeros(3) if self.followed is None else self.followed.filter.pose.as_array()
        return self.delay.wandering_s * moved.after if self.delay.wandering_s else None

    def _observe(self, frame: Frame) -> tuple[Frame, Observation]:
        """A frame with the lean at which its image was taken, and what is seen in it."""
        if self.setup.leans:
            frame = self.leaning.at_image(frame, round(1e9 * self._estimated_delay_s))
        if self.posture.lies:
            return frame, Observation(frame.stamp_ns)
        return frame, self.clock.perception(observe, frame, self.detector, self.max_range_m)

    def _describe_camera(self, seen: Observation) -> None:
        """An undescribed camera that at first shows lines, crossings or landmarks, and no line points, is a perspective
        one: the parts that depend on the camera are opened anew.
        """
        described = self.setup.camera is not None or self.setup.height_m is not None
        features = len(seen.lines) + len(seen.crossings) + len(seen.landmarks)
        if described or self.judged.images or len(seen.points) or not features:
            return
        best = self.bank.best
        self.setup = replace(self.setup, height_m=HEIGHT_M)
        self.open_parts(camera_errors(None, HEIGHT_M))
        if best is not None:
            self.bank.reset(Filter(best.filter.pose, best.filter.covariance, self.initial))

    def _search(self, frame: Frame, observation: Observation, image: Image) -> tuple[Mode, ...]:
        """Poses that explain an image, if the field is searched now."""
        part = self.watch.part(self.whereabouts is not None or self.judged.is_in_doubt(self.bank.best))
        if part is None:
            return ()
        known, ends = self._known(self._compass(frame)), Ends(self.end.symmetric, self.own_half)

        def view_at(errors: FloatArray) -> FeatureView:
            return self._view(observation, errors, image.response)

        modes = self.watch.modes(image, view_at, self.bank, known, part, ends)
        return modes if self.whereabouts is None else self.whereabouts.at_likelier_end(modes)

    def _carried(self, modes: Sequence[Mode]) -> list[float]:
        """Log-odds that the robot was moved unfelt to poses that were found."""
        if self.whereabouts is not None:
            return self.whereabouts.gains(modes, self.bank.best)
        return len(modes) * [self.judged.carried_log_odds]

    def _view(self, observation: Observation, errors: FloatArray, response: Response) -> FeatureView:
        """The features of an image without errors (K,) of the camera."""
        return self.features.of(observation, lambda points: placed_points(points, errors, response))

    def _compass(self, frame: Frame) -> float | None:
        """The compass heading (rad) when the image was taken; None where none counts."""
        counts = not self.setup.walks if self.settings.compass is None else self.settings.compass
        if not counts or self.stuck.sticks:
            return None
        return self.history.compass.heading_at(frame.stamp_ns - round(1e9 * self.delay.corrected_s))

    def _known(self, compass_rad: float | None) -> tuple[Known, ...]:
        """The heading by a compass, and the zone that was given."""
        zone = () if self.zone is None else (self.zone,)
        if compass_rad is None or self.end.compass.is_suspect:
            return zone
        information = np.diag([0.0, 0.0, 1.0 / self.settings.compass_sigma_rad**2])
        return (Known(np.array([0.0, 0.0, compass_rad]), information), *zone)

    def _judge_end(self, frame: Frame, observation: Observation, seconds: float) -> None:
        """Which of the pose and its twin is right, by the compass, by colours and by the evidence of others."""
        best, end = self.bank.best, self.end
        if best is None:
            return
        if self.safeguard.held is not None:
            return
        compass_rad = self._compass(frame)
        if self.followed is None or not could_be_shove(best.filter.pose.as_array() - self.predicted):
            self._begin_end(best, compass_rad)
        elif best.shoved or best is not self.followed:
            end.jumped()
        if self.whereabouts is not None and self.bank.best is not None:
            end.take_prior(self.whereabouts.log_odds(self.bank.best.filter.pose))
        if self.judged.is_consistent(self.bank):  # a doubtful pose does not test a compass
            end.update_from_compass(_compass_error(best.filter.pose, compass_rad), seconds)
        if end.colours_tell:
            end.update_from_colours(
                self._view(observation, best.filter.errors, self.errors.response(frame)), best.filter.pose
            )
        end.update_from_team(frame.evidence, best.filter.pose, seconds)
        if end.is_refuted:
            self.problems = (end.refutation,)
            self._swap_ends()

    def _judge_sensors(self, frame: Frame, image: Image) -> None:
        """Whether images and odometry are trusted."""
        best = self.bank.best
        elsewhere = best is None or not could_be_shove(best.filter.pose.as_array() - self.predicted)
        unexpected = self.followed is None or (elsewhere and self.whereabouts is not None)
        predicted = None if unexpected else Pose(*self.predicted.tolist())
        jump = Jump(predicted, predicted is None or elsewhere)
        self.problems += self.safeguard.update(
            frame.stamp_ns, image, self.bank, self.end, self.history, self.delay, jump
        )
        if self.bank.best is not None and self.judged.status is Status.TRACKING:
            self.safeguard.keep(frame.stamp_ns, self.bank.best.filter, self.end)

    def _begin_end(self, best: Member, compass_rad: float | None) -> None:
        """A pose was found anew, or elsewhere. The half that was given holds until a pose was tracked for long."""
        found, half = self.followed is None, self.own_half and self.tracked_s < TOLD_S
        known = half or (found and self._is_in_zone(best.filter.pose))
        if half and self.end.symmetric and best.filter.pose.x > 0.0:
            self._swap_ends()
        self.end.begin(known, _compass_error(best.filter.pose, compass_rad))
        self.zone = None
        if self.end.symmetric and self.end.log_odds < 0.0:  # the compass has probably failed
            self._swap_ends()

    def _swap_ends(self) -> None:
        """The twin is the pose from now on."""
        self.bank.swap_ends()
        self.end.swap_ends()

    def _is_in_zone(self, pose: Pose) -> bool:
        """Whether a pose is in the zone that was given, and its twin clearly is not."""
        if self.zone is None:
            return False
        return contradiction(pose.mirrored(), self.zone) - contradiction(pose, self.zone) > CLEARLY

    def _judge_status(self, seconds: float) -> None:
        """Whether the pose is tracked."""
        tracked = self.judged.update(self.bank, self.end, seconds) is Status.TRACKING
        self.tracked_s += seconds if tracked else 0.0
        where = self.whereabouts
        shown = where is not None and self.judged.blind_frames == 0
        if where is not None and shown and where.settles(self.bank.best, tracked and not self.referee.penalty):
            self.whereabouts = None
        if tracked:
            self.problems += self.end.report_undecided(seconds)

    def _judge_delay(self, frame: Frame) -> None:
        """How late images are stamped, by the motion that the pose shows or by how a walking robot sways."""
        best = self.bank.best
        if best is None or best.fit is None or self.judged.status is not Status.TRACKING or self.judged.blind_frames:
            return
        if self.safeguard.verdict.reason:
            return
        pans = frame.base_from_camera is not None  # the camera's pose then is unknown: named, and not corrected
        if not self.setup.walks:
            delay_s, deviation_s = best.filter.delay_s, self.statistics.lean_ratio * best.filter.delay_deviation_s
        elif frame.image is None or best.explained < self.settings.min_explained:
            return
        else:
            roll, pitch = (best.fit.state[3:5] - best.filter.errors[:2]).tolist()
            x, y = ahead(self.errors.response(frame).axis)
            lean_rad = np.array([x * roll - y * pitch, y * roll + x * pitch])
            delay_s, deviation_s = self.sway.update(lean_rad, self.leaning, frame.stamp_ns, self._estimated_delay_s)
        problem = self.delay.update(delay_s, deviation_s, correctable=not pans)
        self.problems += () if problem is None else (problem,)
        if self.setup.walks:
            self.bank.take_delay(self.delay.corrected_s, self.delay.deviation_s)

    def _report(self, observation: Observation) -> Estimate:
        """What is published: the likeliest pose at the stamp, and the others."""
        best, end, members = self.bank.best, self.end.probability, self.bank.members
        seen = (observation.points, observation.lines, observation.crossings, observation.landmarks)
        others: list[Hypothesis] = []
        pose, covariance, residual_m = Pose(0.0, 0.0, 0.0), ANYWHERE, float("nan")
        for one, probability in zip(members, self.bank.probabilities, strict=True):
            now = self._at_stamp(one.filter, observation.stamp_ns)
            at, spread = self.exact.pose_of(now) if one is best else (now.pose, now.covariance)
            spread = spread + self.statistics.floor(now)
            off_m = float("nan") if one.fit is None else float(one.fit.residual_m)
            if one is best:
                pose, covariance, residual_m = at, spread, off_m
            else:
                others.append(Hypothesis(at, off_m, probability * end, spread))
            if end < 1.0:
                others.append(Hypothesis(at.mirrored(), off_m, probability * (1.0 - end), mirrored_covariance(spread)))
        status, held, reason = self.judged.status, self.safeguard.held, self.safeguard.verdict.reason
        if status is Status.TRACKING and not self.safeguard.integrity.is_believed:
            status, reason = Status.SEARCHING, self.safeguard.integrity.reason
        unseen = self._unseen_reason()
        if unseen:
            status, reason = Status.SEARCHING, unseen
        if best is None and self.whereabouts is not None and self.whereabouts.best is not None:
            pose, covariance = self.whereabouts.best.pose, self.whereabouts.best.covariance
        if held is not None:
            others.append(Hypothesis(pose, residual_m, None, covariance))
            pose, covariance = held.pose, held.covariance
        bound_m, bound_rad = None, None
        if status is Status.TRACKING:
            bounds = self.safeguard.integrity.protection(covariance, observation.stamp_ns, self.history)
            if bounds is None:
                status, reason = Status.SEARCHING, self.safeguard.integrity.unbounded
            else:
                bound_m, bound_rad = bounds
        return Estimate(
            observation.stamp_ns,
            pose,
            covariance if status is Status.TRACKING else covariance + ANYWHERE,
            status,
            residual_m,
            sum(map(len, seen)),
            tuple(others),
            None if best is None or held is not None else self.bank.probabilities[0] * end,
            self.clock.perception_ms,
            self.clock.localization_ms,
            observation,
            problems=self.problems,
            protection_m=bound_m,
            protection_rad=bound_rad,
            reason=reason,
            end_probability=None if best is None else end,
            statistics=self.safeguard.integrity.statistics,
            gaze=self.gaze,
            odometry=None if best is None else best.filter.odometry,
        )

    def _unseen_reason(self) -> str:
        """Why images have not confirmed yet where the robot stands since something moved it."""
        if self.posture.lies:
            return "the robot lies"
        if self.referee.penalty:
            return f"penalised: {self.referee.penalty}"
        if self.whereabouts is None:
            return ""
        return "which end of the field is open" if self.end.undecided else "moved: not yet confirmed by images"

    def _at_stamp(self, one: Filter, stamp_ns: int) -> Filter:
        """A filter propagated from when the last image was taken to its stamp."""
        return one.ahead(until_stamp(self.history, stamp_ns, self.delay.corrected_s)) if self.delay.corrected_s else one


def _compass_error(pose: Pose, compass_rad: float | None) -> float | None:
    return None if compass_rad is None else wrap_angle(compass_rad - pose.heading)
