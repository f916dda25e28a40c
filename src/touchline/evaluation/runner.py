"""One run: frames from a source through a system into a run folder, in constant memory."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from touchline.camera import PerspectiveCamera, is_perspective
from touchline.evaluation.latency import FrameTimes
from touchline.evaluation.run_folder import RunFolder
from touchline.evaluation.summary import UNFINISHED, BlackImages, EitherSide, RunSummary, SaidPhrase
from touchline.geometry import FloatArray, Pose
from touchline.messages import counted
from touchline.motion import FrameOrder, LeanFilter
from touchline.motion.compass import COMPASS_FALSE
from touchline.perception.covered import is_covered
from touchline.sources import Recording
from touchline.sources.description import NO_CAMERA
from touchline.systems import RobotSetup
from touchline.systems.ordered import OrderedSystem
from touchline.types import Estimate, Frame, Mode, Prior, Problem, Status, System
from touchline.types.estimate import UNCONFIRMED

_MAX_PICTURES, _MAX_THUMBNAILS = 6, 100
_MAX_SAID = 50  # problems of a system that are kept
_SAID_AGAIN_NS = 1_000_000_000  # later than this a problem begins a new stretch

OnFrame = Callable[[Frame, Estimate], None]
Particles = Callable[[], FloatArray | None]
"""A copy of a system's particles as they are now (N, 4): x, y (m), heading (rad), weight."""


class Thumbnail(NamedTuple):
    """A small picture of the run: the stamp of its frame and its JPEG file."""

    stamp_ns: int
    jpeg: bytes


def robot_setup(source: Recording) -> RobotSetup:
    """What a recording tells of its robot; without a camera where a detector of the robot's own sees.

    That is where sequence.yaml names none, and where observations.csv stands beside the images of a perspective camera:
    the systems for mirrors can take it then. Raises InputError for a camera or field that can't be read.
    """
    kind = source.camera_kind
    own_detector = kind == NO_CAMERA or (is_perspective(kind) and source.has_observations)
    if not own_detector:
        return RobotSetup(source.field, source.camera, source.wheel_directions_rad)
    height_m = None
    if source.camera_file is not None and isinstance(source.camera, PerspectiveCamera):
        height_m = float(source.camera.base_from_camera.translation_m[2])
    return RobotSetup(source.field, None, source.wheel_directions_rad, height_m)


@dataclass(frozen=True, eq=False, slots=True)
class KeptFrame:
    """A frame kept for the report: its place in the run, why it was kept, the image and what was made of it.

    lean: roll and pitch of the body (rad) at the image; None if nothing tells. particles: (N, 4) of that moment: x, y
    (m), heading (rad), weight; None if the system has none.
    """

    index: int
    reason: str
    frame: Frame
    estimate: Estimate
    lean: tuple[float, float] | None = None
    particles: FloatArray | None = None


@dataclass(eq=False, slots=True)
class Said:
    """A problem in successive images, as last said: its first and last stamp, and in how many images."""

    problem: Problem
    first_ns: int
    last_ns: int
    images: int = 1

    def in_seconds(self) -> SaidPhrase:
        """For summary.json."""
        first_s, last_s = self.first_ns / 1e9, self.last_ns / 1e9
        code, what = self.problem.code, self.problem.sentence
        return SaidPhrase(t=first_s, until=last_s, images=self.images, code=code, what=what)


class SaidLog:
    """What a system says: a problem goes on where its code is said again within a second."""

    def __init__(self) -> None:
        self.stretches: list[Said] = []

    def add(self, problem: Problem, stamp_ns: int) -> None:
        """A problem of an image. Of many stretches the first are kept."""
        last = next((one for one in reversed(self.stretches) if one.problem.code == problem.code), None)
        full = len(self.stretches) >= _MAX_SAID
        if last is not None and (full or stamp_ns - last.last_ns <= _SAID_AGAIN_NS):
            last.problem, last.last_ns, last.images = problem, max(stamp_ns, last.last_ns), last.images + 1
        elif not full:
            self.stretches.append(Said(problem, stamp_ns, stamp_ns))


def said_text(one: SaidPhrase) -> str:
    """A phrase with its time, in words."""
    many = f" to {one.until:.2f} s ({counted(one.images, 'image')})" if one.images > 1 else " s"
    return f"{one.t:.2f}{many}: {one.what}"


@dataclass(eq=False, slots=True)
class RunTally:
    """What is known of a run until now. ended: complete, interrupted, failed, or unfinished while it goes on.

    unseen: why nothing was seen in images, and in how many.
    either_side: located frames whose lines fit as well at the other end of the field; other_side: the last such pose,
    other_probability: its, where the system tells one. said: what the system said, and when.
    """

    ended: str = UNFINISHED
    failure: BaseException | None = None
    frames: int = 0
    first_ns: int | None = None
    last_ns: int | None = None
    wall_s: float = 0.0
    statuses: Counter[Status] = field(default_factory=Counter)
    modes: Counter[Mode] = field(default_factory=Counter)
    black_ns: list[tuple[int, int]] = field(default_factory=list)
    black: int = 0
    missing_images: int = 0
    unseen: Counter[str] = field(default_factory=Counter)
    late_frames: int = 0
    unconfirmed_frames: int = 0
    unmoved: int = 0  # images whose pose motion has not confirmed yet
    clock_set_back: int = 0
    either_side: int = 0
    other_side: Pose | None = None
    other_probability: float | None = None
    said: SaidLog = field(default_factory=SaidLog)
    times: FrameTimes = field(default_factory=FrameTimes)
    pictures: FramePicker | None = None

    def add(self, frame: Frame, estimate: Estimate, was_black: bool) -> None:
        """Count one frame; was_black: the frame before was black too, so its stretch goes on."""
        self.frames += 1
        self.first_ns = frame.stamp_ns if self.first_ns is None else self.first_ns
        self.last_ns = frame.stamp_ns
        self.statuses[estimate.status] += 1
        self.unmoved += estimate.reason == UNCONFIRMED
        if estimate.mode is not None:
            self.modes[estimate.mode] += 1
        if frame.image is not None and is_covered(frame.image):
            self.black += 1
            first_ns = self.black_ns.pop()[0] if was_black else frame.stamp_ns
            self.black_ns.append((first_ns, frame.stamp_ns))
        if frame.image is None and frame.observation is None:
            self.missing_images += 1
        if estimate.observation is not None and estimate.observation.problem is not None:
            self.unseen[estimate.observation.problem] += frame.image is not None
        if fits_other_side(estimate):
            self.either_side, self.other_side = self.either_side + 1, estimate.pose.mirrored()
            self.other_probability = estimate.twin_probability
        for problem in estimate.problems:
            self.said.add(problem, estimate.stamp_ns)
        self.times.add(estimate.perception_ms, estimate.localization_ms)

    def summary(self) -> RunSummary:
        """Counts, rates and latencies."""
        duration_s = 0.0 if self.first_ns is None or self.last_ns is None else (self.last_ns - self.first_ns) / 1e9
        return RunSummary(
            ended=self.ended,
            failure=None if self.failure is None else f"{type(self.failure).__name__}: {self.failure}",
            frames=self.frames,
            duration_s=round(duration_s, 6),
            recording_rate_hz=round((self.frames - 1) / duration_s, 4) if duration_s > 0 else None,
            rate_fps=round(self.frames / self.wall_s, 2) if self.wall_s > 0 else None,
            status={status.value: self.statuses[status] for status in Status},
            mode={mode.value: self.modes[mode] for mode in Mode} if self.modes else None,
            missing_images=self.missing_images,
            late_frames=self.late_frames,
            unconfirmed_frames=self.unconfirmed_frames,
            unmoved_frames=self.unmoved,
            clock_set_back=self.clock_set_back,
            black_images=BlackImages(count=self.black, stretches_ns=list(self.black_ns)),
            either_side=EitherSide(
                count=self.either_side, other_pose=self.other_side, probability=self.other_probability
            ),
            said=[one.in_seconds() for one in self.said.stretches],
            latency_ms=self.times.summary(),
        )


class FramePicker:
    """Keeps a handful of frames for the report: evenly spread over the run, and the worst-fitting tracked one.

    small: more of them without their images and particles, which are read again if a small picture is wanted.
    """

    def __init__(self, expected_frames: int, particles: Particles = lambda: None) -> None:
        self._particles, self._leaning = particles, LeanFilter()
        count = min(_MAX_PICTURES - 1, expected_frames)
        self._wanted = {round((i + 0.5) * expected_frames / count - 0.5) for i in range(count)}
        self._every = max(1, -(-expected_frames // _MAX_THUMBNAILS))
        self.small: list[KeptFrame] = []
        self._even: list[KeptFrame] = []
        self._worst: KeptFrame | None = None

    def consider(self, index: int, frame: Frame, estimate: Estimate) -> None:
        """Keep the frame if it is one of the chosen or fits worse than all before."""
        self._leaning.add(frame)
        if frame.image is None:
            return
        if index % self._every == 0 and len(self.small) < _MAX_THUMBNAILS:
            bare, lean = replace(frame, image=None), self._leaning.lean(frame.stamp_ns)
            self.small.append(KeptFrame(index, "evenly chosen", bare, estimate, lean))
        if index in self._wanted:
            self._even.append(self._keep(index, "evenly chosen", frame, estimate))
        worst = self._worst.estimate.residual_m if self._worst is not None else 0.0
        if estimate.status is Status.TRACKING and estimate.residual_m > worst:
            self._worst = self._keep(index, "largest residual", frame, estimate)

    def _keep(self, index: int, reason: str, frame: Frame, estimate: Estimate) -> KeptFrame:
        return KeptFrame(index, reason, frame, estimate, self._leaning.lean(frame.stamp_ns), self._particles())

    def kept(self) -> list[KeptFrame]:
        """The frames in the order of time, each once."""
        chosen = {kept.index: kept for kept in self._even}
        if self._worst is not None:
            chosen[self._worst.index] = self._worst
        return [chosen[index] for index in sorted(chosen)]


def run_frames(
    source: Recording,
    system: System,
    folder: RunFolder,
    *,
    prior: Prior | None = None,
    on_frame: Sequence[OnFrame] = (),
    stop: Callable[[], bool] = lambda: False,
    particles: Particles = lambda: None,
    pictures: bool = True,
) -> RunTally:
    """Step the system through all frames and write every estimate.

    prior: what the system has been reset with. A frame without image (`frame.problem` says why) goes to the system like
    any other. A frame that comes late by up to a second, or whose stamp jumps without that of the next one, is dropped
    and counted; where a clock was set back, what was written from there on is replaced. `stop` is asked after every
    frame; if it says so, the run ends as interrupted. pictures: whether frames are kept for those of the
    report; `particles` is asked at them. An exception of the system or the source ends the run as failed and is kept in
    the tally; what was done until then is in the folder.
    """
    tally = RunTally(pictures=FramePicker(len(source), particles) if pictures else None)
    start_s = time.perf_counter()
    try:
        tally.ended = _step_through(source, OrderedSystem(system, prior), folder, tally, on_frame, stop)
    except KeyboardInterrupt:
        tally.ended = "interrupted"
    except Exception as error:
        tally.ended, tally.failure = "failed", error
    tally.wall_s = time.perf_counter() - start_s
    return tally


def _step_through(
    frames: Iterable[Frame],
    system: OrderedSystem,
    folder: RunFolder,
    tally: RunTally,
    on_frame: Sequence[OnFrame],
    stop: Callable[[], bool],
) -> str:
    """Returns how the run ended: complete or interrupted."""
    started_s = time.perf_counter()
    was_black = False
    for index, frame in enumerate(frames):
        estimate = system.step(frame)
        if system.order is FrameOrder.LATE:
            tally.late_frames += 1
        elif system.order is FrameOrder.UNCONFIRMED:
            tally.unconfirmed_frames += 1
        else:
            if system.order is FrameOrder.CLOCK_SET_BACK:
                tally.clock_set_back += 1
                folder.forget_from(frame.stamp_ns)
            folder.write(estimate)
            black = tally.black
            tally.add(frame, estimate, was_black)
            was_black = tally.black > black
            if tally.pictures is not None:
                tally.pictures.consider(index, frame, estimate)
            for tell in on_frame:
                tell(frame, estimate)
        if folder.sync_is_due:
            tally.wall_s = time.perf_counter() - started_s
            folder.sync(tally.summary())
        if stop():
            return "interrupted"
    return "complete"


def fits_other_side(estimate: Estimate) -> bool:
    """Whether a located robot may as well stand at the other end of the field, as far as the system can tell: by more
    than a compass that was built in the wrong way round.
    """
    if estimate.status is not Status.TRACKING:
        return False
    return any(twin.probability is None or twin.probability > COMPASS_FALSE for twin in estimate.twins)
