"""Motion between two images whose stamps are late, and what it changes by if they are later."""

import math
from typing import NamedTuple

import numpy as np

from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.motion.history import MotionHistory
from touchline.motion.odometry import (
    DRIFT_M,
    DRIFT_RAD,
    TRAVEL_NOISE_M,
    TRAVEL_NOISE_RAD,
    TURN_NOISE_RAD,
    UNKNOWN_SPEED_M_S,
    UNKNOWN_TURN_RAD_S,
    Motion,
)
from touchline.motion.samples import NANOSECONDS

_MEAN_S = 0.2  # over which a speed is a mean: shorter, and odometry's noise is what changes it
_MEAN_NS = int(_MEAN_S * NANOSECONDS)
_MAX_PAUSE_NS = int(0.25 * NANOSECONDS)  # of the odometry, over which a speed is one
CHANGE_RATIO = 0.3  # of a velocity that only images tell, from one image to the next
_CLEARLY = 2.5  # standard deviations of odometry's noise from which a change of speed is one

Vector = tuple[float, float, float]  # ahead, left, turning; plain floats: NumPy takes longer for three


class Delayed(NamedTuple):
    """A motion by what the odometry told late_s (s) before the stamps of its ends.

    by_delay (3,): derivative of its pose by late_s, robot frame before it (m/s, m/s, rad/s); zeros where the speed does
    not change clearly or is not known, for noise and pauses say nothing of a delay. after (3,): the robot's velocity
    after it, robot frame there.
    """

    motion: Motion
    late_s: float
    by_delay: FloatArray
    after: FloatArray


def delayed(history: MotionHistory, start_ns: int, end_ns: int, late_s: float) -> Delayed:
    """The motion from one image to the next, both stamped late_s after they were taken."""
    late_ns = round(late_s * NANOSECONDS)
    motion = history.between(start_ns - late_ns, end_ns - late_ns)
    ahead_ns = _ahead_ns(history, end_ns - late_ns)
    before, after = (_velocity(history, stamp_ns - late_ns + ahead_ns) for stamp_ns in (start_ns, end_ns))
    x = y = turn = 0.0
    pause_ns = history.odometry.samples.longest_pause_ns(start_ns - late_ns - _MEAN_NS, end_ns - late_ns)
    if motion.missing_s == 0.0 and pause_ns <= _MAX_PAUSE_NS:
        cosine, sine = math.cos(motion.pose.heading), math.sin(motion.pose.heading)
        x, y, turn = by_begin(motion.pose, before)
        x -= cosine * after[0] - sine * after[1]
        y -= sine * after[0] + cosine * after[1]
        turn -= after[2]
        position2, turn2 = _noise2(after, (end_ns - start_ns) / NANOSECONDS)
        if x**2 + y**2 < _CLEARLY**2 * position2:
            x = y = 0.0
        if turn**2 < _CLEARLY**2 * turn2:
            turn = 0.0
    return Delayed(motion, late_s, np.array([x, y, turn]), np.array(after))


def _noise2(velocity: Vector, seconds: float) -> tuple[float, float]:
    """Variances of the difference of two velocities so many seconds apart, of position's each and of turning's."""
    x, y, turning = velocity
    speed, apart = math.hypot(x, y), 2.0 * min(seconds, _MEAN_S) / _MEAN_S**2
    position2 = TRAVEL_NOISE_M**2 * speed + DRIFT_M**2
    return apart * position2, apart * (TRAVEL_NOISE_RAD**2 * speed + TURN_NOISE_RAD**2 * abs(turning) + DRIFT_RAD**2)


def moving(velocity: FloatArray, seconds: float, late_s: float) -> Delayed:
    """The motion over some time at a velocity (3,), robot frame (m/s, m/s, rad/s), that no odometry tells."""
    speed, turning = math.hypot(velocity[0], velocity[1]), abs(float(velocity[2]))
    position = (CHANGE_RATIO * speed + UNKNOWN_SPEED_M_S / 2.0) * seconds
    turn = (CHANGE_RATIO * turning + UNKNOWN_TURN_RAD_S / 2.0) * seconds
    covariance = np.diag(np.square([position, position, turn]))
    motion = Motion(Pose(*(seconds * velocity).tolist()), covariance, seconds)
    return Delayed(motion, late_s, np.zeros(3), np.zeros(3))


def until_stamp(history: MotionHistory, stamp_ns: int, late_s: float) -> Delayed:
    """The motion from when an image was taken to its stamp, late_s after that (before that, where negative)."""
    taken_ns = stamp_ns - round(late_s * NANOSECONDS)
    motion = history.between(min(taken_ns, stamp_ns), max(taken_ns, stamp_ns))
    if late_s < 0.0:
        motion = motion._replace(pose=motion.pose.inverse())
    before = _velocity(history, taken_ns + _ahead_ns(history, taken_ns))
    return Delayed(motion, late_s, np.array(by_begin(motion.pose, before)), np.zeros(3))


def by_begin(moved: Pose, before: Vector) -> Vector:
    """Derivative of a motion by how much earlier it begins, at a velocity there."""
    x, y, turning = before
    return x - turning * moved.y, y + turning * moved.x, turning


def _ahead_ns(history: MotionHistory, stamp_ns: int) -> int:
    """How long after a stamp the time may end over which a speed there is a mean: half of it, or what is known."""
    samples = history.odometry.samples
    return min(_MEAN_NS // 2, samples.last_ns - stamp_ns) if len(samples) else 0


def _velocity(history: MotionHistory, end_ns: int) -> Vector:
    """Of the robot by its odometry: the mean until a stamp; zeros where none is known."""
    samples = history.odometry.samples
    if len(samples) < 2 or not samples.first_ns < end_ns <= samples.last_ns:
        return 0.0, 0.0, 0.0
    start_ns = max(end_ns - _MEAN_NS, samples.first_ns)
    start, end = samples.at(start_ns), samples.at(end_ns)
    seconds = (end_ns - start_ns) / NANOSECONDS
    x, y, turn = (b - a for a, b in zip(start, end, strict=True))
    heading = start[2] + 0.5 * turn
    cosine, sine = math.cos(heading), math.sin(heading)
    return (cosine * x + sine * y) / seconds, (cosine * y - sine * x) / seconds, wrap_angle(turn) / seconds
