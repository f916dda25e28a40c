"""touchline on a robot with a perspective camera: a walking humanoid, whose camera leans as it walks.

image ─▶ lines, crossings, landmarks ─▶ registration from every hypothesis ─▶ filters, weights ─▶ the best ─▶ estimate
                │                        ▲ pose with roll, pitch, height          │                ▲
                └─▶ search by pairs of features ─▶ new hypotheses ◀───────────────┘ undecided      └─ colours: which end
"""

from __future__ import annotations

import math

import numpy as np

from touchline.camera import Camera, PerspectiveCamera, ground_view
from touchline.errors import InputError
from touchline.field.association import FieldAssociations
from touchline.geometry import FloatArray, Pose, mirrored_covariance
from touchline.localization.estimator.end_odds import EndOdds
from touchline.localization.estimator.image_delay import ImageDelay
from touchline.localization.estimator.lean_delay import LAGS_S, LeanDelay
from touchline.localization.estimator.perspective_filter import PerspectiveFilter
from touchline.localization.estimator.perspective_hypotheses import CARRIED_AWAY, FALLEN, PerspectiveHypotheses
from touchline.localization.particles.feature_model import FeatureModel, FeatureView, field_lines
from touchline.localization.particles.features import Features
from touchline.localization.particles.random_particles import BEYOND_M
from touchline.localization.published.nimbro.feature_belief import is_narrow
from touchline.localization.published.nimbro.twin_odds import SURE, TwinOdds
from touchline.localization.registration.perspective_kernels import STATES, LeanFit, SeenPoints
from touchline.localization.registration.perspective_registration import NO_AXIS, PerspectiveRegistration, seen_points
from touchline.localization.search.feature_poses import PoseProposals
from touchline.localization.search.perspective_search import PerspectiveSearch
from touchline.motion import LeanFilter, MotionHistory
from touchline.motion.lean import LAG_S
from touchline.motion.odometry import Motion
from touchline.perception import Detector, LineGraphSettings, line_graph_detector, observe
from touchline.systems.report import Stopwatch
from touchline.systems.setup import RobotSetup, system_text
from touchline.systems.touchline import SAID_OFTEN, UNKNOWN, Touchline, TouchlineSettings
from touchline.types import Estimate, Frame, Hypothesis, Observation, Prior, Status, as_prior

CAMERA_HEIGHT_M = 1.0  # where nobody tells
PLACE_M = 0.01  # error of a crossing's place on the field
WIDE_M = 0.2  # standard deviation of a position from which on one line may be taken for another
BLIND_S = 4.0  # without a feature from which on a pose is in doubt: the robot may have fallen, and been carried
MEMORY = 0.4  # share of an image in how much is explained of late
USUAL = 0.85  # share of what an image shows that a right pose explains: other places are looked for where it is less
MIN_SEEN = 0.5  # features, or line points by their shares, without which an image tells nothing
TOLD = 3.0  # log-odds of an end that a person tells: one start in twenty is told wrongly
UNDECIDED_S = 10.0  # after which it is said, and said again, that nothing tells the ends apart


class TouchlinePerspective:
    """The system as sources and sinks know it: `reset` and `step`."""

    __repr__ = system_text

    def __init__(self, setup: RobotSetup, settings: TouchlineSettings, rng: np.random.Generator) -> None:
        """rng is not needed: nothing here is left to chance."""
        field, camera = setup.field, setup.camera
        self.setup, self.settings = setup, settings
        eye = np.array([0.0, 0.0, setup.height_m or CAMERA_HEIGHT_M])
        self.detector: Detector | None = None
        if isinstance(camera, PerspectiveCamera):
            self.detector = line_graph_detector(camera, LineGraphSettings(), field)
            eye = camera.base_from_camera.translation_m
        self.max_range_m = setup.max_range_m
        self.history = settings.motion_history()
        self.leaning, self.lean_delay, self.delay = LeanFilter(), LeanDelay(), ImageDelay()
        places, lines = FieldAssociations(field), field_lines(field)
        self.features = Features(places, None, float(eye[2]), PLACE_M)
        registration = PerspectiveRegistration(field, places.tables, eye)
        model = FeatureModel(places.tables, lines, polar=False)
        reach_m = 0.5 * np.array([field.length, field.width]) + BEYOND_M
        self.search = PerspectiveSearch(PoseProposals(model, reach_m), registration)
        self.hypotheses = PerspectiveHypotheses(registration, field.is_symmetric)
        self.symmetric = field.is_symmetric
        self.tells_ends = self.symmetric and self.features.tell_ends_apart
        self.twin, self.end = TwinOdds(model), EndOdds(self.symmetric)
        self.reset()

    def reset(self, prior: Prior | None = None) -> None:
        """Forget everything but the prior."""
        prior = as_prior(prior)
        if self.detector is not None:
            self.detector.reset()
        self.history.clear()
        self.leaning.clear()
        self.lean_delay.reset()
        self.delay.reset()
        self.pans = False
        self.own_half = prior.own_half
        self.known = self._filter_at(prior.pose or Pose(0.0, 0.0, 0.0), prior.covariance)
        self.hypotheses.start(None if prior.pose is None else self.known)
        self._tell_end(prior.pose is not None)
        self.status = Status.SEARCHING if prior.pose is None else Status.TRACKING
        self.images, self.since_search, self.last_ns, self.seen_ns, self.explained = 0, 0, 0, 0, 1.0
        self.said_ns: int | None = None
        self.problems: tuple[str, ...] = ()

    def step(self, frame: Frame) -> Estimate:
        """Take one frame, return where the robot stands at its time stamp."""
        clock = Stopwatch()
        seconds = self._seconds(frame.stamp_ns)
        self.hypotheses.predict(self._moved(frame), seconds)  # predict: the odometry carries every pose on
        frame = self.leaning.carried(frame, self._late_ns)  # roll and pitch at the image
        # observe: lines, crossings, landmarks
        observation = clock.perception(observe, frame, self.detector, self.max_range_m)
        points = self.features.points_of(observation)
        seen = seen_points(observation, points, optical_axis(self.setup.camera, frame))
        if _count(seen) >= MIN_SEEN:
            blind = self._is_blind(frame.stamp_ns)
            doubt = self._is_in_doubt()
            view = self.features.of(observation, self.known.state[3:5]) if doubt or self.tells_ends else None
            # search: every pose that explains them
            found = self._search(seen, view) if doubt and view is not None else []
            self.hypotheses.update(seen, found, self.known, FALLEN if blind else CARRIED_AWAY)  # register, fuse, weigh
            self.hypotheses.hear(frame.evidence, 1.0 / SAID_OFTEN)
            self._judge_end(frame, view, seconds)  # which end
        self._judge(seen, frame.stamp_ns)  # status
        self._say_undecided(frame.stamp_ns)
        self._judge_delay(frame)  # how late the stamps are
        count = len(points.positions_m) + len(observation.lines) + len(observation.points)
        return self._report(observation, count, clock)

    @property
    def _late_ns(self) -> int:
        return 0 if self.pans else round(1e9 * self.delay.late_s)

    def _moved(self, frame: Frame) -> Motion:
        """The odometry from when the last image was taken to when this one was."""
        before_ns = self.history.clocks.frame_ns
        self.history.add(frame)
        if before_ns is None:
            return Motion(Pose(0.0, 0.0, 0.0), np.zeros((3, 3)), 0.0)
        return self.history.between(before_ns - self._late_ns, frame.stamp_ns - self._late_ns)

    def _since_taken(self, stamp_ns: int) -> Pose:
        """The robot's motion from when the image was taken to its stamp."""
        if self._late_ns <= 0:
            return Pose(0.0, 0.0, 0.0)
        return self.history.between(stamp_ns - self._late_ns, stamp_ns).pose

    def _is_blind(self, stamp_ns: int) -> bool:
        """Whether nothing that the pose explains was seen for some time."""
        return 1e-9 * (stamp_ns - self.seen_ns) > BLIND_S

    def _seconds(self, stamp_ns: int) -> float:
        seconds = 1e-9 * max(stamp_ns - self.last_ns, 0) if self.last_ns else 0.0
        self.last_ns, self.problems = stamp_ns, ()
        self.seen_ns = self.seen_ns or stamp_ns
        return seconds

    def _is_in_doubt(self) -> bool:
        """Whether the whole field is searched in this frame."""
        self.since_search += 1
        best = self.hypotheses.best
        if best is None or best.fit is None or float(np.trace(best.filter.covariance[:2, :2])) > WIDE_M**2:
            return True
        poor = min(best.explained, self.explained) < USUAL
        return self.status is not Status.TRACKING or poor or self.since_search >= self.settings.search_every

    def _search(self, seen: SeenPoints, view: FeatureView) -> list[LeanFit]:
        """Poses that explain an image; on a symmetric field all of them at the end of the pose that is followed."""
        self.since_search = 0
        found = self.search.everywhere(seen, view, self.known.known)
        best = self.hypotheses.best
        if not self.symmetric:
            return [fit for fit in found if not self.own_half or best is not None or fit.state[0] <= 0.0]
        if best is None:
            return [_at_end(fit, fit.state[0] <= 0.0 or not self.own_half) for fit in found]
        heading = best.filter.pose.heading
        return [_at_end(fit, bool(np.cos(fit.state[2] - heading) >= 0.0)) for fit in found]

    def _judge_end(self, frame: Frame, view: FeatureView | None, seconds: float) -> None:
        """Which of the pose and its twin is right, by the colours of goals and poles and by what others say."""
        best = self.hypotheses.best
        if best is None:
            return
        jumped = best.filter.pose.distance_to(self.known.pose) > 1.0  # no slip: another pose has become the likeliest
        if jumped:
            self._tell_end(self.own_half and self.images == 0)
        self.known = best.filter
        if not self.symmetric:
            return
        if self.tells_ends and view is not None:
            self.twin.update(view, best.filter.pose)
        self.end.hear(frame.evidence, best.filter.pose, seconds)
        if self.end_log_odds <= -SURE:
            colours = ("the colours of goals and poles",) if self.twin.log_odds < 0.0 else ()
            who = " and ".join((*colours, *self.end.against))
            self.problems = (f"{who}: the robot is at the other end of the field",)
            self.told = 0.0  # what was told, was told wrongly
            self.twin.turn()
            self.end.turn()
            self.hypotheses.turn()
            self.known = best.filter

    @property
    def end_log_odds(self) -> float:
        """Of the pose, against its twin at the other end."""
        return self.told + self.evidence_of_end

    @property
    def end_probability(self) -> float:
        """That the pose's end is the right one."""
        return 1.0 / (1.0 + math.exp(-self.end_log_odds)) if self.symmetric else 1.0

    @property
    def evidence_of_end(self) -> float:
        """The same by what was seen and heard alone, without what a person told."""
        return self.twin.log_odds + sum(self.end.others.values())

    def _tell_end(self, told: bool) -> None:
        self.end.reset()
        self.twin.reset()
        self.told = TOLD if told else 0.0

    def _judge(self, seen: SeenPoints, stamp_ns: int) -> None:
        """Whether the pose is believed."""
        best = self.hypotheses.best
        if best is None:
            return
        if _count(seen) >= MIN_SEEN:
            memory = 1.0 if self.images == 0 or self._is_blind(stamp_ns) else MEMORY
            self.explained += memory * (best.explained - self.explained)
            self.images += 1
            if best.explained >= 0.5 * self.settings.min_explained:
                self.seen_ns = stamp_ns
        sure = self.hypotheses.probabilities[0] >= self.settings.min_probability and is_narrow(best.filter.covariance)
        sure = sure and self.explained >= self.settings.min_explained and not self._is_blind(stamp_ns)
        sure = sure and self.hypotheses.is_confirmed and not self.hypotheses.is_contested
        if sure and (not self.tells_ends or self.end_probability >= self.settings.min_probability):
            self.status = Status.TRACKING
        else:
            self.status = Status.LOST if self.explained < 0.5 * self.settings.min_explained else Status.SEARCHING

    def _say_undecided(self, stamp_ns: int) -> None:
        """Name the twin now and then while nothing that was seen or heard tells it from the pose."""
        decided = not self.symmetric or self.evidence_of_end >= SURE
        if decided or self.status is not Status.TRACKING:
            return
        if self.said_ns is None:  # where colours can tell they have ten seconds
            self.said_ns = stamp_ns if self.tells_ends else stamp_ns - round(1e9 * UNDECIDED_S)
        if 1e-9 * (stamp_ns - self.said_ns) >= UNDECIDED_S:
            self.said_ns = stamp_ns
            twin = 100.0 * (1.0 - self.end_probability)
            why = "as starts are told wrongly; nothing seen or heard tells" if self.told else "as nothing tells"
            self.problems += (f"undecided which end of the field it is: the other end has {twin:.0f} %, {why}",)

    def _judge_delay(self, frame: Frame) -> None:
        """How late images are stamped, by the lean that their lines tell. A head that pans was where it was at the
        stamp: what is late there can be told, and not corrected.
        """
        best = self.hypotheses.best
        if frame.image is None or best is None or best.fit is None or self.status is not Status.TRACKING:
            return
        if best.explained < self.settings.min_explained:
            return
        self.pans = frame.base_from_camera is not None
        lag_ns = round(1e9 * LAG_S) if self.pans else self._late_ns  # a head's pose holds the angles, which are late
        taken_ns = frame.stamp_ns - lag_ns
        turned = [self.leaning.turned(frame.stamp_ns - round(1e9 * late_s)) for late_s in LAGS_S]
        more_rad = best.fit.state[3:5] - best.filter.state[3:5]
        self.lean_delay.update(more_rad, np.array(turned) - self.leaning.turned(taken_ns))
        late = self.delay.update(self.lean_delay.late_s, self.lean_delay.deviation_s)
        if late is not None and self.pans:
            late = late.replace("corrected", "not corrected, for where the head was then is not told; at least so much")
        if late is not None:
            self.problems += (late,)

    def _filter_at(self, pose: Pose, covariance: FloatArray | None) -> PerspectiveFilter:
        told = self.settings.start_covariance if covariance is None else covariance
        return PerspectiveFilter(pose, told, self.settings.self_calibration)

    def _report(self, observation: Observation, count: int, clock: Stopwatch) -> Estimate:
        end = self.end_probability
        best, others = self.hypotheses.best, []
        ahead = self._since_taken(observation.stamp_ns)
        for one, share in zip(self.hypotheses.members, self.hypotheses.probabilities, strict=True):
            pose, covariance = one.filter.pose.compose(ahead), one.filter.covariance
            residual_m = float("nan") if one.fit is None else one.fit.residual_m
            if one is not best:
                others.append(Hypothesis(pose, residual_m, share * end, covariance))
            if end < 1.0:
                twin = mirrored_covariance(covariance)
                others.append(Hypothesis(pose.mirrored(), residual_m, share * (1.0 - end), twin))
        spread = UNKNOWN if best is None else best.filter.covariance
        return Estimate(
            observation.stamp_ns,
            Pose(0.0, 0.0, 0.0) if best is None else best.filter.pose.compose(ahead),
            spread if self.status is Status.TRACKING else spread + UNKNOWN,
            self.status,
            float("nan") if best is None or best.fit is None else best.fit.residual_m,
            count,
            tuple(others),
            None if best is None else self.hypotheses.probabilities[0] * end,
            clock.perception_ms,
            clock.localization_ms,
            observation,
            problems=self.problems,
        )


class TouchlineByObservation:
    """touchline of a robot whose own detector sees through a camera that nobody tells of.

    Line points are a mirror's until lines, crossings or landmarks come without any.
    """

    detector = None

    __repr__ = system_text

    def __init__(self, setup: RobotSetup, settings: TouchlineSettings, rng: np.random.Generator) -> None:
        self.setup = setup
        self._mirror = Touchline(setup, settings, rng)
        self._perspective = TouchlinePerspective(setup, settings, rng)
        self.reset()

    @property
    def history(self) -> MotionHistory:
        """What is remembered of the robot's motion."""
        return self.system.history

    def reset(self, prior: Prior | None = None) -> None:
        """Forget everything but the prior."""
        self._prior = as_prior(prior)
        self.system: Touchline | TouchlinePerspective = self._mirror
        self.system.reset(self._prior)

    def step(self, frame: Frame) -> Estimate:
        """Take one frame, return where the robot stands at its time stamp."""
        if self.system is self._mirror and _shows_features_alone(frame.observation):
            self.system = self._perspective
            self.system.reset(self._prior)
        return self.system.step(frame)


def optical_axis(camera: Camera | None, frame: Frame) -> FloatArray:
    """The optical axis (3,) of a perspective camera at a frame, robot frame; zeros where nothing tells."""
    if not isinstance(camera, PerspectiveCamera):
        return NO_AXIS
    lean = (None, None) if frame.tilt is None or not len(frame.tilt) else map(float, frame.tilt.values[-1])
    try:
        axis: FloatArray = ground_view(camera, frame.base_from_camera, *lean).pose.rotation[:, 0]
    except InputError:
        return NO_AXIS
    return axis


def touchline_system(
    setup: RobotSetup, settings: TouchlineSettings, rng: np.random.Generator
) -> Touchline | TouchlinePerspective | TouchlineByObservation:
    """touchline as the robot's camera asks for it: a mirror's, a perspective one, or one that nobody tells of."""
    if isinstance(setup.camera, PerspectiveCamera) or (setup.camera is None and setup.height_m is not None):
        return TouchlinePerspective(setup, settings, rng)
    return TouchlineByObservation(setup, settings, rng) if setup.camera is None else Touchline(setup, settings, rng)


def _shows_features_alone(seen: Observation | None) -> bool:
    """Whether an observation holds lines, crossings or landmarks, and no line points."""
    if not isinstance(seen, Observation) or len(seen.points):
        return False
    return bool(len(seen.lines) or len(seen.crossings) or len(seen.landmarks))


def _count(seen: SeenPoints) -> float:
    """How much an image shows: line points by their shares, crossings and landmarks."""
    return float(seen.shares.sum()) + len(seen.raw_m)


def _at_end(fit: LeanFit, as_found: bool) -> LeanFit:
    """A pose, or its twin."""
    if as_found:
        return fit
    turn = np.array([-1.0, -1.0, *np.ones(STATES - 2)])
    state = turn * fit.state
    state[2] += np.pi
    return fit._replace(state=state, information=fit.information * np.outer(turn, turn))
