"""Odometry from two measuring wheels and a gyro: where the robot is by dead reckoning, and how it got there.

M. A. Ismail, D. Purwanto, A. Arifin: Soccer robot localization based on sensor fusion from odometry and omnivision,
section II.A, equations (1) to (6), figures 3 and 4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from touchline.config import Settings
from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.motion.counters import Turning, WheelCounters, covered_s
from touchline.motion.history import NANOSECONDS
from touchline.motion.odometry import Motion, OdometrySettings, OdometryTrack
from touchline.motion.wheel_pair import WheelPair
from touchline.types import Frame


class WheelOdometrySettings(Settings):
    """How the wheels and the gyro are mounted and scaled, and how much they err."""

    a_dir_rad: float | None = Field(
        None, description="rolling direction of wheel a in the robot frame (rad); none: as the recording says"
    )
    b_dir_rad: float | None = Field(
        None, description="rolling direction of wheel b in the robot frame (rad); none: as the recording says"
    )
    a_lever_m: float = Field(
        0.0,
        description="travel of wheel a per radian of the robot's turn (m); 0 for a wheel on the line through the "
        "robot's origin along its rolling direction, as in the recordings",
    )
    b_lever_m: float = Field(0.0, description="travel of wheel b per radian of the robot's turn (m), as wheel a's")
    a_scale: float = Field(1.0, gt=0, description="true travel per travel that wheel a counts; 1: as it was calibrated")
    b_scale: float = Field(1.0, gt=0, description="true travel per travel that wheel b counts; 1: as it was calibrated")
    gyro_scale: float = Field(1.0, gt=0, description="true turning rate per rate that the gyro shows")
    gyro_bias_rad_s: float = Field(0.0, description="what the gyro shows at rest (rad/s); 0: not known")
    wheel_error: float = Field(
        0.01, ge=0, description="relative error of a wheel's circumference: measuring wheels err by less than 1 %"
    )
    slip_m: float = Field(
        0.004, ge=0, description="random error of a wheel after one metre of its way (m), growing with the root of it"
    )
    gyro_error: float = Field(0.01, ge=0, description="relative error of the gyro's scale: 1 % is usual of cheap ones")
    gyro_bias_error_rad_s: float = Field(
        0.01, ge=0, description="error of the gyro's bias (rad/s): 0.2 to 0.5 degrees per second are usual"
    )
    gyro_noise_rad: float = Field(
        0.002, ge=0, description="random heading error after one second (rad), growing with the root of the time"
    )
    drift_m: float = Field(
        0.01, ge=0, description="random position error after one second even at rest (m, root of time): being nudged"
    )
    gap_s: float = Field(
        0.25,
        gt=0,
        description="time without a gyro reading after which the turn in it is unknown (s): two readings of a slow one",
    )
    most_speed_m_s: float = Field(
        10.0, gt=0, description="a counter that steps faster than this (m/s) was restarted: twice what robots reach"
    )
    fallback: OdometrySettings = OdometrySettings()


@dataclass(slots=True)
class _Rolled:
    """What wheels and gyro did between two frames: net travels (m), ways there and back (m), sum of the turns (rad)."""

    a_m: float = 0.0
    b_m: float = 0.0
    a_way_m: float = 0.0
    b_way_m: float = 0.0
    turns_rad: float = 0.0

    def add(self, a_m: float, b_m: float, turn_rad: float) -> None:
        self.a_m, self.b_m = self.a_m + a_m, self.b_m + b_m
        self.a_way_m, self.b_way_m = self.a_way_m + abs(a_m), self.b_way_m + abs(b_m)
        self.turns_rad += abs(turn_rad)


class WheelOdometry:
    """Dead reckoning by two measuring wheels and a gyro, one call for each frame.

    Missing samples are bridged for `fallback.extrapolation_s` and made good when they come. Where wheels or gyro say
    nothing for longer, the frame's odometry takes their place, if there is any; if not, the robot is taken to stand
    still, with a wide covariance, and the time is counted in `Motion.missing_s`.
    """

    def __init__(
        self,
        settings: WheelOdometrySettings | None = None,
        a_dir_rad: float | None = None,
        b_dir_rad: float | None = None,
    ) -> None:
        """dir: rolling directions in the robot frame (rad), where the settings name none; unknown, and the odometry
        takes the wheels' place. Raises InputError for parallel wheels.
        """
        self.settings = s = settings or WheelOdometrySettings()
        a_dir_rad = a_dir_rad if s.a_dir_rad is None else s.a_dir_rad
        b_dir_rad = b_dir_rad if s.b_dir_rad is None else s.b_dir_rad
        self.pair: WheelPair | None = None
        if a_dir_rad is not None and b_dir_rad is not None:
            self.pair = WheelPair(a_dir_rad, b_dir_rad, s.a_lever_m, s.b_lever_m)
        reach_s = s.fallback.extrapolation_s
        self.wheels = WheelCounters((s.a_scale, s.b_scale), s.most_speed_m_s, reach_s)
        self.gyro = Turning(s.gyro_scale, s.gyro_bias_rad_s, s.gap_s, reach_s)
        self.odometry = OdometryTrack(s.fallback)
        self.reset()

    def reset(self, pose: Pose | None = None) -> None:
        """Forget all samples and start anew at a pose (field frame), by default at the origin."""
        self.wheels.clear()
        self.gyro.clear()
        self.odometry.reset()
        self.sums = [0.0, 0.0, 0.0]
        """Σ Δx_o, Σ Δy_o (m), Σ Δθ_o (rad, not wrapped) of equations (4) to (6), up to the newest sample used."""
        self.offset = [0.0, 0.0, 0.0]
        """x_ofst, y_ofst (m), θ_ofst (rad) of equations (4) to (6)."""
        self._summed_ns: int | None = None
        self._ahead = Pose(0.0, 0.0, 0.0)  # from the newest sample used to the frame
        self.stamp_ns: int | None = None
        self.fallbacks = 0
        """Frames so far whose motion was taken from the odometry instead."""
        self.set_pose(pose or Pose(0.0, 0.0, 0.0))

    @property
    def pose(self) -> Pose:
        """x_o, y_o, θ_o at the last frame: the sums and the offset of equations (4) to (6)."""
        return self._summed_pose().compose(self._ahead)

    def set_pose(self, pose: Pose) -> None:
        """Change the offset so that the pose at the last frame is this one (figure 4: from the fusion)."""
        summed = pose.compose(self._ahead.inverse())
        self.offset = [value - total for value, total in zip(summed, self.sums, strict=True)]

    def update(self, frame: Frame) -> Motion:
        """The motion since the last frame; none at the first one. Raises ValueError, and changes nothing, if frames run
        backwards.
        """
        start_ns, end_ns = self.stamp_ns, frame.stamp_ns
        if start_ns is not None and end_ns < start_ns:
            raise ValueError(f"motion runs forward in time, got {start_ns} to {end_ns} ns")
        self.wheels.add_counts(frame.wheels)
        self.gyro.add_rates(frame.gyro)
        self.odometry.add(frame.odometry)
        self.stamp_ns = end_ns
        if start_ns is None or self._summed_ns is None:
            self._summed_ns = end_ns
            return Motion(Pose(0.0, 0.0, 0.0), np.zeros((3, 3)), 0.0)
        missing_s = self._missing_s(start_ns, end_ns)
        motion = None if missing_s == 0.0 else self._replaced(start_ns, end_ns, missing_s)
        return self._reckoned(start_ns, end_ns, missing_s) if motion is None else motion

    def _summed_pose(self) -> Pose:
        x, y, heading = (total + offset for total, offset in zip(self.sums, self.offset, strict=True))
        return Pose(x, y, wrap_angle(heading))

    def _missing_s(self, start_ns: int, end_ns: int) -> float:
        """Time (s) in which wheels, gyro or both say nothing."""
        if self.pair is None:
            return (end_ns - start_ns) / NANOSECONDS
        return covered_s([*self.wheels.gaps_ns(start_ns, end_ns), *self.gyro.gaps_ns(start_ns, end_ns)])

    def _replaced(self, start_ns: int, end_ns: int, missing_s: float) -> Motion | None:
        """The odometry's motion, if it knows more of the time in which wheels or gyro say nothing."""
        motion = self.odometry.between(start_ns, end_ns)
        if motion.missing_s >= missing_s:
            return None
        pose = self.pose.compose(motion.pose)
        self._ahead = Pose(0.0, 0.0, 0.0)
        summed = self._summed_pose()
        turn_rad = wrap_angle(pose.heading - summed.heading)
        self.sums = [self.sums[0] + pose.x - summed.x, self.sums[1] + pose.y - summed.y, self.sums[2] + turn_rad]
        self._forget(end_ns)
        self.fallbacks += 1
        return motion

    def _reckoned(self, start_ns: int, end_ns: int, missing_s: float) -> Motion:
        """The motion by wheels and gyro; where an earlier frame had to guess, its error is made good in this one."""
        before = self.pose
        rolled = self._sum_up(end_ns)
        pose = before.inverse().compose(self.pose)
        duration_s = (end_ns - start_ns) / NANOSECONDS
        return Motion(pose, self._covariance(pose, rolled, duration_s, missing_s), missing_s)

    def _sum_up(self, end_ns: int) -> _Rolled:
        """Equations (1) to (6) up to a stamp."""
        assert self._summed_ns is not None
        rolled = _Rolled()
        self._ahead = Pose(0.0, 0.0, 0.0)
        if self.pair is None or len(self.wheels) == 0 or len(self.gyro) == 0:
            self._forget(end_ns)
            return rolled
        start_ns, known_ns = self._summed_ns, min(self.wheels.last_ns, self.gyro.last_ns, end_ns)
        if known_ns > start_ns:
            knots = {ns for ns in (*self.wheels.stamps_ns, *self.gyro.stamps_ns) if start_ns < ns < known_ns}
            (a_last_m, b_last_m), (last_rad,) = self.wheels.at(start_ns), self.gyro.at(start_ns)
            for knot_ns in (*sorted(knots), known_ns):
                (a_at_m, b_at_m), (at_rad,) = self.wheels.at(knot_ns), self.gyro.at(knot_ns)
                a_m, b_m, turn_rad = a_at_m - a_last_m, b_at_m - b_last_m, at_rad - last_rad
                dx, dy = _chord(self.pair, a_m, b_m, turn_rad, self.sums[2] + self.offset[2])
                self.sums = [self.sums[0] + dx, self.sums[1] + dy, self.sums[2] + turn_rad]
                rolled.add(a_m, b_m, turn_rad)
                a_last_m, b_last_m, last_rad = a_at_m, b_at_m, at_rad
        self._forget(max(known_ns, start_ns))
        self._guess_ahead(end_ns, max(known_ns, start_ns))
        return rolled

    def _guess_ahead(self, end_ns: int, known_ns: int) -> None:
        """The last motion goes on for a short time beyond the newest sample."""
        assert self.pair is not None
        reach_s = self.settings.fallback.extrapolation_s
        beyond_s = min((end_ns - known_ns) / NANOSECONDS, reach_s)
        if beyond_s > 0.0:
            a_m, b_m = self.wheels.slope(reach_s) * beyond_s
            turn_rad = float(self.gyro.slope(reach_s)[0]) * beyond_s
            self._ahead = Pose(*_chord(self.pair, float(a_m), float(b_m), turn_rad, 0.0), wrap_angle(turn_rad))

    def _forget(self, stamp_ns: int) -> None:
        """Everything before the stamp is in the sums; the slope at the newest samples stays known."""
        self._summed_ns = stamp_ns
        kept_ns = int(self.settings.fallback.extrapolation_s * NANOSECONDS)
        self.wheels.forget_before(stamp_ns - kept_ns)
        self.gyro.forget_before(stamp_ns - kept_ns)

    def _covariance(self, pose: Pose, rolled: _Rolled, duration_s: float, missing_s: float) -> FloatArray:
        """(3, 3) of the motion in the robot frame before it.

        Wheels err by their circumference (in proportion to the travel) and by slip (with the root of the way); the
        heading by the gyro's scale, bias and noise. Half of the heading's error turns the displacement, too, and over
        the levers all of it is taken for travel.
        """
        s, fallback = self.settings, self.settings.fallback
        position = s.drift_m**2 * duration_s + (fallback.unknown_speed_m_s * missing_s) ** 2
        heading = (s.gyro_error * rolled.turns_rad) ** 2 + (s.gyro_bias_error_rad_s * duration_s) ** 2
        heading += s.gyro_noise_rad**2 * duration_s + (fallback.unknown_turn_rad_s * missing_s) ** 2
        arm_x, arm_y = -0.5 * pose.y, 0.5 * pose.x
        xx, xy, yy = position, 0.0, position
        if self.pair is not None:
            (ax, bx), (ay, by) = self.pair.gain(0.5 * pose.heading)
            arm_x -= ax * s.a_lever_m + bx * s.b_lever_m
            arm_y -= ay * s.a_lever_m + by * s.b_lever_m
            a = (s.wheel_error * rolled.a_m) ** 2 + s.slip_m**2 * rolled.a_way_m
            b = (s.wheel_error * rolled.b_m) ** 2 + s.slip_m**2 * rolled.b_way_m
            xx, xy, yy = xx + a * ax**2 + b * bx**2, xy + a * ax * ay + b * bx * by, yy + a * ay**2 + b * by**2
        xx, xy, yy = xx + heading * arm_x**2, xy + heading * arm_x * arm_y, yy + heading * arm_y**2
        xt, yt = heading * arm_x, heading * arm_y
        return np.array([[xx, xy, xt], [xy, yy, yt], [xt, yt, heading]])


def _chord(pair: WheelPair, a_m: float, b_m: float, turn_rad: float, heading_rad: float) -> tuple[float, float]:
    """Displacement (m) during a step at constant velocity that starts with a heading (rad).

    It points along the heading in the middle of the step. On an arc it is shorter than the way by the chord's ratio,
    which the paper leaves out: 1 − turn² / 24.
    """
    dx, dy = pair.displacement(a_m, b_m, turn_rad, heading_rad + 0.5 * turn_rad)
    half = 0.5 * turn_rad
    ratio = math.sin(half) / half if abs(half) > 1e-6 else 1.0
    return ratio * dx, ratio * dy
