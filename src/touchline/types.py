"""The three values that flow through Touchline: Frame, Observation, Estimate.

Arrays are not copied: treat them as read-only. Time stamps are integer nanoseconds of one clock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol

import numpy as np
import numpy.typing as npt

from touchline.errors import InputError
from touchline.geometry import FloatArray, Pose

ImageArray = npt.NDArray[np.uint8]


@dataclass(frozen=True, eq=False, slots=True)
class Samples:
    """Stamped measurements of one sensor, in the order of time.

    stamp_ns: int64 (N,), strictly increasing. values: float64 (N, k), one column per quantity.
    """

    stamp_ns: npt.NDArray[np.int64]
    values: FloatArray

    def __post_init__(self) -> None:
        if self.values.ndim != 2 or len(self.stamp_ns) != len(self.values):
            raise ValueError(
                f"samples need stamps (N,) and values (N, k), got {self.stamp_ns.shape}, {self.values.shape}"
            )

    def __len__(self) -> int:
        return len(self.stamp_ns)


@dataclass(frozen=True, eq=False, slots=True)
class LinePoints:
    """Points on white lines.

    positions_m: (N, 2) robot frame. covariances_m2: (N, 2, 2) robot frame. confidences: (N,) in 0..1.
    pixels: (N, 2) u, v of where each was seen; NaN where unknown.
    """

    positions_m: FloatArray
    covariances_m2: FloatArray
    confidences: FloatArray
    pixels: FloatArray

    def __post_init__(self) -> None:
        n = len(self.positions_m)
        shapes = (self.positions_m.shape, self.covariances_m2.shape, self.confidences.shape, self.pixels.shape)
        if shapes != ((n, 2), (n, 2, 2), (n,), (n, 2)):
            raise ValueError(f"line points need (N, 2), (N, 2, 2), (N,), (N, 2), got {shapes}")

    def __len__(self) -> int:
        return len(self.positions_m)

    def finite(self) -> LinePoints:
        """Those with a finite position, covariance and confidence."""
        kept = np.isfinite(self.positions_m).all(axis=1) & np.isfinite(self.covariances_m2).all(axis=(1, 2))
        kept &= np.isfinite(self.confidences)
        if kept.all():
            return self
        return LinePoints(self.positions_m[kept], self.covariances_m2[kept], self.confidences[kept], self.pixels[kept])


@dataclass(frozen=True, eq=False, slots=True)
class Frame:
    """One image (or its line points) and all that was measured since the frame before.

    image: uint8 (H, W, 3), BGR. odometry: x, y, theta in the odometry frame. wheels: a, b travelled (m).
    gyro: gx, gy, gz (rad/s). compass: yaw in the field frame (rad). tilt: roll, pitch (rad).
    `problem` says why an expected image is missing. Anything but the stamp may be missing (None).
    """

    stamp_ns: int
    image: ImageArray | None = None
    points: LinePoints | None = None
    odometry: Samples | None = None
    wheels: Samples | None = None
    gyro: Samples | None = None
    compass: Samples | None = None
    tilt: Samples | None = None
    exposure_ms: float | None = None
    gain: float | None = None
    name: str = ""
    problem: str | None = None


@dataclass(frozen=True, eq=False, slots=True)
class Observation:
    """What was seen in one frame, in the robot frame. problem: why nothing could be seen, if so."""

    stamp_ns: int
    points: LinePoints
    problem: str | None = None


class Status(StrEnum):
    """How far an estimate can be trusted."""

    TRACKING = "tracking"
    SEARCHING = "searching"
    LOST = "lost"


class Mode(StrEnum):
    """Which sensors a fused estimate comes from (Ismail et al. 2021, section II.D)."""

    OMNIVISION = "omnivision"
    ODOMETRY = "odometry"
    BOTH = "omnivision+odometry"


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """A pose that would explain the observation, too. residual_m: mean distance of the points to the lines."""

    pose: Pose
    residual_m: float


@dataclass(frozen=True, eq=False, slots=True)
class Estimate:
    """Where the robot stands. covariance: (3, 3) of x, y, heading in (m, m, rad), field frame.

    residual_m: (weighted) mean distance of the points to the nearest line; NaN without points. mode: of systems that
    fuse sensors by modes, None of others.
    """

    stamp_ns: int
    pose: Pose
    covariance: FloatArray
    status: Status
    residual_m: float = float("nan")
    points: int = 0
    rivals: tuple[Hypothesis, ...] = ()
    perception_ms: float = 0.0
    localization_ms: float = 0.0
    observation: Observation | None = field(default=None, repr=False)
    mode: Mode | None = None


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known before the first frame: a pose, the own half (x < 0), or nothing. Raises InputError for both."""

    pose: Pose | None = None
    own_half: bool = False

    def __post_init__(self) -> None:
        if self.pose is not None and not all(math.isfinite(value) for value in self.pose):
            raise InputError(f"the start pose {tuple(self.pose)} must be three finite numbers: x, y (m), heading (rad)")
        if self.pose is not None and self.own_half:
            raise InputError("give a start pose or the own half, not both")


class System(Protocol):
    """What sources and sinks know of a localization system."""

    def step(self, frame: Frame) -> Estimate:
        """Take one frame, return where the robot stands at its time stamp.

        Raises ValueError for a frame that is older than the last one; pose and motion stay as they were.
        """
        ...

    def reset(self, prior: Prior | None = None) -> None:
        """Forget everything but the prior."""
        ...


def empty_points() -> LinePoints:
    """No line points."""
    return LinePoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0), np.zeros((0, 2)))
