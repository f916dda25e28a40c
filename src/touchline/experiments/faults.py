"""Faults of a robot's sensors and of what it sees, and what happens to it, laid into a drive to see who is fooled.

Of humanoids a camera that looks too low, drift, falls, being carried off: what is unfelt is left out of, or added to,
the odometry.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from touchline.camera import PinholeCamera
from touchline.experiments.drives import Drive
from touchline.geometry import FloatArray, Pose, Pose3, wrap_angle, wrap_angles
from touchline.localization.camera_errors import camera_errors
from touchline.localization.camera_errors.base import placed_points
from touchline.simulation.observation.features import turned
from touchline.types import Frame, LinePoints, Observation, Samples, empty_points, points_at

NEAR_LINE_M = 0.2  # line points this near a line belong to it
GARBAGE_POINTS = 100
FALL_S = 5.0  # on the ground and getting up: nothing is seen
FALLEN_M, FALLEN_RAD = 0.4, math.radians(40.0)  # by which it lies elsewhere, unfelt


Change: TypeAlias = Callable[[Drive, int, np.random.Generator], Frame]


class LaidIn(Protocol):
    """A fault from start_s until before end_s."""

    @property
    def name(self) -> str: ...
    @property
    def start_s(self) -> float: ...
    @property
    def end_s(self) -> float: ...
    def laid_into(self, drive: Drive, rng: np.random.Generator) -> Drive:
        """The drive with the fault in it."""
        ...


class Fault(NamedTuple):
    """What is wrong from start_s until before end_s: `change` makes another frame of one, with its true pose."""

    name: str
    start_s: float
    end_s: float
    change: Change

    def laid_into(self, drive: Drive, rng: np.random.Generator) -> Drive:
        """The drive with the fault in it."""
        wrong = (drive.times_s >= self.start_s) & (drive.times_s < self.end_s)
        frames = [self.change(drive, k, rng) if wrong[k] else frame for k, frame in enumerate(drive.frames)]
        return replace(drive, frames=frames)


def seeing(frame: Frame, points_m: FloatArray) -> Frame:
    """A frame that shows these points (N, 2), robot frame, instead."""
    return replace(frame, observation=Observation(frame.stamp_ns, points_at(np.asarray(points_m, dtype=np.float64))))


def unseen(drive: Drive, index: int, rng: np.random.Generator) -> Frame:
    """A covered camera: nothing is seen."""
    return replace(drive.frames[index], observation=Observation(drive.frames[index].stamp_ns))


def uniform_points(drive: Drive, index: int, rng: np.random.Generator) -> Frame:
    """Points anywhere within 6 m."""
    return seeing(drive.frames[index], rng.uniform(-6.0, 6.0, (GARBAGE_POINTS, 2)))


def far_points(drive: Drive, index: int, rng: np.random.Generator) -> Frame:
    """All points a thousand kilometres away."""
    bearing = rng.uniform(-math.pi, math.pi, GARBAGE_POINTS)
    return seeing(drive.frames[index], 1e6 * np.column_stack((np.cos(bearing), np.sin(bearing))))


def blob(drive: Drive, index: int, rng: np.random.Generator) -> Frame:
    """All points in a heap 20 m away."""
    return seeing(drive.frames[index], np.array([20.0, 0.0]) + 0.3 * rng.standard_normal((GARBAGE_POINTS, 2)))


def ring(drive: Drive, index: int, rng: np.random.Generator) -> Frame:
    """All points on a circle of 1 m about the robot: its own edge."""
    bearing = rng.uniform(-math.pi, math.pi, GARBAGE_POINTS)
    radius = 1.0 + 0.01 * rng.standard_normal(GARBAGE_POINTS)
    return seeing(drive.frames[index], radius[:, None] * np.column_stack((np.cos(bearing), np.sin(bearing))))


def one_line(start_s: float) -> Change:
    """Of the true points only those of one line: the one that showed most of them when it began."""

    def change(drive: Drive, index: int, rng: np.random.Generator) -> Frame:
        first = int(np.searchsorted(drive.times_s, start_s))
        seen = [int(np.count_nonzero(_on_line(drive, first, segment))) for segment in drive.field.segments]
        kept, frame = _on_line(drive, index, drive.field.segments[int(np.argmax(seen))]), drive.frames[index]
        p = _points(frame)
        lone = LinePoints(p.positions_m[kept], p.covariances_m2[kept], p.confidences[kept], p.pixels[kept])
        return replace(frame, observation=Observation(frame.stamp_ns, lone))

    return change


def _points(frame: Frame) -> LinePoints:
    return empty_points() if frame.observation is None else frame.observation.points


def _on_line(drive: Drive, index: int, segment: FloatArray) -> npt.NDArray[np.bool_]:
    """(N,) which of a frame's points lie on a line."""
    placed = Pose(*drive.truth[index].tolist()).transform(_points(drive.frames[index]).positions_m)
    found: npt.NDArray[np.bool_] = distances_to_segment(placed, segment) < NEAR_LINE_M
    return found


def distances_to_segment(points: FloatArray, segment: FloatArray) -> FloatArray:
    """(N,) distances of points (N, 2) from a segment (x1, y1, x2, y2)."""
    start, along = segment[:2], segment[2:4] - segment[:2]
    share = np.clip((points - start) @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
    found: FloatArray = np.hypot(*(points - start - share[:, None] * along).T)
    return found


def false_line(drive: Drive, index: int, rng: np.random.Generator) -> Frame:
    """Nothing but a straight line that is not there: 1.5 m from the robot, 6 m long, as if it lay on the field."""
    place = Pose(*drive.truth[index].tolist())
    along = np.linspace(-3.0, 3.0, 60)
    line = np.column_stack((along, np.full(60, 1.5))) + 0.01 * rng.standard_normal((60, 2))
    turn = wrap_angle(0.5 - place.heading)
    return seeing(drive.frames[index], Pose(0.0, 0.0, turn).transform(line))


def with_compass(frame: Frame, headings_rad: FloatArray) -> Frame:
    """A frame whose compass shows these headings (M,)."""
    if frame.compass is None:
        return frame
    return replace(frame, compass=Samples(frame.compass.stamp_ns, wrap_angles(headings_rad).reshape(-1, 1)))


def turned_compass(drive: Drive, index: int, rng: np.random.Generator) -> Frame:
    """The compass shows the opposite."""
    frame = drive.frames[index]
    return frame if frame.compass is None else with_compass(frame, frame.compass.values[:, 0] + math.pi)


def stuck_compass(start_s: float) -> Change:
    """The compass goes on showing what it showed at this time."""

    def change(drive: Drive, index: int, rng: np.random.Generator) -> Frame:
        frame = drive.frames[index]
        if frame.compass is None:
            return frame
        first = int(np.searchsorted(drive.times_s, start_s))
        last = drive.frames[first].compass
        return frame if last is None else with_compass(frame, np.full(len(frame.compass.values), last.values[0, 0]))

    return change


def spliced(first: Drive, second: Drive, at_s: float) -> Drive:
    """The robot of the first drive is carried, at this time, to where that of the second is, and drives on as that one.

    Odometry and wheels go on from their sums; they feel nothing of it.
    """
    cut = int(np.searchsorted(first.times_s, at_s))
    before, after = first.frames[:cut], second.frames[cut : len(first.frames)]
    frames = [*before, *(_carried_on(frame, before[-1], second.frames[cut - 1]) for frame in after)]
    return replace(
        first, frames=frames, truth=np.concatenate((first.truth[:cut], second.truth[cut : len(first.frames)]))
    )


def _carried_on(frame: Frame, ours: Frame, theirs: Frame) -> Frame:
    changed = frame
    if frame.odometry is not None and ours.odometry is not None and theirs.odometry is not None:
        begin, end = Pose(*theirs.odometry.values[-1].tolist()), Pose(*ours.odometry.values[-1].tolist())
        moved = [end.compose(begin.inverse().compose(Pose(*row))) for row in frame.odometry.values.tolist()]
        changed = replace(changed, odometry=Samples(frame.odometry.stamp_ns, np.array(moved)))
    if frame.wheels is not None and ours.wheels is not None and theirs.wheels is not None:
        rolled = frame.wheels.values - theirs.wheels.values[-1] + ours.wheels.values[-1]
        changed = replace(changed, wheels=Samples(frame.wheels.stamp_ns, rolled))
    return changed


class Slip(NamedTuple):
    """Wheels that tell another motion than the robot's from start_s until before end_s; odometry as well as wheels.

    Every step is `factor` times the true one, and `spin_m_s` of travel ahead come on top. The gyro is right.
    """

    name: str
    start_s: float
    end_s: float
    factor: float = 1.0
    spin_m_s: float = 0.0

    def laid_into(self, drive: Drive, rng: np.random.Generator) -> Drive:
        """The drive with the fault in it."""
        return with_samples(with_steps(drive, partial(self._steps, np.array([1.0, 0.0, 0.0]))), "wheels", self._wheels)

    def _steps(self, spun: FloatArray, times_s: FloatArray, steps: FloatArray) -> FloatArray:
        """(N, K) steps up to each of N samples as they are told; spun: (K,) in which of them spinning shows."""
        wrong = ((times_s >= self.start_s) & (times_s < self.end_s))[:, None]
        passed_s = np.diff(times_s, prepend=times_s[:1])[:, None]
        told: FloatArray = np.where(wrong, self.factor * steps + self.spin_m_s * passed_s * spun, steps)
        return told

    def _wheels(self, times_s: FloatArray, sums: FloatArray) -> FloatArray:
        told: FloatArray = sums[0] + np.cumsum(
            self._steps(np.ones(2), times_s, np.diff(sums, axis=0, prepend=sums[:1])), axis=0
        )
        return told


Told: TypeAlias = Callable[[FloatArray, FloatArray], FloatArray]  # of times (N,) in s and values (N, K), other values


def with_samples(drive: Drive, name: str, told: Told) -> Drive:
    """A drive in which the samples of a sensor (`odometry`, `wheels`), all in one log, tell otherwise."""
    logs: list[Samples | None] = [getattr(frame, name) for frame in drive.frames]
    known = [log for log in logs if log is not None]
    if not known:
        return drive
    values = told(1e-9 * np.concatenate([log.stamp_ns for log in known]), np.concatenate([log.values for log in known]))
    parts = iter(np.split(values, np.cumsum([len(log) for log in known])[:-1]))
    changes: list[dict[str, Any]] = [{} if log is None else {name: Samples(log.stamp_ns, next(parts))} for log in logs]
    return replace(drive, frames=[replace(f, **change) for f, change in zip(drive.frames, changes, strict=True)])


def with_steps(drive: Drive, told: Told) -> Drive:
    """A drive whose odometry goes by other steps up to each sample (N, 3), robot frame, the first of which is none."""

    def poses_of(times_s: FloatArray, poses: FloatArray) -> FloatArray:
        poses = np.column_stack((poses[:, :2], np.unwrap(poses[:, 2])))
        steps = np.diff(poses, axis=0, prepend=poses[:1])
        steps[1:, :2] = _turned(steps[1:, :2], -poses[:-1, 2])
        moved = told(times_s, steps)
        moved[:, 2] = poses[0, 2] + np.cumsum(moved[:, 2])
        moved[1:, :2] = _turned(moved[1:, :2], moved[:-1, 2])
        moved[:, :2] = poses[0, :2] + np.cumsum(moved[:, :2], axis=0)
        return moved

    return with_samples(drive, "odometry", poses_of)


def _turned(vectors: FloatArray, angles_rad: FloatArray) -> FloatArray:
    """Vectors (N, 2), each turned by its angle (N,)."""
    cosine, sine = np.cos(angles_rad), np.sin(angles_rad)
    x, y = vectors.T
    return np.column_stack((cosine * x - sine * y, sine * x + cosine * y))


def no_wheels(drive: Drive, index: int, rng: np.random.Generator) -> Frame:
    """Neither odometry nor wheels."""
    return replace(drive.frames[index], odometry=None, wheels=None)


def some_wheels(share: float) -> Change:
    """A share of odometry's and wheels' samples is dropped on the way."""

    def change(drive: Drive, index: int, rng: np.random.Generator) -> Frame:
        def kept(samples: Samples | None) -> Samples | None:
            if samples is None:
                return None
            rows = rng.random(len(samples.stamp_ns)) >= share
            return Samples(samples.stamp_ns[rows], samples.values[rows]) if rows.any() else None

        frame = drive.frames[index]
        return replace(frame, odometry=kept(frame.odometry), wheels=kept(frame.wheels))

    return change


def drifting(drive: Drive, rate_rad_s: float) -> Drive:
    """The odometry's heading drifts, as with a gyro's bias."""
    return with_steps(
        drive, lambda at_s, steps: steps + np.outer(np.diff(at_s, prepend=at_s[:1]), (0.0, 0.0, rate_rad_s))
    )


def fallen(drive: Drive, times_s: tuple[float, ...], rng: np.random.Generator) -> Drive:
    """The robot falls at times, sees nothing until it stands again, and stands elsewhere then."""

    def moved(at_s: FloatArray, steps: FloatArray) -> FloatArray:
        for time_s in times_s:
            direction, side = rng.uniform(-math.pi, math.pi), rng.choice((-1.0, 1.0))
            step = min(int(np.searchsorted(at_s, time_s + 0.5 * FALL_S)) + 1, len(steps) - 1)
            steps[step] += FALLEN_M * math.cos(direction), FALLEN_M * math.sin(direction), side * FALLEN_RAD
        return steps

    drive = with_steps(drive, moved)
    for time_s in times_s:
        drive = Fault("", time_s, time_s + FALL_S, unseen).laid_into(drive, rng)
    return drive


def carried(drive: Drive, start: int, end: int) -> Drive:
    """The robot is put down at frame `end`, a second after it was at the one before `start`, and does not feel it."""
    gap_ns = drive.frames[end].stamp_ns - drive.frames[start - 1].stamp_ns - 1_000_000_000
    later = (_earlier(frame, gap_ns) for frame in drive.frames[end:])
    truth = np.concatenate((drive.truth[:start], drive.truth[end:]))

    def unfelt(at_s: FloatArray, steps: FloatArray) -> FloatArray:
        steps[int(np.argmax(np.diff(at_s))) + 1] = 0.0
        return steps

    return with_steps(replace(drive, frames=(*drive.frames[:start], *later), truth=truth), unfelt)


def _earlier(frame: Frame, by_ns: int) -> Frame:
    odometry = frame.odometry
    if odometry is not None:
        odometry = Samples(odometry.stamp_ns - by_ns, odometry.values)
    return Frame(frame.stamp_ns - by_ns, observation=frame.observation, odometry=odometry)


def turned_aside(drive: Drive, angle_rad: float) -> Drive:
    """The camera is turned aside by an angle, which nobody tells."""
    return seen_as(drive, lambda frame, seen: turned(seen, angle_rad))


def looking_lower(drive: Drive, pitch_rad: float, height_m: float) -> Drive:
    """The camera looks lower by an angle than it is thought to; what seems to hang in the air is left out."""
    c, s = math.cos(pitch_rad), math.sin(pitch_rad)

    def farther(ground: FloatArray) -> FloatArray:
        x, y = ground[..., 0], ground[..., 1]
        depth = height_m * c - x * s
        depth = np.where(depth > 0.0, depth, math.nan)
        return np.stack(((x * c + height_m * s) * height_m / depth, y * height_m / depth), axis=-1)

    return seen_as(drive, lambda frame, seen: _on_ground(seen, farther))


def misjudged(drive: Drive, longer: float, higher_m: float) -> Drive:
    """The camera, a perspective one, is told with a focal length by so much longer, and so much higher, than it has.

    Its lens bends nothing.
    """
    camera = drive.setup.camera
    assert isinstance(camera, PinholeCamera)
    mount, eye = camera.base_from_camera, camera.base_from_camera.translation_m
    shared = np.array([0.0, 0.0, higher_m / eye[2], 1.0 / (1.0 + longer) - 1.0])
    told = replace(
        camera,
        fx=(1.0 + longer) * camera.fx,
        fy=(1.0 + longer) * camera.fy,
        base_from_camera=Pose3(mount.rotation, eye + np.array([0.0, 0.0, higher_m])),
    )

    errors = camera_errors(camera)

    def as_told(frame: Frame, seen: Observation) -> Observation:
        return _on_ground(seen, partial(placed_points, errors=shared, response=errors.response(frame)))

    return replace(seen_as(drive, as_told), setup=replace(drive.setup, camera=told, height_m=None))


def seen_as(drive: Drive, change: Callable[[Frame, Observation], Observation]) -> Drive:
    """A drive whose observations are others."""
    seen = (None if f.observation is None else change(f, f.observation) for f in drive.frames)
    return replace(drive, frames=[replace(f, observation=o) for f, o in zip(drive.frames, seen, strict=True)])


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
