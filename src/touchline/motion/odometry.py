"""Odometry: how the robot moved between two stamps, and how sure that is."""

import math
from typing import NamedTuple

import numpy as np
from pydantic import Field

from touchline.config import Settings
from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.motion.samples import EXTRAPOLATION_S, NANOSECONDS, SampleHistory

TRAVEL_NOISE_M = 0.02  # random position error after one metre, growing with the root of the travel
TRAVEL_NOISE_RAD = 0.01  # random heading error after one metre, growing with the root of the travel
TURN_NOISE_RAD = 0.01  # random heading error after one radian, growing with the root of the turn
DRIFT_M = 0.01  # random position error after one second even at rest (m, root of time): being nudged
DRIFT_RAD = 0.01  # random heading error after one second even at rest
UNKNOWN_SPEED_M_S = 1.0  # speed that may have been driven while the odometry was missing: a brisk robot
UNKNOWN_TURN_RAD_S = 1.5  # rate that may have been turned at while the odometry was missing


class OdometrySettings(Settings):
    """The noise of dead reckoning, and what to assume without it."""

    forward_scale: float = Field(
        0.03, ge=0, description="relative error of forward travel: driven wheels err by 2 to 3 %"
    )
    sideways_scale: float = Field(0.03, ge=0, description="relative error of sideways travel: as forward")
    turn_scale: float = Field(0.03, ge=0, description="relative error of rotation: as forward")

    @property
    def scales(self) -> tuple[float, float, float]:
        """Relative errors of travel ahead, travel aside and turns."""
        return self.forward_scale, self.sideways_scale, self.turn_scale


class Motion(NamedTuple):
    """Motion between two stamps: `before_from_after`, covariance (3, 3) in the robot frame before it (m, m, rad).

    missing_s: time of it that no sensor covers; there zero motion is assumed, with a wide covariance. by_gyro: whether
    the gyro told all of its turn.
    """

    pose: Pose
    covariance: FloatArray
    missing_s: float
    by_gyro: bool = False


class Odometry:
    """The odometry of the last seconds: dead reckoning by the robot itself, from driven wheels or steps.

    samples: x, y, theta (m, m, rad; odometry frame).
    """

    def __init__(self, settings: OdometrySettings) -> None:
        self.settings = settings
        self.samples = SampleHistory(columns=3, angles=(2,))

    def between(self, start_ns: int, end_ns: int) -> Motion:
        """The robot's motion from one stamp to a later one."""
        duration_s = (end_ns - start_ns) / NANOSECONDS
        if len(self.samples) == 0:
            still = Pose(0.0, 0.0, 0.0)
            return Motion(still, self._covariance(still, 0.0, 0.0, duration_s, duration_s), duration_s)
        start, end = self.pose_at(start_ns), self.pose_at(end_ns)
        pose = start.inverse().compose(end)
        missing_s = self._missing_s(start_ns, end_ns)
        travel_m, turn_rad = self._travel(start_ns, end_ns, pose)
        return Motion(pose, self._covariance(pose, travel_m, turn_rad, duration_s, missing_s), missing_s)

    def pose_at(self, stamp_ns: int) -> Pose:
        """Pose in the odometry frame, carried on a little beyond the newest sample."""
        pose = Pose(*self.samples.at(stamp_ns))
        beyond_s = (stamp_ns - self.samples.last_ns) / NANOSECONDS
        if beyond_s <= 0.0:
            return Pose(pose.x, pose.y, wrap_angle(pose.heading))
        step = self.samples.slope(EXTRAPOLATION_S) * min(beyond_s, EXTRAPOLATION_S)
        return Pose(pose.x + float(step[0]), pose.y + float(step[1]), wrap_angle(pose.heading + float(step[2])))

    def _missing_s(self, start_ns: int, end_ns: int) -> float:
        """Time between the stamps before the first sample and after the end of the extrapolation."""
        first_ns = self.samples.first_ns
        last_ns = self.samples.last_ns + int(EXTRAPOLATION_S * NANOSECONDS)
        covered_ns = max(min(end_ns, last_ns) - max(start_ns, first_ns), 0)
        return (end_ns - start_ns - covered_ns) / NANOSECONDS

    def _travel(self, start_ns: int, end_ns: int, pose: Pose) -> tuple[float, float]:
        """Length of the way (m) and sum of the turns (rad): at least those of the motion as a whole."""
        seen = self.samples.between(start_ns, end_ns)
        x, y, turns = (seen[1:] - seen[:-1]).T
        way_m, turn_rad = float(np.add.reduce(np.hypot(x, y))), float(np.add.reduce(np.abs(turns)))
        return max(way_m, math.hypot(pose.x, pose.y)), max(turn_rad, abs(pose.heading))

    def _covariance(
        self, pose: Pose, travel_m: float, turn_rad: float, duration_s: float, missing_s: float
    ) -> FloatArray:
        s = self.settings
        position = TRAVEL_NOISE_M**2 * travel_m + DRIFT_M**2 * duration_s + (UNKNOWN_SPEED_M_S * missing_s) ** 2
        heading = TRAVEL_NOISE_RAD**2 * travel_m + TURN_NOISE_RAD**2 * turn_rad + DRIFT_RAD**2 * duration_s
        heading += (UNKNOWN_TURN_RAD_S * missing_s) ** 2
        covariance = np.zeros((3, 3))
        covariance[0, 0] = (s.forward_scale * pose.x) ** 2 + position
        covariance[1, 1] = (s.sideways_scale * pose.y) ** 2 + position
        covariance[2, 2] = (s.turn_scale * turn_rad) ** 2 + heading
        return covariance
