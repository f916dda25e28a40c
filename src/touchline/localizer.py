"""The live loop: sensor threads bring samples, a camera thread images or points, whoever wants asks for the pose.

A robot in a match can't be stopped by a broken message: bad data is left out, counted in `problems` and told in the
next estimate. Only mistakes of the program itself (an unknown field, a start pose without numbers) raise.
"""

import copy
import html
import logging
import math
import operator
import threading
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from touchline.camera import Camera, open_camera
from touchline.config import Settings
from touchline.errors import InputError
from touchline.field import FieldModel, open_field
from touchline.geometry import FloatArray, Pose, Pose3, wrap_angle
from touchline.given import given_seed
from touchline.localization.estimator.game_states import game_prior
from touchline.motion import FrameOrder, MotionHistory
from touchline.motion.driven import EXACT_SCALES, driven
from touchline.systems import DEFAULT_SYSTEM, LocalizationSystem, RobotSetup, open_system
from touchline.systems.ordered import OrderedSystem
from touchline.types import (
    MAX_VALUE,
    Estimate,
    Evidence,
    Frame,
    GameState,
    ImageArray,
    LinePoints,
    Observation,
    Prior,
    Problem,
    ProblemCode,
    Samples,
    Status,
    points_at,
)

_SENSORS = {"odometry": 3, "wheels": 2, "gyro": 3, "compass": 1, "attitude": 2}
_MAX_SAMPLES = 20_000  # of one sensor that wait for an image: 20 s of an IMU at 1 kHz
_STATE_NS = 500_000  # between poses of the odometry and other states that are kept
_MAX_EVIDENCE, _MAX_OF_SOURCE = 100, 4  # that wait for an image: of all, and of one source
_MAX_STAMP_NS = 2**62
_PREDICTED_NS = 1_000_000_000  # a pose carried on for longer is a guess: odometry may have slipped
_MISSING_S = 0.5
_PROTECTION_SIGMAS = 6.0  # that a protection level holds of a motion's standard deviation
_NO_IMAGE, _NO_STAMP = "no image has been localised yet", "the stamp is no whole number of nanoseconds"
_SEEN = {"points": "point", "lines": "line", "crossings": "crossing", "landmarks": "landmark"}
_ODD_ORDERS = {
    FrameOrder.LATE: (ProblemCode.IMAGE_OLD, "image: older than the one before, left out"),
    FrameOrder.UNCONFIRMED: (
        ProblemCode.IMAGE_FAR,
        "image: stamped far from the one before, left out unless the next one is there, too",
    ),
    FrameOrder.CLOCK_SET_BACK: (
        ProblemCode.IMAGE_CLOCK,
        "image: more than a second older than the last ones: the clock was set back",
    ),
}

_Said = TypeVar("_Said")
_log = logging.getLogger(__name__)


class Localizer:
    """Tells a robot where it stands while it plays.

    `add_*` may be called by as many threads as there are sensors and never waits for `localize`; `pose` neither. All
    stamps are integer nanoseconds of one clock; units are metres, radians, radians per second.
    """

    def __init__(
        self,
        field: str | Path | FieldModel,
        camera: str | Path | Camera | None = None,
        system: str = DEFAULT_SYSTEM,
        wheels: tuple[float, float] | None = None,
        settings: Settings | Mapping[str, Any] | None = None,
        seed: int = 0,
    ) -> None:
        """field: a preset's name, the path of a field.yaml, or a model. camera: the path of a camera.yaml or a model;
        None if `localize` is given points or observations. wheels: rolling directions (rad, robot frame) of the
        measuring wheels a and b. settings: of the system, or only what differs, as {"matching.c_m": 0.3}.
        seed: same seed and same data, same estimates.

        Raises InputError for whatever of these is wrong.
        """
        self.field = open_field(field)
        self.camera = None if camera is None else open_camera(camera)
        setup = RobotSetup(self.field, self.camera, wheels)
        self._max_range_m = setup.max_range_m
        self._open: Callable[[Camera | None], LocalizationSystem] = lambda seen_by: open_system(
            system, replace(setup, camera=seen_by), settings, given_seed(seed)
        )
        made = self._open(self.camera)
        made.reset()
        self.system = made
        """What localises: its particles, its settings. Only `localize` may step it."""
        self.frame: Frame | None = None
        """The frame localised last, with the samples that came since the one before; None before the first."""
        self._system = OrderedSystem(made)
        self._history = made.history
        self._counts = _Counts()
        self._pending = _Queue()
        self._said: deque[Evidence] = deque(maxlen=_MAX_EVIDENCE)
        self._messages: dict[str, int] = {}  # the newest one of each of the others
        self._states: deque[GameState] = deque(maxlen=_MAX_EVIDENCE)
        self._stepping = threading.Lock()
        # A second history of the same samples predicts poses between images, so that the system's own is left alone.
        self._ahead = copy.deepcopy(made.history)
        self._ahead_pending = _Queue()
        self._predicting = threading.Lock()
        self._prior = Prior()
        self._prior_at: Callable[[Frame], Prior | None] | None = None
        self._last: Estimate | None = None

    def __repr__(self) -> str:
        return f"Localizer({self.system!r}: {self._last or 'no image yet'})"

    def _repr_html_(self) -> str:
        """The field with the last estimate on it."""
        last = self._last
        if last is None:
            return f"<p>{html.escape(repr(self))}</p>{self.field.svg()}"
        return last.html(self.field.svg(marks=last.svg_marks()))

    def add_odometry(self, stamp_ns: int, x: float, y: float, theta: float) -> None:
        """Dead reckoning: the pose in the odometry frame (m, m, rad)."""
        self._add("odometry", stamp_ns, x, y, theta)

    def add_wheels(self, stamp_ns: int, a: float, b: float) -> None:
        """Travel so far of the two measuring wheels (m)."""
        self._add("wheels", stamp_ns, a, b)

    def add_gyro(self, stamp_ns: int, gx: float, gy: float, gz: float) -> None:
        """Turning rates (rad/s)."""
        self._add("gyro", stamp_ns, gx, gy, gz)

    def add_compass(self, stamp_ns: int, yaw: float) -> None:
        """Heading in the field frame (rad): 0 points at the opponent goal."""
        self._add("compass", stamp_ns, yaw)

    def add_attitude(self, stamp_ns: int, roll: float, pitch: float) -> None:
        """Lean of the body (rad): positive pitch tips the nose down, positive roll lowers the right side."""
        self._add("attitude", stamp_ns, roll, pitch)

    def add_evidence(self, source: str, probability: float = 0.9, **says: Any) -> None:
        """What somebody else says of where the robot stands, for the next image: a team mate, the ball, a colour.

        source: who says it. probability: that it is true. says: own_half (True or False); or place_m (x, y, field
        frame) of the robot, or of what it sees at seen_m (x, y, robot frame), give or take spread_m; see `Evidence`.
        Systems that follow both ends of the field weigh it: who is alone turns no pose at once, nor against a compass.
        known: whether it is sure who says it; what all others say counts as one voice. message: its number, where a
        repeated one shall count once.
        """
        try:
            said = Evidence(str(source), probability, **says)
        except (InputError, TypeError):
            self._counts.add(ProblemCode.EVIDENCE_UNUSABLE, "evidence: is none, left out")
            return
        waiting = list(self._said)
        if said.message is not None and self._messages.get(said.source) == said.message:
            return
        if said.message is not None and (said.source in self._messages or len(self._messages) < _MAX_EVIDENCE):
            self._messages[said.source] = said.message
        same = [one for one in waiting if one.source == said.source]
        old = same if len(same) >= _MAX_OF_SOURCE else [one for one in waiting if not one.known and said.known]
        if len(same) >= _MAX_OF_SOURCE or len(waiting) >= _MAX_EVIDENCE:
            self._counts.add(
                ProblemCode.EVIDENCE_UNUSABLE, "evidence: more than can be taken until the next image, left out"
            )
            if not old:
                return
            with suppress(ValueError):  # the next image has just taken it
                self._said.remove(old[0])
        self._said.append(said)

    def add_game_state(self, stamp_ns: int, phase: str, penalty: str = "", first_half: bool = True) -> None:
        """What the referee says, for the next image: initial, ready, set, playing or finished; this robot's penalty in
        words, empty without one; whether it is the first half. Repeat it as often as it is said: changes count.

        A prior, never a condition: the own half at kick-off; after a penalty either touch line, or where it stood.
        Systems but touchline leave it aside.
        """
        stamp = self._stamp("game state", stamp_ns)
        try:
            said = GameState(stamp or 0, phase, str(penalty), bool(first_half))
        except InputError:
            self._counts.add(ProblemCode.GAME_STATE_UNUSABLE, "game state: is none, left out")
            return
        self._states.append(said)

    def use_camera(self, camera: Camera) -> None:
        """See with this camera from now on, as a robot describes it itself; localization starts anew where it was.

        Raises InputError where the system takes none such.
        """
        made = self._open(camera)
        with self._stepping, self._predicting:
            made.reset(self._prior)
            self.camera, self.system = camera, made
            self._max_range_m = RobotSetup(self.field, camera).max_range_m
            self._system, self._history = OrderedSystem(made, self._prior), made.history
            self._ahead, self._last = copy.deepcopy(made.history), None

    @property
    def samples_come(self) -> int:
        """So many samples of sensors have come until now."""
        return self._pending.come

    def localize(
        self,
        stamp_ns: int,
        image: ImageArray | None = None,
        points: FloatArray | Sequence[Sequence[float]] | LinePoints | None = None,
        observation: Observation | None = None,
        base_from_camera: Pose3 | None = None,
        samples: int | None = None,
    ) -> Estimate:
        """Where the robot stood when an image was taken, by the image and all samples that have come until now.

        image: uint8 (H, W, 3), BGR. points: on lines, (N, 2) in the robot frame (m), or with covariances. observation:
        all that a detector of the robot's own found. Of several that are given, an observation is taken before points,
        and points before an image. base_from_camera: the pose of the camera body in the base frame, of a head that
        moves. samples: of an image that has waited, the `samples_come` of when it came; later ones are for the next.

        An image up to a second older than the newest is left out: the last estimate is returned, searching. So is one
        that is older still or far ahead, until the next image confirms it. If that is older, too, the clock was set
        back: localization starts anew with the last pose as prior.
        """
        with self._stepping:
            last = self._last
            stamp = self._stamp("image", stamp_ns)
            if stamp is None:
                return self._finished((last or self._unknown(0)).unconfirmed(_NO_STAMP))
            self.frame = Frame(
                stamp,
                image=self._usable_image(image, points is not None or observation is not None),
                observation=self._usable_observation(stamp, points, observation),
                base_from_camera=self._usable_camera_pose(base_from_camera),
                problem=None if image is None else "the image can't be used",
                evidence=_taken(self._said),
                game=_taken(self._states),
                **_by_field(self._pending.take(samples)),
            )
            self._go_on(self.frame)
            return self._finished(self._step(self.frame))

    def pose(self, stamp_ns: int) -> Estimate:
        """The last estimate carried on (or back, by up to the seconds that are remembered) to another time.

        By odometry or wheels and gyro, with what the system has learned of them; the next image's estimate does not
        depend on it. Carried on for more than a second, or where motion was not measured, it is searching.
        """
        with self._predicting:
            last = self._last
            stamp = self._stamp("pose", stamp_ns)
            if last is None or stamp is None:
                return (last or self._unknown(stamp or 0)).unconfirmed(_NO_IMAGE if last is None else _NO_STAMP)
            for sensor, samples in self._ahead_pending.take().items():
                self._ahead.add_samples(sensor, samples)
            return _carried(last, self._ahead, stamp)

    def reset(
        self,
        pose: Sequence[float] | None = None,
        covariance: FloatArray | Sequence[Sequence[float]] | None = None,
        own_half: bool = False,
        state: str | None = None,
    ) -> None:
        """Forget where the robot was. pose: x, y, theta (m, m, rad; field frame) where it stands now, with its
        covariance (3, 3) if known; own_half: all that is known is that x < 0; or the state of the game, by name:
        kick-off, walk-in, penalty shot, penalty keeper, fallen, picked up; or penalised, back from a penalty, which
        join what is believed instead of replacing it. Waits for a `localize` under way.

        Raises InputError for what is no pose, no covariance or no state, and for more than one of them.
        """
        prior = _prior(pose, covariance, own_half)
        if state is not None and prior != Prior():
            raise InputError("give a pose, the own half or the state of the game, one of them")
        with self._stepping, self._predicting:
            if state is not None:
                last = Prior() if self._last is None else Prior(self._last.pose, covariance=self._last.covariance)
                prior = game_prior(state, self.field, last)
            self._system.reset(prior)
            if not prior.kept:
                self._ahead.clear()
                self._prior, self._last, self._prior_at = prior, None, None

    @property
    def camera_errors(self) -> list[list[float]] | None:
        """What the system has learned of how the camera differs from camera.yaml: the errors (K,) and, below, their
        covariance (K, K), for `resume`; None where it learns nothing.
        """
        learned = getattr(self.system, "camera_errors", None)
        return None if learned is None else [learned[0].tolist(), *learned[1].tolist()]

    def resume(
        self, prior_at: Callable[[Frame], Prior | None], camera_errors: Sequence[Sequence[float]] | None = None
    ) -> None:
        """Start where the robot was before its program ended, and with what was learned of the camera. prior_at: asked
        at every image, until `reset`, where it may stand by then: weighted poses; None: nothing new.

        Raises InputError for errors of another camera. Systems but touchline take the likeliest pose alone.
        """
        with self._stepping:
            recall = getattr(self.system, "recall_camera", None)
            if recall is not None and camera_errors:
                recall(np.array(camera_errors[0], dtype=np.float64), np.array(camera_errors[1:], dtype=np.float64))
            self._prior_at = prior_at

    def _go_on(self, frame: Frame) -> None:
        """Take what is known of where the robot stands since its program ended."""
        prior = None if self._prior_at is None else self._prior_at(frame)
        if prior is None:
            return
        if prior.poses and not hasattr(self.system, "recall_camera"):
            best = max(prior.poses, key=lambda one: one.weight)
            prior = Prior(best.pose, covariance=best.covariance)
        with self._predicting:
            self._system.reset(prior)
            self._ahead.clear()
            self._prior, self._last = prior, None

    @property
    def problems(self) -> dict[Problem, int]:
        """What was wrong with the robot's data so far, and how often."""
        return dict(self._counts.so_far())

    def _add(self, sensor: str, stamp_ns: int, *values: float) -> None:
        stamp = self._stamp(sensor, stamp_ns)
        if stamp is None:
            return
        try:
            row = tuple(map(float, values))
        except (TypeError, ValueError, OverflowError):
            row = (math.nan,)
        if not all(abs(value) < MAX_VALUE for value in row):  # False for NaN
            self._counts.add(ProblemCode.SAMPLE_UNUSABLE, f"{sensor}: a sample that is no measurement, left out")
            return
        self._pending.put(sensor, stamp, row)
        self._ahead_pending.put(sensor, stamp, row)

    def _stamp(self, what: str, stamp_ns: int) -> int | None:
        """The stamp as an integer; None, and counted, if it is none."""
        try:
            stamp = operator.index(stamp_ns)
        except TypeError:
            stamp = _MAX_STAMP_NS
        if abs(stamp) < _MAX_STAMP_NS:
            return stamp
        self._counts.add(
            ProblemCode.STAMP_UNUSABLE, f"{what}: a stamp that is no whole number of nanoseconds, left out"
        )
        return None

    def _usable_image(self, image: ImageArray | None, may_be_missing: bool) -> ImageArray | None:
        if image is None:
            if not may_be_missing:
                self._counts.add(ProblemCode.IMAGE_MISSING, "image: neither image nor points were given")
            return None
        if self.camera is None:
            if not may_be_missing:
                self._counts.add(
                    ProblemCode.CAMERA_MISSING,
                    "image: no camera model was given, nor came as CameraInfo and transforms",
                )
            return None
        wanted = (self.camera.height, self.camera.width, 3)
        if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.shape != wanted:
            self._counts.add(
                ProblemCode.IMAGE_SHAPE, f"image: is no uint8 array of shape {wanted}, as the camera model has it"
            )
            return None
        return np.ascontiguousarray(image)

    def _usable_observation(
        self,
        stamp_ns: int,
        points: FloatArray | Sequence[Sequence[float]] | LinePoints | None,
        observation: Observation | None,
    ) -> Observation | None:
        if observation is None and points is None:
            return None
        if not isinstance(observation, Observation | None):
            self._counts.add(ProblemCode.OBSERVATION_UNUSABLE, "observation: is no Observation")
            return Observation(stamp_ns, problem="what was given is no observation")
        given = points if observation is None else observation.points
        try:
            known = _as_floats(given) if isinstance(given, LinePoints) else points_at(_pairs(given))
        except (TypeError, ValueError):
            self._counts.add(ProblemCode.OBSERVATION_UNUSABLE, "points: are no array (N, 2) of numbers")
            return Observation(stamp_ns, problem="the points can't be used")
        if observation is None:
            return self._measured(Observation(stamp_ns, known))
        return self._measured(replace(observation, stamp_ns=stamp_ns, points=known))

    def _measured(self, seen: Observation) -> Observation:
        """What of an observation is a measurement; the rest is counted."""
        usable = seen.usable(self._max_range_m)
        if usable is seen:
            return seen
        for kind, one in _SEEN.items():
            if lost := len(getattr(seen, kind)) - len(getattr(usable, kind)):
                self._counts.add(
                    ProblemCode.OBSERVATION_UNUSABLE, f"{kind}: a {one} that is no measurement, left out", lost
                )
        return usable

    def _usable_camera_pose(self, pose: Pose3 | None) -> Pose3 | None:
        if pose is None:
            return None
        if isinstance(pose, Pose3) and np.isfinite(pose.rotation).all() and np.isfinite(pose.translation_m).all():
            return pose
        self._counts.add(ProblemCode.CAMERA_POSE_UNUSABLE, "base_from_camera: is no pose, left out")
        return None

    def _step(self, frame: Frame) -> Estimate:
        """The system's estimate; what no check has foreseen ends in a new start, not in the robot's program."""
        try:
            estimate = self._system.step(frame)
        except Exception as error:
            _log.exception("localization failed and starts anew")
            self._counts.add(
                ProblemCode.LOCALIZATION_FAILED, f"localization: failed by {type(error).__name__} and started again"
            )
            self._system.reset(Prior(self._last.pose) if self._last is not None else self._prior)
            estimate = replace(self._last or self._unknown(frame.stamp_ns), stamp_ns=frame.stamp_ns)
            estimate = estimate.unconfirmed(f"localization failed by {type(error).__name__} and started again")
        order = self._system.order
        if order in _ODD_ORDERS:
            self._counts.add(*_ODD_ORDERS[order])
        if order in (FrameOrder.LATE, FrameOrder.UNCONFIRMED):
            return estimate
        self._count_samples()
        with self._predicting:
            if self._last is not None and frame.stamp_ns < self._last.stamp_ns:
                self._ahead.clear()
            self._ahead.add(Frame(frame.stamp_ns, **_by_field(self._ahead_pending.take())))
            self._last = estimate
        return estimate

    def _count_samples(self) -> None:
        """What the motion history left out."""
        old = self._history.dropped, ProblemCode.SAMPLE_OLD, "that was not newer than the one before, left out"
        ahead = self._history.refused, ProblemCode.SAMPLE_AHEAD, "stamped far ahead of everything else, refused"
        for counts, code, what in (old, ahead):
            for sensor, count in counts.items():
                if count:
                    self._counts.reach(code, f"{sensor}: a sample {what}", count)

    def _finished(self, estimate: Estimate) -> Estimate:
        """The estimate, with what was wrong since the one before."""
        new = self._counts.new()
        if not new:
            return estimate
        many = {one: "" if count == 1 else f" ({count} times)" for one, count in new.items()}
        problems = (Problem(one.code, one.sentence + times) for one, times in many.items())
        return replace(estimate, problems=(*estimate.problems, *problems))

    def _unknown(self, stamp_ns: int) -> Estimate:
        """Before the first image: what `reset` was told, or nothing."""
        anywhere = np.diag([0.5 * self.field.length, 0.5 * self.field.width, math.pi]) ** 2
        known = self._prior.covariance
        pose = self._prior.pose or Pose(0.0, 0.0, 0.0)
        return Estimate(stamp_ns, pose, anywhere if known is None else known, Status.SEARCHING, reason=_NO_IMAGE)


def _taken(waiting: deque[_Said]) -> tuple[_Said, ...]:
    """What was said since the last image."""
    return tuple(waiting.popleft() for _ in range(len(waiting)))


class _Queue:
    """Samples by sensor on their way from one thread to another. The lock is held for a moment only."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._rows = {sensor: deque[tuple[int, int, tuple[float, ...]]](maxlen=_MAX_SAMPLES) for sensor in _SENSORS}
        self.come = 0

    def put(self, sensor: str, stamp_ns: int, row: tuple[float, ...]) -> None:
        """Add a sample. Of states that come more often than anybody needs, the newest takes the place of the last."""
        with self._lock:
            self.come += 1
            waiting = self._rows[sensor]
            if len(waiting) > 1 and sensor != "gyro":
                before_ns, last_ns = waiting[-2][1], waiting[-1][1]
                if before_ns < last_ns < stamp_ns < before_ns + _STATE_NS:
                    waiting.pop()
            waiting.append((self.come, stamp_ns, row))

    def take(self, until: int | None = None) -> dict[str, Samples]:
        """What waits, by sensor: all, or the first so many that have ever come."""
        found: dict[str, Samples] = {}
        with self._lock:
            for sensor, waiting in self._rows.items():
                count = len(waiting) if until is None else sum(come <= until for come, _, _ in waiting)
                taken = [waiting.popleft() for _ in range(count)]
                if taken:
                    stamps = np.array([stamp_ns for _, stamp_ns, _ in taken], dtype=np.int64)
                    rows = np.array([row for _, _, row in taken], dtype=np.float64)
                    found[sensor] = Samples(stamps, rows.reshape(-1, _SENSORS[sensor]))
        return found


class _Counts:
    """How often what was wrong; counted by any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._counts: Counter[Problem] = Counter()
        self._told: Counter[Problem] = Counter()
        self._changed = False

    def add(self, code: str, what: str, count: int = 1) -> None:
        with self._lock:
            self._counts[Problem(code, what)] += count
            self._changed = True

    def reach(self, code: str, what: str, count: int) -> None:
        """It has happened so often by now."""
        problem = Problem(code, what)
        with self._lock:
            self._changed = self._changed or count > self._counts[problem]
            self._counts[problem] = max(self._counts[problem], count)

    def new(self) -> Counter[Problem]:
        """Since this was asked last."""
        if not self._changed:
            return Counter()
        with self._lock:
            new, self._told, self._changed = self._counts - self._told, Counter(self._counts), False
        return new

    def so_far(self) -> Counter[Problem]:
        with self._lock:
            return Counter(self._counts)


def _by_field(taken: Mapping[str, Samples]) -> dict[str, Any]:
    """Samples by sensor, named as a frame names them."""
    return {"tilt" if sensor == "attitude" else sensor: samples for sensor, samples in taken.items()}


def _carried(last: Estimate, history: MotionHistory, stamp_ns: int) -> Estimate:
    """An estimate at another time, by the motion in between."""
    backwards = stamp_ns < last.stamp_ns
    motion = history.between(min(stamp_ns, last.stamp_ns), max(stamp_ns, last.stamp_ns))
    step, covariance = motion.pose, motion.covariance
    if last.odometry is not None:
        step, more = last.odometry.corrected(step)
        covariance = covariance + more
    if backwards:
        step = step.inverse()
        c, s = math.cos(step.heading), math.sin(step.heading)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        covariance = turn @ covariance @ turn.T
    carried = driven(last.pose, EXACT_SCALES, step)
    added = carried.by_motion @ covariance @ carried.by_motion.T
    protection_m, protection_rad = _carried_protection(last, step, added)
    estimate = Estimate(
        stamp_ns,
        carried.pose,
        carried.by_pose @ last.covariance @ carried.by_pose.T + added,
        last.status,
        hypotheses=tuple(replace(other, pose=other.pose.compose(step)) for other in last.hypotheses),
        probability=last.probability,
        mode=last.mode,
        odometry=last.odometry,
        protection_m=protection_m,
        protection_rad=protection_rad,
        reason=last.reason,
        end_probability=last.end_probability,
        statistics=last.statistics,
        gaze=last.gaze,
    )
    if abs(stamp_ns - last.stamp_ns) > _PREDICTED_NS:
        return estimate.unconfirmed(f"the last image is more than {_PREDICTED_NS / 1e9:g} s away")
    return estimate.unconfirmed("motion was not measured") if motion.missing_s > _MISSING_S else estimate


def _carried_protection(last: Estimate, step: Pose, added: FloatArray) -> tuple[float | None, float | None]:
    """Protection levels after a motion, whose covariance (3, 3) is added: the heading's turns the way into an error."""
    if last.protection_m is None or last.protection_rad is None:
        return None, None
    more_m = _PROTECTION_SIGMAS * math.sqrt(max(np.linalg.eigvalsh(added[:2, :2])[-1], 0.0))
    turned_m = math.hypot(step.x, step.y) * last.protection_rad
    more_rad = _PROTECTION_SIGMAS * math.sqrt(added[2, 2])
    return math.hypot(last.protection_m + turned_m, more_m), math.hypot(last.protection_rad, more_rad)


def _as_floats(points: LinePoints) -> LinePoints:
    """The points as the compiled loops take them, float64. Raises ValueError or TypeError for what is no number."""
    arrays = (points.positions_m, points.covariances_m2, points.confidences, points.pixels)
    if all(array.dtype == np.float64 for array in arrays):
        return points
    return LinePoints(*(np.asarray(array, dtype=np.float64) for array in arrays))


def _pairs(points: FloatArray | Sequence[Sequence[float]] | None) -> FloatArray:
    """(N, 2); no points may come as an empty list. Raises ValueError or TypeError for what is none."""
    array = np.asarray(points, dtype=np.float64)
    array = array.reshape(0, 2) if array.size == 0 else array
    if array.ndim != 2 or array.shape[1] != 2:
        raise ValueError(f"points need the shape (N, 2), got {array.shape}")
    return array


def _prior(
    pose: Sequence[float] | None, covariance: FloatArray | Sequence[Sequence[float]] | None, own_half: bool
) -> Prior:
    """Raises InputError for what is no prior."""
    placed = None
    if pose is not None:
        try:
            x, y, heading = map(float, pose)
        except (TypeError, ValueError):
            raise InputError(f"pose: expected (x, y, theta) in m, m, rad, got {pose!r}") from None
        placed = Pose(x, y, wrap_angle(heading) if math.isfinite(heading) else heading)
    try:
        known = None if covariance is None else np.asarray(covariance, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError("covariance: expected (3, 3) numbers of x, y, heading in (m, m, rad)") from None
    return Prior(placed, own_half, known)
