"""Odometry: how the robot moved between two stamps, and how sure that is."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from pydantic import Field

from touchline.config import Settings
from touchline.geometry import FloatArray, Pose
from touchline.motion.samples import EXTRAPOLATION_S, NANOSECONDS, SampleHistory, interpolate, row_after, slope_of

TRAVEL_NOISE_M = 0.02  # random position error after one metre, growing with the root of the travel
TRAVEL_NOISE_RAD = 0.01  # random heading error after one metre, growing with the root of the travel
TURN_NOISE_RAD = 0.01  # random heading error after one radian, growing with the root of the turn
DRIFT_M = 0.01  # random position error after one second even at rest (m, root of time): being nudged
DRIFT_RAD = 0.01  # random heading error after one second even at rest
UNKNOWN_SPEED_M_S = 1.0  # speed that may have been driven while the odometry was missing: a brisk robot
HALT_S, HALT_M_S = 0.1, 0.1  # for how long at least, and from what speed
_EXTRAPOLATION_NS = int(EXTRAPOLATION_S * NANOSECONDS)
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


@njit(cache=True, error_model="numpy")
def wrapped(angle):  # type: ignore[no-untyped-def]
    """`geometry.wrap_angle` for compiled loops."""
    rest = np.fmod(angle, 2.0 * math.pi)
    if rest > math.pi:
        return rest - 2.0 * math.pi
    return rest + 2.0 * math.pi if rest <= -math.pi else rest


@njit(cache=True, error_model="numpy")
def odometry_pose(times, table, stamp_ns):  # type: ignore[no-untyped-def]
    """`Odometry.pose_at` by the arrays of its samples: (3,)."""
    pose, beyond_ns = np.empty(3), stamp_ns - times[-1]
    interpolate(times, table, stamp_ns, pose)
    if beyond_ns > 0:
        slope = slope_of(times, table, times[-1] - _EXTRAPOLATION_NS)
        for k in range(3):
            pose[k] += slope[k] * min(float(beyond_ns) / NANOSECONDS, EXTRAPOLATION_S)
    pose[2] = wrapped(pose[2])
    return pose


@njit(cache=True, error_model="numpy")
def step_to(start, end):  # type: ignore[no-untyped-def]
    """From one pose to another, both (3,): robot frame at the first."""
    cosine, sine, step = math.cos(start[2]), math.sin(start[2]), np.empty(3)
    x, y = -cosine * start[0] - sine * start[1], sine * start[0] - cosine * start[1]
    step[0], step[1] = x + cosine * end[0] + sine * end[1], y - sine * end[0] + cosine * end[1]
    step[2] = wrapped(end[2] - start[2])
    return step


@njit(cache=True, error_model="numpy")
def moved(times, table, start_ns, end_ns, scales, covariance):  # type: ignore[no-untyped-def]
    """`Odometry.between` by the arrays of its samples: the motion, the time not covered; its covariance (3, 3), of
    which the diagonal is filled.

    scales (3,): relative errors of travel ahead, travel aside and turns.
    """
    duration_s = float(end_ns - start_ns) / NANOSECONDS
    if len(times) == 0:
        step, missing_s = np.zeros(3), duration_s
    else:
        step = step_to(odometry_pose(times, table, start_ns), odometry_pose(times, table, end_ns))
        covered_ns = max(min(end_ns, times[-1] + _EXTRAPOLATION_NS) - max(start_ns, times[0]), 0)
        missing_s = float(end_ns - start_ns - covered_ns) / NANOSECONDS
    way_m = turns_rad = 0.0
    for i in range(row_after(times, start_ns - 1) + 1, row_after(times, end_ns)):
        way_m += math.hypot(table[i, 0] - table[i - 1, 0], table[i, 1] - table[i - 1, 1])
        turns_rad += abs(table[i, 2] - table[i - 1, 2])
    way_m, turns_rad = max(way_m, math.hypot(step[0], step[1])), max(turns_rad, abs(step[2]))  # at least the whole
    position = TRAVEL_NOISE_M**2 * way_m + DRIFT_M**2 * duration_s + (UNKNOWN_SPEED_M_S * missing_s) ** 2
    heading = TRAVEL_NOISE_RAD**2 * way_m + TURN_NOISE_RAD**2 * turns_rad + DRIFT_RAD**2 * duration_s
    covariance[0, 0] = (scales[0] * step[0]) ** 2 + position
    covariance[1, 1] = (scales[1] * step[1]) ** 2 + position
    covariance[2, 2] = (scales[2] * turns_rad) ** 2 + heading + (UNKNOWN_TURN_RAD_S * missing_s) ** 2
    return (step[0], step[1], step[2]), missing_s


class Halt(NamedTuple):
    """An odometry that halted, and when; speed (m/s): the mean of the second before."""

    stamp_ns: int
    speed: float


def halt_of(samples: SampleHistory) -> Halt | None:
    """Whether the newest samples repeat themselves to the bit, and the last step before was in full motion: an odometry
    fails so, a robot stops in several steps. None if not; no speed (NaN) where no sample known is another one.
    """
    if not samples.is_repeated:
        return None
    times, table = samples.arrays
    differs = np.flatnonzero((table != table[-1]).any(axis=1))
    if not len(differs):
        return Halt(int(times[0]), math.nan)
    halt = int(differs[-1]) + 1
    first = min(int(np.searchsorted(times, times[halt] - NANOSECONDS)), halt - 1)  # there may be a gap
    last, mean = (
        float(np.hypot(*(table[halt] - table[k])[:2])) * NANOSECONDS / int(times[halt] - times[k])
        for k in (halt - 1, first)
    )
    return Halt(int(times[halt]), mean) if last > HALT_M_S and times[-1] - times[halt] >= HALT_S * NANOSECONDS else None


class Odometry:
    """The odometry of the last seconds: dead reckoning by the robot itself, from driven wheels or steps.

    samples: x, y, theta (m, m, rad; odometry frame).
    """

    def __init__(self, settings: OdometrySettings) -> None:
        self.settings = settings
        self.samples = SampleHistory(columns=3, angle=2)

    def between(self, start_ns: int, end_ns: int) -> Motion:
        """The robot's motion from one stamp to a later one.

        Before the first sample and beyond the end of the extrapolation it stands still, for all that is known.
        """
        covariance: FloatArray = np.zeros((3, 3))
        step, missing_s = moved(*self.samples.arrays, start_ns, end_ns, self.settings.scales, covariance)
        return Motion(Pose(*step), covariance, missing_s)

    def pose_at(self, stamp_ns: int) -> Pose:
        """Pose in the odometry frame, carried on a little beyond the newest sample."""
        return Pose(*odometry_pose(*self.samples.arrays, stamp_ns).tolist())
