"""Motion between two images whose stamps are late, and what it changes by if they are later."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.geometry import FloatArray, Pose
from touchline.matrices import copy_row
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
    wrapped,
)
from touchline.motion.samples import NANOSECONDS, interpolate, row_after

_MEAN_S = 0.2  # over which a speed is a mean: shorter, and odometry's noise is what changes it
_MEAN_NS = int(_MEAN_S * NANOSECONDS)
_MAX_PAUSE_NS = int(0.25 * NANOSECONDS)  # of the odometry, over which a speed is one
# variances per way (m, rad) of an odometry whose sign is put right, and of one whose sign may be wrong, too
_FLIPPED, _UNPROVED = 0.05, 0.5
CHANGE_RATIO = 0.3  # of a velocity that only images tell, from one image to the next
_CLEARLY = 2.5  # standard deviations of odometry's noise from which a change of speed is one


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
    span_ns = start_ns - late_ns, end_ns - late_ns
    by_delay, after = np.zeros(3), np.empty(3)
    _by_delay(*history.odometry.samples.arrays, span_ns, motion.pose, motion.missing_s == 0.0, by_delay, after)
    return Delayed(motion, late_s, by_delay, after)


@njit(cache=True, error_model="numpy")
def _by_delay(times, table, span_ns, step, known, off, after):  # type: ignore[no-untyped-def]
    """Fill `by_delay` (zeros before) and `after` of a `Delayed` from one stamp to another, by the arrays of the
    odometry's samples.

    step: the motion; known: whether the odometry covers all of it.
    """
    start_ns, end_ns = span_ns
    ahead_ns = _ahead_ns(times, end_ns)
    before = _velocity(times, table, start_ns + ahead_ns)
    copy_row(_velocity(times, table, end_ns + ahead_ns), after)
    if not known or _longest_pause_ns(times, start_ns - _MEAN_NS, end_ns) > _MAX_PAUSE_NS:
        return
    cosine, sine = math.cos(step[2]), math.sin(step[2])
    copy_row(_by_begin(step, before), off)
    off[0] -= cosine * after[0] - sine * after[1]
    off[1] -= sine * after[0] + cosine * after[1]
    off[2] -= after[2]
    # variances of the difference of the two velocities
    speed, seconds = math.hypot(after[0], after[1]), float(end_ns - start_ns) / NANOSECONDS
    apart = 2.0 * min(seconds, _MEAN_S) / _MEAN_S**2
    position2 = apart * (TRAVEL_NOISE_M**2 * speed + DRIFT_M**2)
    turn2 = apart * (TRAVEL_NOISE_RAD**2 * speed + TURN_NOISE_RAD**2 * abs(after[2]) + DRIFT_RAD**2)
    if off[0] ** 2 + off[1] ** 2 < _CLEARLY**2 * position2:
        off[0] = off[1] = 0.0
    if off[2] ** 2 < _CLEARLY**2 * turn2:
        off[2] = 0.0


def moving(velocity: tuple[float, float, float], seconds: float, late_s: float) -> Delayed:
    """The motion over some time at a velocity, robot frame (m/s, m/s, rad/s), that no odometry tells."""
    speed, turning = math.hypot(velocity[0], velocity[1]), abs(velocity[2])
    position = (CHANGE_RATIO * speed + UNKNOWN_SPEED_M_S / 2.0) * seconds
    turn = (CHANGE_RATIO * turning + UNKNOWN_TURN_RAD_S / 2.0) * seconds
    covariance = np.diag(np.square([position, position, turn]))
    motion = Motion(Pose(*(seconds * each for each in velocity)), covariance, seconds)
    return Delayed(motion, late_s, np.zeros(3), np.zeros(3))


def with_signs(moved: Delayed, signs: Sequence[int], seconds: float) -> Delayed:
    """A motion over some time by an odometry of whose (ahead, aside, turn) some have the wrong sign (-1). The others
    may have it, too: a robot that has not turned does not show it. It counts as missing odometry, so that other
    starts are tried.
    """
    step = moved.motion.pose.as_array()
    variances = np.where(np.array(signs) < 0, _FLIPPED, _UNPROVED) * np.abs(step)
    motion = Motion(Pose(*(signs * step).tolist()), moved.motion.covariance + np.diag(variances), seconds)
    return Delayed(motion, moved.late_s, np.zeros(3), np.zeros(3))


def until_stamp(history: MotionHistory, stamp_ns: int, late_s: float) -> Delayed:
    """The motion from when an image was taken to its stamp, late_s after that (before that, where negative)."""
    taken_ns = stamp_ns - round(late_s * NANOSECONDS)
    motion = history.between(min(taken_ns, stamp_ns), max(taken_ns, stamp_ns))
    if late_s < 0.0:
        motion = motion._replace(pose=motion.pose.inverse())
    by_begin = _by_begin_at(*history.odometry.samples.arrays, taken_ns, motion.pose)
    return Delayed(motion, late_s, by_begin, np.zeros(3))


@njit(cache=True, error_model="numpy")
def _by_begin_at(times, table, stamp_ns, step):  # type: ignore[no-untyped-def]
    return _by_begin(step, _velocity(times, table, stamp_ns + _ahead_ns(times, stamp_ns)))


@njit(cache=True, error_model="numpy")
def _by_begin(step, before):  # type: ignore[no-untyped-def]
    """Derivative (3,) of a motion by how much earlier it begins, at a velocity there (3,)."""
    return np.array([before[0] - before[2] * step[1], before[1] + before[2] * step[0], before[2]])


@njit(cache=True, error_model="numpy")
def _ahead_ns(times, stamp_ns):  # type: ignore[no-untyped-def]
    """How long after a stamp the time may end over which a speed there is a mean: half of it, or what is known."""
    return min(_MEAN_NS // 2, times[-1] - stamp_ns) if len(times) else 0


@njit(cache=True, error_model="numpy")
def _longest_pause_ns(times, start_ns, end_ns):  # type: ignore[no-untyped-def]
    """Longest time between neighbouring samples that are needed from one stamp to another (ns)."""
    longest_ns = 0
    for i in range(max(row_after(times, start_ns), 1), min(row_after(times, end_ns - 1) + 1, len(times))):
        longest_ns = max(longest_ns, times[i] - times[i - 1])
    return longest_ns


@njit(cache=True, error_model="numpy")
def _velocity(times, table, end_ns):  # type: ignore[no-untyped-def]
    """(3,) of the robot by its odometry, robot frame: the mean until a stamp; zeros where none is known."""
    velocity = np.zeros(3)
    if len(times) < 2 or not times[0] < end_ns <= times[-1]:
        return velocity
    start_ns, start, end = max(end_ns - _MEAN_NS, times[0]), np.empty(3), np.empty(3)
    interpolate(times, table, start_ns, start)
    interpolate(times, table, end_ns, end)
    seconds, x, y, turn = (
        float(end_ns - start_ns) / NANOSECONDS,
        end[0] - start[0],
        end[1] - start[1],
        end[2] - start[2],
    )
    heading = start[2] + 0.5 * turn
    cosine, sine = math.cos(heading), math.sin(heading)
    velocity[0], velocity[1] = (cosine * x + sine * y) / seconds, (cosine * y - sine * x) / seconds
    velocity[2] = wrapped(turn) / seconds
    return velocity
