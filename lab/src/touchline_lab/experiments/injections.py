"""Faults of sensors and what happens to a robot, laid into its drive: motion, compass, clock, sight, carrying, falls.

A change makes another drive of one: of the frames that are marked as wrong, and of nothing else. What is seen instead
or besides is in clutter.py, which faults there are in catalogue.py.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from touchline.camera import PinholeCamera
from touchline.field import open_field
from touchline.geometry import BoolArray, FloatArray, Pose, Pose3, wrap_angles
from touchline.localization.camera_errors import camera_errors
from touchline.localization.camera_errors.base import placed_points
from touchline.systems.ordered import with_samples_of
from touchline.types import Frame, Observation, Prior, Samples
from touchline_lab.experiments.drives import Drive
from touchline_lab.simulation.observation.features import turned

SLIP_S = 0.15
FALL_S = 5.0  # on the ground and getting up: nothing is seen
FALLEN_M, FALLEN_RAD = 0.4, math.radians(40.0)  # by which it lies elsewhere, unfelt
LYING_RAD = 1.2  # pitch of a robot that lies on its face
ANOTHER_CLOCK_S = 1.0  # stamps farther off than this are of another time: the pose that they ask for is the image's
ROUNDING_S = 1e-6
SENSORS = ("odometry", "wheels", "gyro", "compass", "tilt")
Random: TypeAlias = np.random.Generator
Change: TypeAlias = Callable[[Drive, BoolArray, Random], Drive]
Edit: TypeAlias = Callable[[FloatArray, FloatArray], FloatArray]  # of times (N,) in s and values (N, K), other values


class Fault(NamedTuple):
    """What is wrong from start_s until before end_s."""

    name: str
    start_s: float
    end_s: float
    change: Change

    def laid_into(self, drive: Drive, rng: Random) -> Drive:
        """The drive with the fault in it."""
        wrong = (drive.times_s >= self.start_s) & (drive.times_s < self.end_s)
        return self.change(drive, wrong, rng) if wrong.any() else drive


def both(*changes: Change) -> Change:
    """One change after the other."""

    def change(drive: Drive, wrong: BoolArray, rng: Random) -> Drive:
        for each in changes:
            drive = each(drive, wrong, rng)
        return drive

    return change


def during(begin: float, end: float, change: Change) -> Change:
    """A change in a part of the wrong frames: from a share of them to another."""

    def part(drive: Drive, wrong: BoolArray, rng: Random) -> Drive:
        count = np.cumsum(wrong) / wrong.sum()
        kept = wrong & (count > begin) & (count <= end)
        return change(drive, kept, rng) if kept.any() else drive

    return part


def framed(drive: Drive, wrong: BoolArray, change: Callable[[int, Frame], Frame]) -> Drive:
    """A drive whose wrong frames are others."""
    frames = [change(k, frame) if wrong[k] else frame for k, frame in enumerate(drive.frames)]
    return replace(drive, frames=frames)


def seen_as(drive: Drive, change: Callable[[Frame, Observation], Observation], wrong: BoolArray | None = None) -> Drive:
    """A drive whose observations are others, by default all of them."""

    def changed(_: int, frame: Frame) -> Frame:
        return frame if frame.observation is None else replace(frame, observation=change(frame, frame.observation))

    return framed(drive, np.ones(len(drive.frames), np.bool_) if wrong is None else wrong, changed)


def logged(change: Callable[[Samples], Samples | None], *sensors: str) -> Change:
    """Other samples of sensors, frame by frame."""

    def changed(_: int, frame: Frame) -> Frame:
        logs = {name: log for name in sensors if (log := getattr(frame, name)) is not None}
        return replace(frame, **{name: change(log) for name, log in logs.items()})  # type: ignore[arg-type]

    return lambda drive, wrong, rng: framed(drive, wrong, changed)


def negated(log: Samples) -> Samples:
    """With the other sign."""
    return Samples(log.stamp_ns, -log.values)


# --- odometry, and the measuring wheels with it -----------------------------------------------------------------------


def with_samples(drive: Drive, name: str, edit: Edit) -> Drive:
    """A drive in which the samples of a sensor (`odometry`, `wheels`, `gyro`), all in one log, tell otherwise."""
    logs: list[Samples | None] = [getattr(frame, name) for frame in drive.frames]
    known = [log for log in logs if log is not None]
    if not known:
        return drive
    values = edit(1e-9 * np.concatenate([log.stamp_ns for log in known]), np.concatenate([log.values for log in known]))
    parts = iter(np.split(values, np.cumsum([len(log) for log in known])[:-1]))
    changes: list[dict[str, Any]] = [{} if log is None else {name: Samples(log.stamp_ns, next(parts))} for log in logs]
    return replace(drive, frames=[replace(f, **change) for f, change in zip(drive.frames, changes, strict=True)])


def with_steps(drive: Drive, edit: Edit) -> Drive:
    """A drive whose odometry goes by other steps up to each sample (N, 3), robot frame, the first of which is none."""

    def poses_of(times_s: FloatArray, poses: FloatArray) -> FloatArray:
        poses = np.column_stack((poses[:, :2], np.unwrap(poses[:, 2])))
        steps = np.diff(poses, axis=0, prepend=poses[:1])
        steps[1:, :2] = _turned(steps[1:, :2], -poses[:-1, 2])
        moved = edit(times_s, steps)
        moved[:, 2] = poses[0, 2] + np.cumsum(moved[:, 2])
        moved[1:, :2] = _turned(moved[1:, :2], moved[:-1, 2])
        moved[:, :2] = poses[0, :2] + np.cumsum(moved[:, :2], axis=0)
        return moved

    return with_samples(drive, "odometry", poses_of)


def with_rolling(drive: Drive, edit: Edit) -> Drive:
    """A drive whose measuring wheels roll otherwise up to each sample (N, 2), the first of which is none."""
    return with_samples(
        drive, "wheels", lambda at_s, sums: sums[0] + np.cumsum(edit(at_s, np.diff(sums, axis=0, prepend=sums[:1])), 0)
    )


def _turned(vectors: FloatArray, angles_rad: FloatArray) -> FloatArray:
    """Vectors (N, 2), each turned by its angle (N,)."""
    cosine, sine = np.cos(angles_rad), np.sin(angles_rad)
    x, y = vectors.T
    return np.column_stack((cosine * x - sine * y, sine * x + cosine * y))


def odometry(factors: tuple[float, float, float], rates: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Change:
    """Each step ahead, aside and in turn is told as so many times the true one, plus `rates` (m/s, rad/s).

    The measuring wheels tell the same of the way ahead; the gyro is right.
    """

    def change(drive: Drive, wrong: BoolArray, rng: Random) -> Drive:
        times_s = np.append(drive.times_s, math.inf)
        first, last = np.flatnonzero(wrong)[[0, -1]].tolist()
        start_s, end_s = times_s[first] if first else -math.inf, times_s[last + 1]

        def changed(factor: object, rate: object, at_s: FloatArray, moved: FloatArray) -> FloatArray:
            marked = ((at_s > start_s - ROUNDING_S) & (at_s < end_s - ROUNDING_S))[:, np.newaxis]
            passed_s = np.diff(at_s, prepend=at_s[:1])[:, np.newaxis]
            return np.asarray(np.where(marked, np.array(factor) * moved + np.array(rate) * passed_s, moved))

        return with_rolling(with_steps(drive, partial(changed, factors, rates)), partial(changed, factors[0], rates[0]))

    return change


def slipped(drive: Drive, start_s: float, metres: float, direction_rad: float) -> Drive:
    """Within SLIP_S the measuring wheels roll some way in a direction of the robot frame that the robot doesn't go."""
    rolled = metres * np.cos(np.array(drive.setup.wheel_directions_rad) - direction_rad)
    return with_samples(
        drive, "wheels", lambda at_s, sums: sums + np.outer(np.clip((at_s - start_s) / SLIP_S, 0.0, 1.0), rolled)
    )


def gyro_drifting(drive: Drive, start_s: float, rate_rad_s: float) -> Drive:
    """From some time on the gyro shows so much more than the true rate."""
    return with_samples(
        drive, "gyro", lambda at_s, rates: rates + np.outer(np.where(at_s >= start_s, rate_rad_s, 0.0), (0.0, 0.0, 1.0))
    )


def drifting(drive: Drive, rate_rad_s: float) -> Drive:
    """The odometry's heading drifts, as with a gyro's bias."""
    return with_steps(
        drive, lambda at_s, steps: steps + np.outer(np.diff(at_s, prepend=at_s[:1]), (0.0, 0.0, rate_rad_s))
    )


def dropped(ratio: float) -> Change:
    """So many of odometry's and wheels' samples are lost on the way."""

    def change(drive: Drive, wrong: BoolArray, rng: Random) -> Drive:
        def kept(log: Samples) -> Samples | None:
            rows = rng.random(len(log)) >= ratio
            return Samples(log.stamp_ns[rows], log.values[rows]) if rows.any() else None

        return logged(kept, "odometry", "wheels")(drive, wrong, rng)

    return change


# --- compass ----------------------------------------------------------------------------------------------------------


def compass(shown: Callable[[FloatArray, float, FloatArray, Random], FloatArray]) -> Change:
    """shown: of true headings (M,), the first wrong one, the seconds since it (M,): the headings that are shown."""

    def change(drive: Drive, wrong: BoolArray, rng: Random) -> Drive:
        logs = [frame.compass for frame, is_wrong in zip(drive.frames, wrong, strict=True) if is_wrong]
        first = next((log for log in logs if log is not None), None)
        if first is None:
            return drive

        def shown_as(log: Samples) -> Samples:
            since_s = 1e-9 * (log.stamp_ns - first.stamp_ns[0])
            headings = shown(log.values[:, 0], float(first.values[0, 0]), since_s, rng)
            return Samples(log.stamp_ns, wrap_angles(headings).reshape(-1, 1))

        return logged(shown_as, "compass")(drive, wrong, rng)

    return change


turned_compass = compass(lambda true, first, since_s, rng: true + math.pi)
stuck_compass = compass(lambda true, first, since_s, rng: np.full(len(true), first))


# --- time -------------------------------------------------------------------------------------------------------------


def clock(late_s: Callable[[FloatArray, Random], FloatArray], in_order: bool = False) -> Change:
    """Images are stamped so much later than they were taken, (K,) of the seconds since the first one (K,).

    in_order: an image waits for the one before it. The true poses are those at the stamps.
    """

    def change(drive: Drive, wrong: BoolArray, rng: Random) -> Drive:
        times_s = drive.times_s
        told_s = times_s.copy()
        told_s[wrong] += late_s(times_s[wrong] - times_s[wrong][0], rng)
        if in_order:
            waits_s = np.maximum.accumulate(told_s)
            told_s = waits_s + np.where(waits_s > told_s, ROUNDING_S * np.arange(len(told_s)), 0.0)
        asked_s = np.where(np.abs(told_s - times_s) <= ANOTHER_CLOCK_S, told_s, times_s)
        truth = np.column_stack((drive.truth[:, :2], np.unwrap(drive.truth[:, 2])))
        moved = np.column_stack([np.interp(asked_s, times_s, column) for column in truth.T])
        moved[:, 2] = wrap_angles(moved[:, 2])
        stamps, other = np.rint(1e9 * told_s).astype(np.int64).tolist(), told_s != times_s
        stamped = framed(drive, other, lambda k, frame: _stamped(frame, stamps[k]))
        return replace(stamped, truth=np.where((asked_s != times_s)[:, np.newaxis], moved, drive.truth))

    return change


def _stamped(frame: Frame, stamp_ns: int) -> Frame:
    seen = frame.observation
    return replace(frame, stamp_ns=stamp_ns, observation=None if seen is None else replace(seen, stamp_ns=stamp_ns))


def stepped(late_s: float) -> Change:
    """The camera's clock is set to another time."""
    return clock(lambda since_s, rng: np.full(len(since_s), late_s))


def repeated(drive: Drive, wrong: BoolArray, rng: Random) -> Drive:
    """The first wrong image is shown again and again with new stamps."""
    first = drive.frames[int(np.argmax(wrong))].observation
    return seen_as(drive, lambda frame, seen: replace(first or seen, stamp_ns=frame.stamp_ns), wrong)


def every(count: int) -> Change:
    """Of so many frames only the last arrives, with the samples of all."""

    def change(drive: Drive, wrong: BoolArray, rng: Random) -> Drive:
        kept = ~wrong | (np.cumsum(wrong) % count == 0)
        ends = np.flatnonzero(kept).tolist()
        begins = [0, *(end + 1 for end in ends)]
        frames = [
            with_samples_of(drive.frames[begin:end], drive.frames[end])
            for begin, end in zip(begins, ends, strict=False)
        ]
        return replace(drive, frames=frames, truth=drive.truth[kept])

    return change


# --- being carried, and falls -----------------------------------------------------------------------------------------


def unseen(drive: Drive, wrong: BoolArray, rng: Random) -> Drive:
    """A covered camera: nothing is seen, and images are black."""

    def blind(_: int, frame: Frame) -> Frame:
        if frame.image is not None:
            return replace(frame, image=np.zeros_like(frame.image))
        return replace(frame, observation=Observation(frame.stamp_ns))

    return framed(drive, wrong, blind)


def covered(drive: Drive, start_s: float, seconds: float) -> Drive:
    """`unseen` for some time."""
    return Fault("", start_s, start_s + seconds, unseen).laid_into(drive, np.random.default_rng(0))


def elsewhere(nearest_m: float, farthest_m: float, lifted: bool = False) -> Change:
    """The robot is put down where it will be later in the drive, so far away, and goes on from there.

    lifted: it sees nothing in the wrong frames, and stands elsewhere after the last; else from the first one on.
    """

    def change(drive: Drive, wrong: BoolArray, rng: Random) -> Drive:
        first = max(int(np.argmax(wrong)), 1)
        before = drive.truth[first - 1, :2]
        if lifted:
            drive, first = unseen(drive, wrong, rng), int(np.flatnonzero(wrong)[-1]) + 1
        away_m, twin_m = (np.hypot(*(drive.truth[:, :2] + sign * before).T) for sign in (-1.0, 1.0))
        there = np.flatnonzero((away_m >= nearest_m) & (away_m <= farthest_m) & (twin_m >= nearest_m))
        there = there[there > first]
        return carried(drive, first, int(rng.choice(there)), None) if len(there) else drive

    return change


def carried(drive: Drive, start: int, end: int, after_s: float | None = 1.0) -> Drive:
    """The robot is put down at frame `end`, so long after it was at the one before `start`, and does not feel it.

    after_s: None: in the time from one frame to the next.
    """
    stamps = [frame.stamp_ns for frame in drive.frames]
    after_ns = stamps[start] - stamps[start - 1] if after_s is None else round(1e9 * after_s)
    gap_ns = stamps[end] - stamps[start - 1] - after_ns
    frames = [*drive.frames[:start], *(_earlier(frame, gap_ns) for frame in drive.frames[end:])]
    return unfelt(replace(drive, frames=frames, truth=np.concatenate((drive.truth[:start], drive.truth[end:]))), start)


def _earlier(frame: Frame, by_ns: int) -> Frame:
    logs = {name: log for name in SENSORS if (log := getattr(frame, name)) is not None}
    shifted = {name: Samples(log.stamp_ns - by_ns, log.values) for name, log in logs.items()}
    return _stamped(replace(frame, **shifted), frame.stamp_ns - by_ns)  # type: ignore[arg-type]


def unfelt(drive: Drive, start: int) -> Drive:
    """Odometry and wheels go on from their sums at frame `start`, as if nothing had happened before it."""

    def kept(name: str, at_s: FloatArray, moved: FloatArray) -> FloatArray:
        step = sum(len(log) for frame in drive.frames[:start] if (log := getattr(frame, name)) is not None)
        moved[step : step + 1] = 0.0
        return moved

    return with_rolling(with_steps(drive, partial(kept, "odometry")), partial(kept, "wheels"))


def fallen(drive: Drive, times_s: tuple[float, ...], rng: Random, lying: Change = unseen) -> Drive:
    """The robot falls at times, and stands elsewhere when it has got up. lying: what it sees on the ground."""

    def moved(at_s: FloatArray, steps: FloatArray) -> FloatArray:
        for time_s in times_s:
            direction, side = rng.uniform(-math.pi, math.pi), rng.choice((-1.0, 1.0))
            step = min(int(np.searchsorted(at_s, time_s + 0.5 * FALL_S)) + 1, len(steps) - 1)
            steps[step] += FALLEN_M * math.cos(direction), FALLEN_M * math.sin(direction), side * FALLEN_RAD
        return steps

    drive = with_steps(drive, moved)
    for time_s in times_s:
        drive = Fault("", time_s, time_s + FALL_S, lying).laid_into(drive, rng)
    return drive


def falls(count: int, apart_s: float, seen: Change) -> Change:
    """So many falls. seen: what the robot sees while it lies, as its attitude says."""
    lying = logged(lambda log: Samples(log.stamp_ns, np.tile([0.0, LYING_RAD], (len(log), 1))), "tilt")

    def change(drive: Drive, wrong: BoolArray, rng: Random) -> Drive:
        start_s = float(drive.times_s[int(np.argmax(wrong))])
        times_s = tuple(start_s + apart_s * k for k in range(count))
        return fallen(drive, times_s, rng, both(seen, lying))

    return change


# --- what is told of field and camera, and what is true ---------------------------------------------------------------


def another_field(*names: str) -> Change:
    """The first of these fields that is not its own is told."""

    def change(drive: Drive, wrong: BoolArray, rng: Random) -> Drive:
        other = open_field(next(name for name in names if name != drive.field.name))
        return replace(drive, setup=replace(drive.setup, field=other))

    return change


def half_told(drive: Drive, wrong: BoolArray, rng: Random) -> Drive:
    """The start is told at the other end of the field."""
    return replace(drive, prior=Prior(Pose(*drive.truth[0].tolist()).mirrored()))


def similar(turn_rad: float = 0.0, scale: float = 1.0, flipped: bool = False, rate_rad_s: float = 0.0) -> Change:
    """All that is seen is mirrored, so many times as far away, turned to the left, and turning."""

    def change(drive: Drive, wrong: BoolArray, rng: Random) -> Drive:
        start_s = drive.times_s[int(np.argmax(wrong))]
        return seen_as(
            drive,
            lambda frame, seen: turned(seen, turn_rad + rate_rad_s * (frame.stamp_ns / 1e9 - start_s), scale, flipped),
            wrong,
        )

    return change


def ahead(by_m: float) -> Change:
    """All that is seen is told so much farther ahead, as where the mount is measured wrongly."""
    return lambda drive, wrong, rng: seen_as(
        drive, lambda frame, seen: _on_ground(seen, lambda ground: ground + np.array([by_m, 0.0])), wrong
    )


Angle: TypeAlias = Callable[[float, float], float]  # (rad) of the seconds of the drive, and of the first wrong frame


def head(pan_rad: Angle | None = None, nod_rad: Angle | None = None) -> Change:
    """The head is turned farther to the left, and looks lower, than it is told to."""

    def change(drive: Drive, wrong: BoolArray, rng: Random) -> Drive:
        start_s, height_m = float(drive.times_s[int(np.argmax(wrong))]), drive.setup.height_m or 1.0

        def changed(frame: Frame, seen: Observation) -> Observation:
            at_s = frame.stamp_ns / 1e9
            if nod_rad is not None:
                seen = _on_ground(seen, partial(_farther, nod_rad(at_s, start_s), height_m))
            return seen if pan_rad is None else turned(seen, -pan_rad(at_s, start_s))

        return seen_as(drive, changed, wrong)

    return change


def turned_aside(drive: Drive, angle_rad: float) -> Drive:
    """The camera is turned aside by an angle, which nobody tells."""
    return seen_as(drive, lambda frame, seen: turned(seen, angle_rad))


def looking_lower(drive: Drive, pitch_rad: float, height_m: float) -> Drive:
    """The camera looks lower by an angle than it is thought to; what seems to hang in the air is left out."""
    return seen_as(drive, lambda frame, seen: _on_ground(seen, partial(_farther, pitch_rad, height_m)))


def _farther(pitch_rad: float, height_m: float, ground: FloatArray) -> FloatArray:
    """Where ground points (..., 2) seem to be that are seen by a camera that looks lower than it is told to."""
    c, s = math.cos(pitch_rad), math.sin(pitch_rad)
    x, y = ground[..., 0], ground[..., 1]
    depth = height_m * c - x * s
    depth = np.where(depth > 0.0, depth, math.nan)
    return np.stack(((x * c + height_m * s) * height_m / depth, y * height_m / depth), axis=-1)


def misjudged(drive: Drive, longer: float, higher_m: float) -> Drive:
    """The camera, a perspective one, is told with a focal length by so much longer, and so much higher, than it has.

    Its lens bends nothing.
    """
    camera = drive.setup.camera
    assert isinstance(camera, PinholeCamera)
    mount, eye = camera.base_from_camera, camera.base_from_camera.translation_m
    shared = np.array([0.0, 0.0, higher_m / eye[2], 1.0 / (1.0 + longer) - 1.0])
    assumed = replace(
        camera,
        fx=(1.0 + longer) * camera.fx,
        fy=(1.0 + longer) * camera.fy,
        base_from_camera=Pose3(mount.rotation, eye + np.array([0.0, 0.0, higher_m])),
    )
    response = camera_errors(camera).response
    misplaced = seen_as(
        drive, lambda frame, seen: _on_ground(seen, partial(placed_points, errors=shared, response=response(frame)))
    )
    return replace(misplaced, setup=replace(drive.setup, camera=assumed, height_m=None))


def _on_ground(seen: Observation, moved: Callable[[FloatArray], FloatArray]) -> Observation:
    """What is seen with its ground points (N, 2) moved; what is nowhere then is left out."""
    points, lines, crossings, landmarks = seen.points, seen.lines, seen.crossings, seen.landmarks
    return replace(
        seen,
        points=replace(points, positions_m=moved(points.positions_m)),
        lines=replace(lines, ends_m=moved(lines.ends_m.reshape(-1, 2)).reshape(-1, 2, 2)),
        crossings=replace(crossings, positions_m=moved(crossings.positions_m)),
        landmarks=replace(landmarks, positions_m=moved(landmarks.positions_m)),
    ).usable()
