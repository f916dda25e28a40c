"""SE(2) poses, angles and transforms: the vocabulary of every other room.

Metres and radians; angles are counter-clockwise and wrapped to (-pi, pi].
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.floating[Any]]


def wrap_angle(angle_rad: float) -> float:
    """The angle in (-pi, pi] that points the same way."""
    wrapped = math.remainder(angle_rad, 2.0 * math.pi)
    return math.pi if wrapped == -math.pi else wrapped


def wrap_angles(angles_rad: npt.ArrayLike) -> FloatArray:
    """`wrap_angle` for an array of any shape (float64)."""
    wrapped = np.pi - np.mod(np.pi - np.asarray(angles_rad, dtype=np.float64), 2.0 * np.pi)
    return np.where(wrapped <= -np.pi, np.pi, wrapped)


def circular_mean(angles_rad: npt.ArrayLike, weights: npt.ArrayLike | None = None) -> float:
    """Direction of the (weighted) mean of unit vectors; angles (N,), weights (N,) non-negative."""
    angles = np.asarray(angles_rad, dtype=np.float64)
    scale = np.ones_like(angles) if weights is None else np.asarray(weights, dtype=np.float64)
    return wrap_angle(math.atan2(float(np.sum(scale * np.sin(angles))), float(np.sum(scale * np.cos(angles)))))


class Pose(NamedTuple):
    """A planar pose, read as the transform `target_from_source` of the frame it places.

    `field_from_robot` has the robot's position in the field (m) and its heading (rad).
    """

    x: float
    y: float
    heading: float

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

    def as_array(self) -> FloatArray:
        """x, y, heading as float64 (3,)."""
        return np.array(self, dtype=np.float64)
