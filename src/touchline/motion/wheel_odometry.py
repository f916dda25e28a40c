"""Motion by two measuring wheels and a gyro, between any two stamps that they cover.

M. A. Ismail, D. Purwanto, A. Arifin: Soccer robot localization based on sensor fusion from odometry and omnivision,
section II.A, equations (1) to (3), figure 3.
"""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.motion.gyro import IntegratedGyro
from touchline.motion.integrated import covered_s
from touchline.motion.odometry import UNKNOWN_SPEED_M_S, UNKNOWN_TURN_RAD_S, Motion
from touchline.motion.samples import EXTRAPOLATION_S, NANOSECONDS
from touchline.motion.wheel_pair import WheelPair
from touchline.motion.wheels import WheelCounters, WheelSettings

DRIFT_M = 0.01  # random position error after one second even at rest (m, root of time): being nudged


class RollStep(NamedTuple):
    """What the wheels rolled (m) and the gyro turned (rad) in a short time of constant velocity."""

    a_m: float
    b_m: float
    turn_rad: float


@dataclass(slots=True)
class Rolled:
    """The sum of steps: net travels (m), ways there and back (m), turns both ways (rad)."""

    a_m: float = 0.0
    b_m: float = 0.0
    a_way_m: float = 0.0
    b_way_m: float = 0.0
    turns_rad: float = 0.0

    def add(self, step: RollStep) -> None:
        """Add one more step."""
        self.a_m, self.b_m = self.a_m + step.a_m, self.b_m + step.b_m
        self.a_way_m, self.b_way_m = self.a_way_m + abs(step.a_m), self.b_way_m + abs(step.b_m)
        self.turns_rad += abs(step.turn_rad)


class WheelOdometry:
    """Motion by wheels and gyro. Beyond the newest samples the last motion goes on for a short time.

    Where they say nothing for longer, the robot is taken to stand still, with a wide covariance, and the time is
    counted in `Motion.missing_s`.
    """

    def __init__(self, settings: WheelSettings, pair: WheelPair | None, gyro: IntegratedGyro) -> None:
        """pair: None if nobody knows how the wheels are mounted: all their time is missing then."""
        self.settings = settings
        self.pair = pair
        self.wheels = WheelCounters(settings)
        self.gyro = gyro

    def between(self, start_ns: int, end_ns: int) -> Motion:
        """The robot's motion from one stamp to a later one."""
        known_ns = self.known_until_ns(start_ns, end_ns)
        rolled, pose = Rolled(), Pose(0.0, 0.0, 0.0)
        for step in self.steps(start_ns, known_ns):
            rolled.add(step)
            pose = pose.compose(self.displaced(step))
        beyond = self.extrapolated(known_ns, end_ns)
        if beyond is not None:
            rolled.add(beyond)
            pose = pose.compose(self.displaced(beyond))
        return self.motion(pose, rolled, (end_ns - start_ns) / NANOSECONDS, self.missing_s(start_ns, end_ns))

    def missing_s(self, start_ns: int, end_ns: int) -> float:
        """Time (s) in which wheels, gyro or both say nothing."""
        if self.pair is None:
            return (end_ns - start_ns) / NANOSECONDS
        gaps_ns = [sensor.integral.gaps_ns(start_ns, end_ns) for sensor in (self.wheels, self.gyro)]
        return covered_s(itertools.chain(*gaps_ns))

    def known_until_ns(self, start_ns: int, end_ns: int) -> int:
        """The newest stamp between two up to which both have samples; the end if they will never have any for it."""
        wheels, gyro = self.wheels.integral.samples, self.gyro.integral.samples
        if self.pair is None or len(wheels) == 0 or len(gyro) == 0:
            return end_ns
        return max(min(wheels.last_ns, gyro.last_ns, end_ns), start_ns)

    def steps(self, start_ns: int, end_ns: int) -> Iterator[RollStep]:
        """What was rolled and turned between two stamps, from sample to sample of either sensor."""
        wheels, gyro = self.wheels.integral.samples, self.gyro.integral.samples
        if self.pair is None or len(wheels) == 0 or len(gyro) == 0 or end_ns <= start_ns:
            return
        inside_ns = {*wheels.stamps_within(start_ns, end_ns), *gyro.stamps_within(start_ns, end_ns)}
        (a_last_m, b_last_m), (last_rad, _) = wheels.at(start_ns), gyro.at(start_ns)
        for stamp_ns in (*sorted(inside_ns), end_ns):
            (a_m, b_m), (angle_rad, _) = wheels.at(stamp_ns), gyro.at(stamp_ns)
            yield RollStep(a_m - a_last_m, b_m - b_last_m, angle_rad - last_rad)
            a_last_m, b_last_m, last_rad = a_m, b_m, angle_rad

    def extrapolated(self, known_ns: int, end_ns: int) -> RollStep | None:
        """The last motion, going on for a short time beyond the newest samples; None if the end is not beyond."""
        wheels, gyro, reach_s = self.wheels.integral.samples, self.gyro.integral.samples, EXTRAPOLATION_S
        if self.pair is None or len(wheels) == 0 or len(gyro) == 0:
            return None
        goes_on_until_ns = min(wheels.last_ns, gyro.last_ns) + int(reach_s * NANOSECONDS)
        beyond_s = (min(end_ns, goes_on_until_ns) - known_ns) / NANOSECONDS
        if beyond_s <= 0.0:
            return None
        a_m, b_m = wheels.slope(reach_s) * beyond_s
        return RollStep(float(a_m), float(b_m), float(gyro.slope(reach_s)[0]) * beyond_s)

    def displaced(self, step: RollStep, heading_rad: float = 0.0) -> Pose:
        """Equations (2) and (3): displacement by a step that starts with a heading (rad), and its turn.

        It points along the heading in the middle of the step. On an arc it is shorter than the way by the chord's
        ratio, which the paper leaves out: 1 − turn² / 24.
        """
        if self.pair is None:
            return Pose(0.0, 0.0, 0.0)
        half = 0.5 * step.turn_rad if self.settings.paper.chord else 0.0
        dx, dy = self.pair.displacement(step.a_m, step.b_m, step.turn_rad, heading_rad + half)
        ratio = math.sin(half) / half if abs(half) > 1e-6 else 1.0
        return Pose(ratio * dx, ratio * dy, wrap_angle(step.turn_rad))

    def motion(self, pose: Pose, rolled: Rolled, duration_s: float, missing_s: float) -> Motion:
        """A motion with its covariance."""
        covariance = self._covariance(pose, rolled, duration_s, missing_s)
        return Motion(pose, covariance, missing_s, by_gyro=missing_s == 0.0)

    def _covariance(self, pose: Pose, rolled: Rolled, duration_s: float, missing_s: float) -> FloatArray:
        """(3, 3) of the motion in the robot frame before it.

        Wheels err by their circumference and by slip, the heading by the gyro. Half of the heading's error turns the
        displacement, too, and over the levers all of it is taken for travel.
        """
        s = self.settings
        position = DRIFT_M**2 * duration_s + (UNKNOWN_SPEED_M_S * missing_s) ** 2
        heading = self.gyro.settings.variance(rolled.turns_rad, duration_s)
        heading += (UNKNOWN_TURN_RAD_S * missing_s) ** 2
        arm_x, arm_y = -0.5 * pose.y, 0.5 * pose.x
        xx, xy, yy = position, 0.0, position
        if self.pair is not None:
            (ax, bx), (ay, by) = self.pair.gain(0.5 * pose.heading)
            arm_x -= ax * s.a_lever_m + bx * s.b_lever_m
            arm_y -= ay * s.a_lever_m + by * s.b_lever_m
            a, b = s.variance(rolled.a_m, rolled.a_way_m), s.variance(rolled.b_m, rolled.b_way_m)
            xx, xy, yy = xx + a * ax**2 + b * bx**2, xy + a * ax * ay + b * bx * by, yy + a * ay**2 + b * by**2
        xx, xy, yy = xx + heading * arm_x**2, xy + heading * arm_x * arm_y, yy + heading * arm_y**2
        xt, yt = heading * arm_x, heading * arm_y
        return np.array([[xx, xy, xt], [xy, yy, yt], [xt, yt, heading]])
