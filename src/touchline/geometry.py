"""SE(2) and SE(3) poses, angles and transforms: the vocabulary of every other room.

Metres and radians; angles are counter-clockwise and wrapped to (-pi, pi].
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.floating[Any]]
Float32Array = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.int64]
Int32Array = npt.NDArray[np.int32]
IndexArray = npt.NDArray[np.intp]
BoolArray = npt.NDArray[np.bool_]
ByteArray = npt.NDArray[np.uint8]
_TWO_PI = 2.0 * math.pi
_HALF_TURN = np.outer([-1.0, -1.0, 1.0], [-1.0, -1.0, 1.0])  # of a covariance of x, y, heading


def wrap_angle(angle_rad: float) -> float:
    """The angle in (-pi, pi] that points the same way."""
    wrapped = math.remainder(angle_rad, _TWO_PI)
    return math.pi if wrapped == -math.pi else wrapped


def wrap_angles(angles_rad: npt.ArrayLike) -> FloatArray:
    """`wrap_angle` for an array of any shape (float64)."""
    wrapped = np.pi - np.mod(np.pi - np.asarray(angles_rad, dtype=np.float64), 2.0 * np.pi)
    return np.where(wrapped <= -np.pi, np.pi, wrapped)


def circular_mean(angles_rad: npt.ArrayLike) -> float:
    """Direction of the mean of unit vectors at angles (N,)."""
    angles = np.asarray(angles_rad, dtype=np.float64)
    return wrap_angle(math.atan2(float(np.sum(np.sin(angles))), float(np.sum(np.cos(angles)))))


def pairs_of(points: npt.ArrayLike) -> FloatArray:
    """Points (N, 2) as a table of float64. Raises ValueError for another shape."""
    table = np.ascontiguousarray(points, dtype=np.float64)
    if table.ndim != 2 or table.shape[1] != 2:
        raise ValueError(f"points need the shape (N, 2), got {table.shape}")
    return table


def runs_of(flags: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64]:
    """First index and end (K, 2) of each run of true flags (N,), in order."""
    return np.flatnonzero(np.diff(np.concatenate(([False], flags, [False])).astype(np.int8))).reshape(-1, 2)


def longest_run(flags: npt.NDArray[np.bool_]) -> tuple[int, int]:
    """First index and end of the longest run of true flags (N,), the first of several; 0, 0 without any."""
    first, end = max(runs_of(flags).tolist(), key=lambda run: run[1] - run[0], default=(0, 0))
    return first, end


class Pose(NamedTuple):
    """A planar pose, read as the transform `target_from_source` of the frame it places.

    `field_from_robot` has the robot's position in the field (m) and its heading (rad).
    """

    x: float
    y: float
    heading: float

    def to_dict(self) -> dict[str, float]:
        """For JSON: x_m, y_m, heading_rad."""
        return {"x_m": self.x, "y_m": self.y, "heading_rad": self.heading}

    def compose(self, other: Pose) -> Pose:
        """`a_from_b.compose(b_from_c)` is `a_from_c`."""
        c, s = math.cos(self.heading), math.sin(self.heading)
        return Pose(
            self.x + c * other.x - s * other.y,
            self.y + s * other.x + c * other.y,
            wrap_angle(self.heading + other.heading),
        )

    def inverse(self) -> Pose:
        """`a_from_b.inverse()` is `b_from_a`."""
        c, s = math.cos(self.heading), math.sin(self.heading)
        return Pose(-c * self.x - s * self.y, s * self.x - c * self.y, wrap_angle(-self.heading))

    def transform(self, points: FloatArray) -> FloatArray:
        """Points (N, 2) of the source frame, in the target frame (m)."""
        c, s = math.cos(self.heading), math.sin(self.heading)
        x, y = points[..., 0], points[..., 1]
        return np.stack((self.x + c * x - s * y, self.y + s * x + c * y), axis=-1)

    def mirrored(self) -> Pose:
        """The pose that sees the same lines on the symmetric field: turned by half a turn about the centre mark."""
        return Pose(-self.x, -self.y, wrap_angle(self.heading + math.pi))

    def distance_to(self, other: Pose) -> float:
        """Distance of the positions (m)."""
        return math.hypot(self.x - other.x, self.y - other.y)

    def minus(self, other: Pose) -> FloatArray:
        """This less another (3,), m, m, rad, in the frame that both are in."""
        return np.array([self.x - other.x, self.y - other.y, wrap_angle(self.heading - other.heading)])

    def is_near(self, other: Pose, reach_m: float, reach_rad: float) -> bool:
        """Whether another pose is no farther away than this, and turned by no more."""
        return self.distance_to(other) <= reach_m and abs(wrap_angle(self.heading - other.heading)) <= reach_rad

    def as_array(self) -> FloatArray:
        """x, y, heading as float64 (3,)."""
        return np.array([*self], dtype=np.float64)  # of a list in a quarter of the time


def as_pose(pose: FloatArray) -> Pose:
    """A pose (3,) with its heading wrapped."""
    return Pose(float(pose[0]), float(pose[1]), wrap_angle(float(pose[2])))


def deviation_m(covariance: FloatArray) -> float:
    """Standard deviation of the position (m) of a covariance (3, 3)."""
    return math.sqrt(covariance[0, 0] + covariance[1, 1])


def deviation_rad(covariance: FloatArray) -> float:
    """The same of the heading (rad)."""
    return math.sqrt(covariance[2, 2])


def mirrored_covariance(covariance: FloatArray) -> FloatArray:
    """Covariance (3, 3) of x, y, heading of the mirrored pose: turned by half a turn."""
    return covariance * _HALF_TURN


@dataclass(frozen=True, eq=False, slots=True)
class Pose3:
    """A pose in space, read as the transform `target_from_source` of the frame it places.

    rotation: (3, 3), its columns are the source frame's axes in the target frame. translation_m: (3,), the source
    frame's origin there. `base_from_camera` has the camera's place and attitude in the robot's base frame.
    """

    rotation: FloatArray
    translation_m: FloatArray

    def __post_init__(self) -> None:
        if np.shape(self.rotation) != (3, 3) or np.shape(self.translation_m) != (3,):
            raise ValueError(
                f"a pose needs a rotation (3, 3) and a translation (3,), got {np.shape(self.rotation)}, "
                f"{np.shape(self.translation_m)}"
            )

    @classmethod
    def identity(cls) -> Pose3:
        """Both frames are the same."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_roll_pitch_yaw(
        cls, roll_rad: float, pitch_rad: float, yaw_rad: float = 0.0, translation_m: npt.ArrayLike = (0.0, 0.0, 0.0)
    ) -> Pose3:
        """The rotation Rz(yaw) Ry(pitch) Rx(roll): positive pitch tips the nose down, positive roll lowers the right
        side. translation_m: (3,).
        """
        c, s = math.cos(yaw_rad), math.sin(yaw_rad)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return cls(turn @ tilt_rotation(roll_rad, pitch_rad), np.array(translation_m, dtype=np.float64))

    def roll_pitch_yaw(self) -> tuple[float, float, float]:
        """Roll, pitch, yaw (rad) of the rotation, as in `from_roll_pitch_yaw`; pitch in [-pi/2, pi/2]."""
        r = self.rotation
        pitch = math.asin(min(max(-float(r[2, 0]), -1.0), 1.0))
        return math.atan2(r[2, 1], r[2, 2]), pitch, math.atan2(r[1, 0], r[0, 0])

    def compose(self, other: Pose3) -> Pose3:
        """`a_from_b.compose(b_from_c)` is `a_from_c`."""
        return Pose3(self.rotation @ other.rotation, self.rotation @ other.translation_m + self.translation_m)

    def inverse(self) -> Pose3:
        """`a_from_b.inverse()` is `b_from_a`."""
        return Pose3(self.rotation.T, -self.rotation.T @ self.translation_m)

    def transform(self, points: FloatArray) -> FloatArray:
        """Points (N, 3) of the source frame, in the target frame (m)."""
        return points @ self.rotation.T + self.translation_m


def tilt_rotation(roll_rad: float, pitch_rad: float) -> FloatArray:
    """Ry(pitch) Rx(roll), (3, 3): positive pitch tips the nose down, positive roll lowers the right side."""
    cr, sr, cp, sp = math.cos(roll_rad), math.sin(roll_rad), math.cos(pitch_rad), math.sin(pitch_rad)
    return np.array([[cp, sp * sr, sp * cr], [0.0, cr, -sr], [-sp, cp * sr, cp * cr]])
