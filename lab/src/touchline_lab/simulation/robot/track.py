"""How the robot truly moved: poses and lean at even steps, and which part of the motion its sensors can feel."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from touchline.geometry import BoolArray, FloatArray, Pose, wrap_angles

STEP_S = 0.01  # of all tracks: an even share of the sensors' 20 ms, short against any motion of a soccer robot


@dataclass(frozen=True, eq=False)
class Track:
    """The true motion at times 0, STEP_S, 2 STEP_S, ...

    poses: float64 (N, 3) x, y (m), heading (rad, continuous: not wrapped), field frame.
    shoved, carried: float64 (N, 3), the part of the step *to* each row (field frame; m, m, rad) that was not driven.
    Wheels and odometry feel neither of them; the gyro feels the rotation of a shove; the compass shows all.
    attitude: float64 (N, 2) roll, pitch (rad) of the body. covered: bool (N,), whether the camera is covered.
    events: as in sequence.yaml. match: what happens in one (`Happening`).
    """

    poses: FloatArray
    shoved: FloatArray
    carried: FloatArray
    attitude: FloatArray
    covered: BoolArray
    events: tuple[Mapping[str, Any], ...] = ()
    match: tuple[Any, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.poses)
        shapes = tuple(a.shape for a in (self.poses, self.shoved, self.carried, self.attitude, self.covered))
        if shapes != ((n, 3), (n, 3), (n, 3), (n, 2), (n,)):
            raise ValueError(f"a track needs (N, 3), (N, 3), (N, 3), (N, 2), (N,), got {shapes}")

    @property
    def seconds(self) -> float:
        """Length in time."""
        return (len(self.poses) - 1) * STEP_S

    @cached_property
    def times_s(self) -> FloatArray:
        """Times (N,) of the rows."""
        return STEP_S * np.arange(len(self.poses))

    @cached_property
    def driven(self) -> FloatArray:
        """(N, 3) motion in the base frame (m, m, rad) that the wheels feel in the step to each row; row 0 is zero."""
        driven = np.zeros_like(self.poses)
        before = self.poses[:-1]
        after = self.poses[1:] - self.shoved[1:] - self.carried[1:]
        driven[1:] = twists_between(before, after)
        return driven

    @cached_property
    def turned_rad(self) -> FloatArray:
        """(N,) rotation that the gyro feels in the step to each row; entry 0 is zero."""
        turned = np.zeros(len(self.poses))
        turned[1:] = np.diff(self.poses[:, 2]) - self.carried[1:, 2]
        return turned

    def pose_at(self, time_s: float) -> Pose:
        """Where the robot is at a time, interpolated; a carried robot is at the new place from that step on."""
        return Pose(*self.poses_at(np.array([time_s]))[0].tolist())

    def poses_at(self, times_s: FloatArray) -> FloatArray:
        """(N, 3) x, y (m), wrapped heading (rad) at times (N,), as of `pose_at`."""
        poses = self._between(self.poses, times_s)
        poses[:, 2] = wrap_angles(poses[:, 2])
        return poses

    def attitude_at(self, time_s: float) -> tuple[float, float]:
        """Roll, pitch (rad) at a time."""
        roll, pitch = self._between(self.attitude, np.array([time_s]))[0]
        return float(roll), float(pitch)

    def leaning_at(self, time_s: float) -> tuple[float, float]:
        """Rates of roll and pitch (rad/s) at a time."""
        row = min(max(round(time_s / STEP_S), 1), len(self.poses) - 2)
        roll, pitch = (self.attitude[row + 1] - self.attitude[row - 1]) / (2.0 * STEP_S)
        return float(roll), float(pitch)

    def velocity_at(self, time_s: float) -> FloatArray:
        """(3,) velocity vx, vy (m/s, field frame), turning rate (rad/s), without the jump of being carried."""
        row = min(max(int(np.ceil(time_s / STEP_S)), 1), len(self.poses) - 1)
        return (self.poses[row] - self.poses[row - 1] - self.carried[row]) / STEP_S

    def covered_at(self, time_s: float) -> bool:
        """Whether the camera is covered at a time."""
        return bool(self.covered[min(max(round(time_s / STEP_S), 0), len(self.covered) - 1)])

    def _between(self, rows: FloatArray, times_s: FloatArray) -> FloatArray:
        """(N, k) the rows (M, k) at times (N,), linear in between."""
        position = np.clip(times_s / STEP_S, 0.0, len(rows) - 1.0)
        row = np.minimum(position.astype(np.int64), len(rows) - 2)
        share = position - row
        share = np.where(self.carried[row + 1].any(axis=1), np.where(share >= 0.5, 1.0, 0.0), share)[:, np.newaxis]
        return (1.0 - share) * rows[row] + share * rows[row + 1]


def twists_between(before: FloatArray, after: FloatArray) -> FloatArray:
    """(N, 3) motion in the base frame from poses (N, 3) to poses (N, 3), as the constant twist that leads there.

    The logarithm in SE(2): its first two numbers are the integrals of the base's forward and sideways velocity.
    """
    c, s = np.cos(before[:, 2]), np.sin(before[:, 2])
    dx, dy = after[:, 0] - before[:, 0], after[:, 1] - before[:, 1]
    forward, left = c * dx + s * dy, -s * dx + c * dy
    turn = after[:, 2] - before[:, 2]
    half = 0.5 * turn
    small = np.abs(half) < 1e-6
    # half / tan(half), whose series is needed near zero
    scale = np.where(small, 1.0 - half * half / 3.0, half / np.tan(np.where(small, 1.0, half)))
    return np.column_stack((scale * forward + half * left, scale * left - half * forward, turn))


def poses_from_twists(start: FloatArray, twists: FloatArray) -> FloatArray:
    """Poses (N, 3) reached from a pose (3,) by twists (N, 3) one after the other; the inverse of `twists_between`."""
    turn = twists[:, 2]
    headings = start[2] + np.concatenate(([0.0], np.cumsum(turn)))
    small = np.abs(turn) < 1e-6
    safe = np.where(small, 1.0, turn)
    sinc = np.where(small, 1.0 - turn * turn / 6.0, np.sin(safe) / safe)
    cosc = np.where(small, 0.5 * turn, (1.0 - np.cos(safe)) / safe)
    forward, left = sinc * twists[:, 0] - cosc * twists[:, 1], cosc * twists[:, 0] + sinc * twists[:, 1]
    c, s = np.cos(headings[:-1]), np.sin(headings[:-1])
    x = start[0] + np.cumsum(c * forward - s * left)
    y = start[1] + np.cumsum(s * forward + c * left)
    return np.column_stack((x, y, headings[1:]))
