"""Faults of a robot's sensors and of what it sees, laid into the frames of a run to see who is fooled."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose, wrap_angle, wrap_angles
from touchline.types import Frame, LinePoints, Observation, Samples, empty_points, points_at

NEAR_LINE_M = 0.2  # line points this near a line belong to it
GARBAGE_POINTS = 100


class Drive(NamedTuple):
    """Frames, the true poses (N, 3) at them (x, y in m, heading in rad, field frame), and the field."""

    frames: Sequence[Frame]
    truth: FloatArray
    field: FieldModel

    @property
    def times_s(self) -> FloatArray:
        """(N,) time stamps."""
        return np.array([frame.stamp_ns for frame in self.frames]) / 1e9

    def until(self, time_s: float) -> Drive:
        """The same, ending before a time."""
        end = int(np.searchsorted(self.times_s, time_s))
        return self._replace(frames=self.frames[:end], truth=self.truth[:end])


Change: TypeAlias = Callable[[Drive, int, np.random.Generator], Frame]


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
        return drive._replace(frames=frames)


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
    return Drive(frames, np.concatenate((first.truth[:cut], second.truth[cut : len(first.frames)])), first.field)


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
