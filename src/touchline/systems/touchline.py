"""touchline: our own system, at the statistical bound, for every kind of camera; no paper's.

image ─▶ points, lines, features ─▶ registration from every hypothesis ─▶ filters, weights ─▶ the best ─▶ estimate
              │                          ▲ odometry                          │                 ▲
              └─▶ search of the whole field ─▶ new hypotheses ◀──────────────┘ in doubt        └─ which end of the field
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from pydantic import Field

from touchline.geometry import FloatArray, Pose, circular_mean, wrap_angles
from touchline.localization.camera_errors import camera_errors
from touchline.localization.camera_errors.base import CameraErrors, Response, placed_points
from touchline.localization.camera_errors.perspective import HEIGHT_M
from touchline.localization.estimator.bank import Bank, Image, ShoveTest
from touchline.localization.estimator.believed import believed
from touchline.localization.estimator.end_judge import EndJudge, Predicted, compass_error
from touchline.localization.estimator.exact_camera import ExactCamera
from touchline.localization.estimator.field_end import FieldEnd
from touchline.localization.estimator.filter import Filter, InitialUncertainty, scales_of
from touchline.localization.estimator.gaze import Gaze
from touchline.localization.estimator.measurements import MEASUREMENTS
from touchline.localization.estimator.pose_status import Criteria, PoseStatus
from touchline.localization.estimator.relocation import Relocation
from touchline.localization.estimator.safeguard import Safeguard, jump_of
from touchline.localization.estimator.stamp_delay import INITIAL_DEVIATION_S, StampDelay
from touchline.localization.estimator.statistics import CameraErrorStatistics
from touchline.localization.estimator.step_noise import StepNoise
from touchline.localization.estimator.sway_delay import SwayDelay, lean_by
from touchline.localization.estimator.watch import PARTS, SECTOR_PARTS, FieldWatch
from touchline.localization.estimator.whereabouts import LOST
from touchline.localization.registration.covariance import ANYWHERE
from touchline.localization.registration.feature_model import FeatureModel, FeatureView
from touchline.localization.registration.seen import seen_of
from touchline.localization.search.field_search import FieldSearch
from touchline.localization.search.pose_search import Mode
from touchline.motion import CompassTrackSettings, LeanFilter, MotionHistory, OdometrySettings
from touchline.motion.delayed import until_stamp
from touchline.motion.driven import Scales
from touchline.motion.start import StartSettings
from touchline.perception import detector_for, observe
from touchline.systems.setup import RobotSetup, system_text
from touchline.systems.stopwatch import Stopwatch
from touchline.types import Estimate, Frame, Observation, Prior, Problem, Status, as_prior
from touchline.types.estimate import later

STEPS_RATIO = 5.0 / 3.0  # of the errors of steps' scales to those of wheels'
MAX_VIEW_RAD = 2.0  # within which all points lie that a perspective camera sees; a mirror shows lines all round
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
    search_ms: float | None = Field(
        None,
        gt=0,
        description="milliseconds that a search of the whole field in doubt may take of an image, in which at least a "
        "fifth of the field is searched; the next images go on with it, longer in all, and until it is done no pose is "
        "tracked that was not; by default it is done at once, so that a recording always gives the same numbers",
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
        self.leaning, self.sway, self.delay = LeanFilter(), SwayDelay(), StampDelay()
        self.field_search = FieldSearch(field)
        self.model, self.registration = self.field_search.model, self.field_search.registration
        self.watch = FieldWatch(self.field_search, settings.search_every, settings.search_ms)
        self.open_parts(camera_errors(setup.camera, setup.height_m))
        self.safeguard = Safeguard(self.registration, field)
        self.end = FieldEnd(field.is_symmetric, self.model, self.features.tell_ends_apart)
        compass_counts = not setup.walks if settings.compass is None else settings.compass
        self.end_judge = EndJudge(self.end, compass_counts, settings.compass_sigma_rad)
        self.relocation = Relocation(field)
        self.gaze = Gaze(field)
        self.reset()

    @property
    def feature_model(self) -> FeatureModel:
        """The observation model by which features weigh a pose."""
        return self.model

    def open_parts(self, errors: CameraErrors) -> None:
        """The parts that depend on the camera's errors."""
        s, walks = self.settings, self.setup.walks
        self.errors = errors
        self.features = self.field_search.features_at(errors.height_m)
        self.watch.watched_parts = PARTS if errors.trust.free_fit else SECTOR_PARTS
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
        self.end_judge.reset(prior)
        start = None
        if prior.pose is not None and self.end_judge.zone is None:
            spread = self.settings.start_covariance if prior.covariance is None else prior.covariance
            start = Filter(prior.pose, spread, self.initial)
        self.bank.reset(start)
        self.judged.reset(tracking=start is not None)
        self.watch.reset()
        self.safeguard.reset(start, confirmed=prior != Prior(), own_half=prior == Prior(own_half=True))
        self.relocation.reset()
        self.before_ns, self.problems = 0, tuple[Problem, ...]()
        if prior.poses:
            self.join(prior)

    @property
    def camera_errors(self) -> tuple[FloatArray, FloatArray]:
        """What it has learned of the camera (K,), and the covariance (K, K) of that."""
        known = self.bank.knowing
        return known.errors.copy(), known.error_covariance

    def recall_camera(self, errors: FloatArray, covariance: FloatArray) -> None:
        """Begin with what was learned of this camera before. Raises InputError for errors of another one."""
        if not self._is_described and len(errors) == len(camera_errors(None, HEIGHT_M).names):
            self._open_perspective()
        self.bank.start.recall(errors, covariance)

    def join(self, prior: Prior) -> None:
        """Take what has happened to the robot: it may stand elsewhere by now."""
        best = self.bank.best
        if prior.kept == 1.0 and self.relocation.whereabouts is None and best is not None and self.judged.images:
            return self.end.add_half(best.filter.pose, prior.own_half)
        self.relocation.join(self.bank, self.end, prior)
        self.end_judge.forget_start()
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
        image = self._image(frame, observation, shift)
        if self.judged.sees(image.seen):
            self.bank.register(image)  # register: fit the image from every hypothesis
            found = self._search(frame, observation, image)  # search: in doubt, every pose that explains it
            self.bank.update(image, *found, frame.evidence)  # fuse, weigh
            self._judge_end(frame, observation, image, seconds)  # which end of the field
            self._judge_sensors(frame, image)  # does any sensor contradict the others?
        self._judge_status(seconds)  # is the pose tracked?
        self._judge_delay(frame, image)  # how late are the stamps?
        return self._report(observation)

    def _take(self, frame: Frame) -> float:
        """Take a frame's samples; seconds since the one before. One from the past is refused and changes nothing."""
        self.clock = Stopwatch()
        before_ns = self.history.clocks.frame_ns
        self.history.add(frame)
        self.before_ns, self.problems = frame.stamp_ns if before_ns is None else before_ns, ()
        for prior in self.relocation.events(frame):
            self.join(prior)
        return 1e-9 * (frame.stamp_ns - self.before_ns)

    @property
    def _estimated_delay_s(self) -> float:
        """How late images are stamped by the filter of the likeliest pose; accepted or not."""
        best = self.bank.best
        return 0.0 if best is None else best.filter.delay_s

    def _predict(self, frame: Frame, seconds: float) -> FloatArray | None:
        """From when the last image was taken to when this one was; (3,) by how much that may be off, robot frame."""
        self.end_judge.take(frame)
        if self.relocation.lies:
            self.relocation.lie(seconds)
            return None
        moved = self.safeguard.motion(self.history, (self.before_ns, frame.stamp_ns), self._estimated_delay_s)
        self.bank.predict(moved, seconds)
        self.safeguard.carry(moved, seconds)
        self.end_judge.predict(moved)
        self.relocation.predict(moved, seconds, self.bank)
        if self.relocation.loses(self.bank) and self.safeguard.held is None:
            self.relocation.join(self.bank, self.end, LOST)
            self.end_judge.forget_start()
            self.judged.reset(tracking=False)
        self.followed = self.bank.best
        trusted = self.safeguard.verdict.images and self.safeguard.verdict.odometry
        self.predicted = None if self.followed is None else Predicted.of(self.followed, trusted)
        return self.delay.wandering_s * moved.after if self.delay.wandering_s else None

    def _observe(self, frame: Frame) -> tuple[Frame, Observation]:
        """A frame with the lean at which its image was taken, and what is seen in it."""
        if self.setup.leans:
            frame = self.leaning.at_image(frame, round(1e9 * self._estimated_delay_s))
        if self.relocation.lies:
            return frame, Observation(frame.stamp_ns)
        return frame, self.clock.perception(observe, frame, self.detector, self.max_range_m)

    def _image(self, frame: Frame, observation: Observation, shift: FloatArray | None) -> Image:
        """What registration takes of an observation."""
        seen = seen_of(observation, self.features, self.statistics.noise)
        return Image(seen, self.errors.response(frame), shift, has_lines=len(observation.lines) > 0)

    def _describe_camera(self, seen: Observation) -> None:
        """An undescribed camera that at first shows lines, crossings or landmarks, and no line points, or points within
        a sector alone, is a perspective one: the parts that depend on the camera are opened anew.
        """
        if self._is_described or self.judged.images:
            return
        features, points = len(seen.lines) + len(seen.crossings) + len(seen.landmarks), len(seen.points)
        if not (features or points >= self.settings.min_points):
            return
        bearings = np.arctan2(*seen.points.positions_m.T[::-1])
        if points and np.abs(wrap_angles(bearings - circular_mean(bearings))).max() > 0.5 * MAX_VIEW_RAD:
            return
        best = self.bank.best
        self._open_perspective()
        if best is not None:
            self.bank.reset(Filter(best.filter.pose, best.filter.covariance, self.initial))

    @property
    def _is_described(self) -> bool:
        """Whether it is known which kind of camera sees."""
        return self.setup.camera is not None or self.setup.height_m is not None

    def _open_perspective(self) -> None:
        """The undescribed camera is a perspective one."""
        self.setup = replace(self.setup, height_m=HEIGHT_M)
        self.open_parts(camera_errors(None, HEIGHT_M))

    def _search(self, frame: Frame, observation: Observation, image: Image) -> tuple[Sequence[Mode], list[float]]:
        """Poses that explain an image, if the field is searched now, and their log-odds before it was seen."""
        where, best = self.relocation.whereabouts, self.bank.best
        part = self.watch.part(where is not None or self.judged.is_in_doubt(best), best is not None)
        if part is None:
            return (), []
        known, ends = self.end_judge.known(self._compass(frame)), self.end_judge.ends

        def view_at(errors: FloatArray) -> FeatureView:
            return self._view(observation, errors, image.response)

        modes = self.watch.modes(image, view_at, self.bank, known, part, ends)
        modes = modes if where is None else where.at_likelier_end(modes)
        # parts of a search that began without a pose find poses that are as likely as those of the parts before
        carried = 0.0 if self.watch.finds_first else self.judged.carried_log_odds
        return modes, self.relocation.weigh(modes, self.bank, carried)

    def _view(self, observation: Observation, errors: FloatArray, response: Response) -> FeatureView:
        """The features of an image without errors (K,) of the camera."""
        return self.features.of(observation, lambda points: placed_points(points, errors, response))

    def _compass(self, frame: Frame) -> float | None:
        """The compass heading (rad) when the image was taken; None where none counts."""
        taken_ns = frame.stamp_ns - round(1e9 * self.delay.corrected_s)
        return self.end_judge.compass(taken_ns, self.history)

    def _judge_end(self, frame: Frame, observation: Observation, image: Image, seconds: float) -> None:
        """Which of the pose and its twin is right, by the compass, by colours and by the evidence of others."""
        best, end = self.bank.best, self.end
        if best is None or self.safeguard.held is not None:
            return
        compass_rad = self._compass(frame)
        self.end_judge.follow(self.bank, self.followed, self.predicted, compass_rad, self.relocation.refereed)
        moved_log_odds = self.relocation.end_log_odds(self.bank, self.followed)
        if moved_log_odds is not None:
            end.take_prior(moved_log_odds, self.relocation.end_was_open)
        sure = self.safeguard.integrity.is_believed and self.judged.is_consistent(self.bank)
        if sure:  # a doubtful pose does not test a compass
            pose = best.filter.pose
            end.update_from_compass(compass_error(pose, compass_rad), seconds, pose.heading)
        if end.colours_tell and len(observation.landmarks):  # lines and crossings are alike at both ends
            coloured = Observation(observation.stamp_ns, landmarks=observation.landmarks)
            view = self._view(coloured, best.filter.errors, image.response)
            end.update_from_colours(view, best.filter.pose)
        end.update_from_team(frame.evidence, best.filter.pose, seconds)
        self.problems += self.end_judge.refute(self.bank)

    def _judge_sensors(self, frame: Frame, image: Image) -> None:
        """Whether images and odometry are trusted."""
        jump = jump_of(self.bank.best, self.predicted, expected=self.relocation.whereabouts is not None)
        self.problems += self.safeguard.update(
            frame.stamp_ns, image, self.bank, self.end, self.history, self.delay, jump
        )
        if self.bank.best is not None and self.judged.status is Status.TRACKING:
            self.safeguard.keep(frame.stamp_ns, self.bank.best.filter, self.end)

    def _judge_status(self, seconds: float) -> None:
        """Whether the pose is tracked."""
        tracked = self.judged.update(self.bank, self.end, seconds, self.watch.left > 0) is Status.TRACKING
        self.relocation.settle(self.bank, self.judged.blind_frames == 0, tracked)
        self.problems += self.end_judge.tracked(seconds) if tracked else ()

    def _judge_delay(self, frame: Frame, image: Image) -> None:
        """How late images are stamped, by the motion that the pose shows or by how a walking robot sways."""
        best = self.bank.best
        if best is None or best.fit is None or self.judged.status is not Status.TRACKING or self.judged.blind_frames:
            return
        if self.safeguard.verdict.problem:
            return
        pans = frame.base_from_camera is not None  # the camera's pose then is unknown: named, and not corrected
        if not self.setup.walks:
            delay_s, deviation_s = best.filter.delay_s, self.statistics.lean_ratio * best.filter.delay_deviation_s
        elif frame.image is None or best.explained < self.settings.min_explained:
            return
        else:
            lean_rad = lean_by(best.fit.state[3:5] - best.filter.errors[:2], image.response.axis)
            delay_s, deviation_s = self.sway.update(lean_rad, self.leaning, frame.stamp_ns, self._estimated_delay_s)
        problem = self.delay.update(delay_s, deviation_s, correctable=not pans)
        self.problems += () if problem is None else (problem,)
        if self.setup.walks:
            self.bank.take_delay(self.delay.corrected_s, self.delay.deviation_s)

    def _report(self, observation: Observation) -> Estimate:
        """What is published: the likeliest pose at the stamp, and the others."""
        best, end, stamp_ns = self.bank.best, self.end.probability, observation.stamp_ns
        found = believed(self.bank, end, self.exact, lambda one: self._at_stamp(one, stamp_ns))
        if best is None:
            found = self.relocation.instead_of(found)
        found = self.safeguard.instead_of(found)
        unseen = self.relocation.reason(self.end.undecided)
        verdict = self.safeguard.judge(self.judged, unseen, found.covariance, stamp_ns, self.history)
        held, tracked = self.safeguard.held, verdict.status is Status.TRACKING
        seen = (observation.points, observation.lines, observation.crossings, observation.landmarks)
        return Estimate(
            stamp_ns,
            found.pose,
            found.covariance if tracked else found.covariance + ANYWHERE,
            verdict.status,
            found.residual_m,
            sum(map(len, seen)),
            later(found.others),
            None if best is None or held is not None else self.bank.probabilities[0] * end,
            self.clock.perception_ms,
            self.clock.localization_ms,
            observation,
            problems=self.problems,
            protection_m=verdict.bound_m,
            protection_rad=verdict.bound_rad,
            reason=verdict.reason,
            end_probability=None if best is None else end,
            statistics=self.safeguard.integrity.statistics,
            gaze=self.gaze,
            odometry=None if best is None else later(partial(scales_of, best.filter.mean, best.filter.joint)),
            camera_errors=None if best is None else best.filter.errors.copy(),
        )

    def _at_stamp(self, one: Filter, stamp_ns: int) -> Filter:
        """A filter propagated from when the last image was taken to its stamp."""
        return one.ahead(until_stamp(self.history, stamp_ns, self.delay.corrected_s)) if self.delay.corrected_s else one
