"""How far the body leans at the moment of an image: the IMU's roll and pitch, which are late and noisy, with its rates.

A walking robot sways by 30° per second: 20 ms cost 0.6°, which is 20 cm at 4 m. The rates are not late; they carry the
angles on to the image, and what the angles say beyond that is averaged (a complementary filter).
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.geometry import FloatArray, IntArray, Pose3
from touchline.motion.samples import NANOSECONDS
from touchline.types import MAX_VALUE, Frame, Samples

LAG_S = 0.02  # of roll and pitch behind the rates: what an attitude filter takes
MEMORY_S = 0.5  # over which angles are averaged: noise of 0.3° becomes 0.06°, and a bias of 0.5° per second 0.25°
MAX_AGE_S = 0.25  # of the newest angles
_KEPT = 256  # rates that may be looked up


class LeanFilter:
    """Takes the samples of frames one after another; `lean` tells roll and pitch at the newest."""

    def __init__(self, rates: bool = True) -> None:
        """rates: whether they carry the angles on; else the newest angles count as they are."""
        self.rates = rates
        self.clear()

    def clear(self) -> None:
        """Forget all samples."""
        self._integral = _Integral(np.zeros(2 * _KEPT, np.int64), np.zeros((2 * _KEPT, 4)), np.zeros(1, np.int64))
        self._offset = np.full(3, np.nan)  # of the angles beyond the integral, and for how long it was averaged (s)
        self._angle_ns = 0

    def add(self, frame: Frame) -> None:
        """Take the rates and angles of a frame, those that run forward in time and not far beyond the frame: a sample
        that another clock has stamped would leave out all after it.
        """
        end_ns = frame.stamp_ns + round(MAX_AGE_S * NANOSECONDS)
        if frame.gyro is not None and self.rates:
            rates = np.ascontiguousarray(frame.gyro.values)
            _integrate(self._integral, np.ascontiguousarray(frame.gyro.stamp_ns), rates, end_ns)
        if frame.tilt is not None:
            stamps_ns, angles = np.ascontiguousarray(frame.tilt.stamp_ns), np.ascontiguousarray(frame.tilt.values)
            self._angle_ns = _correct(self._integral, stamps_ns, angles, end_ns, self._offset, self._angle_ns)

    def lean(self, stamp_ns: int) -> tuple[float, float] | None:
        """Roll and pitch (rad) at a stamp; None without angles in the quarter of a second before."""
        roll, pitch, _ = self._offset.tolist()
        if math.isnan(roll) or abs(stamp_ns - self._angle_ns) > MAX_AGE_S * NANOSECONDS:
            return None
        turned = self.turned(stamp_ns)
        return roll + turned[0], pitch + turned[1]

    def at_image(self, frame: Frame, late_ns: int = 0) -> Frame:
        """Add a frame's samples; the frame, with the lean late_ns before its stamp in the place of the angles, and with
        the camera's pose, which holds the same late angles, turned on by the rates.
        """
        self.add(frame)
        lean = self.lean(frame.stamp_ns - late_ns)
        tilt = None if lean is None else Samples(np.array([frame.stamp_ns]), np.array([lean]))
        camera = frame.base_from_camera
        if tilt is frame.tilt and camera is None:  # neither is known
            return frame
        if camera is not None:
            now, then = self.turned(frame.stamp_ns - late_ns), self.turned(frame.stamp_ns - round(LAG_S * NANOSECONDS))
            camera = Pose3.from_roll_pitch_yaw(now[0] - then[0], now[1] - then[1]).compose(camera)
        return replace(frame, tilt=tilt, base_from_camera=camera)

    def turned(self, stamp_ns: int) -> tuple[float, float]:
        """The integral of the rates at a stamp, extrapolated at both ends by the nearest rate; 0 without rates."""
        roll, pitch = self.turned_all(np.array([stamp_ns]))[0].tolist()
        return roll, pitch

    def turned_all(self, stamps_ns: IntArray) -> FloatArray:
        """`turned` (N, 2) at stamps (N,)."""
        turned = np.empty((len(stamps_ns), 2))
        _turned_all(self._integral, stamps_ns, turned)
        return turned


class _Integral(NamedTuple):
    """Of the rates: stamps_ns (2 KEPT,); turns (2 KEPT, 4): roll, pitch and their rates; size (1,): of them."""

    stamps_ns: IntArray
    turns: FloatArray
    size: IntArray


@njit(cache=True)
def _is_measured(stamp_ns: int, row: FloatArray, end_ns: int) -> bool:
    return stamp_ns <= end_ns and abs(row[0]) < MAX_VALUE and abs(row[1]) < MAX_VALUE


@njit(cache=True)
def _integrate(integral: _Integral, stamps_ns: IntArray, rates: FloatArray, end_ns: int) -> None:
    """Go on by rates (N, 2 or more)."""
    stamps, turns = integral.stamps_ns, integral.turns
    for i in range(len(stamps_ns)):
        if not _is_measured(stamps_ns[i], rates[i], end_ns):
            continue
        roll = pitch = 0.0
        if integral.size[0] == len(stamps):  # the newest half is kept
            for k in range(_KEPT):
                stamps[k] = stamps[_KEPT + k]
                for column in range(4):
                    turns[k, column] = turns[_KEPT + k, column]
            integral.size[0] = _KEPT
        at = integral.size[0]
        if at:
            half_s = 0.5 * min((stamps_ns[i] - stamps[at - 1]) / NANOSECONDS, MAX_AGE_S)
            if half_s <= 0.0:
                continue
            roll = turns[at - 1, 0] + half_s * (turns[at - 1, 2] + rates[i, 0])
            pitch = turns[at - 1, 1] + half_s * (turns[at - 1, 3] + rates[i, 1])
        stamps[at] = stamps_ns[i]
        turns[at, 0], turns[at, 1], turns[at, 2], turns[at, 3] = roll, pitch, rates[i, 0], rates[i, 1]
        integral.size[0] += 1


@njit(cache=True)
def _turned(integral: _Integral, stamp_ns: int) -> tuple[float, float]:
    k = integral.size[0] - 1
    if k < 0:
        return 0.0, 0.0
    oldest = max(k + 1 - _KEPT, 0)
    while k > oldest and integral.stamps_ns[k] > stamp_ns:
        k -= 1
    ahead_s = min(max((stamp_ns - integral.stamps_ns[k]) / NANOSECONDS, -MAX_AGE_S), MAX_AGE_S)
    row = integral.turns[k]
    return row[0] + ahead_s * row[2], row[1] + ahead_s * row[3]


@njit(cache=True)
def _turned_all(integral: _Integral, stamps_ns: IntArray, turned: FloatArray) -> None:
    for i in range(len(stamps_ns)):
        turned[i, 0], turned[i, 1] = _turned(integral, stamps_ns[i])


@njit(cache=True)
def _correct(
    integral: _Integral, stamps_ns: IntArray, angles: FloatArray, end_ns: int, offset: FloatArray, angle_ns: int
) -> int:
    """Take angles (N, 2 or more), into the offset (3,); returns the stamp of the newest."""
    for i in range(len(stamps_ns)):
        known = not math.isnan(offset[0])
        if not _is_measured(stamps_ns[i], angles[i], end_ns) or (known and stamps_ns[i] <= angle_ns):
            continue
        turned = _turned(integral, stamps_ns[i] - np.int64(LAG_S * NANOSECONDS))
        roll, pitch = angles[i, 0] - turned[0], angles[i, 1] - turned[1]
        gap_s = (stamps_ns[i] - angle_ns) / NANOSECONDS
        if not known or gap_s > MAX_AGE_S or not integral.size[0]:
            offset[0], offset[1], offset[2] = roll, pitch, 0.0
        else:
            offset[2] += gap_s
            gain = min(1.0, gap_s / min(offset[2] + gap_s, MEMORY_S))
            offset[0] += gain * (roll - offset[0])
            offset[1] += gain * (pitch - offset[1])
        angle_ns = stamps_ns[i]
    return angle_ns
