"""How far the body leans at the moment of an image: the IMU's roll and pitch, which are late and noisy, with its rates.

A walking robot sways by 30° per second: 20 ms cost 0.6°, which is 20 cm at 4 m. The rates are not late; they carry the
angles on to the image, and what the angles say beyond that is averaged (a complementary filter).
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from touchline.geometry import Pose3
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
        self._integral: deque[tuple[int, float, float, float, float]] = deque(maxlen=_KEPT)  # stamp, angles, rates
        self._offset: tuple[float, float] | None = None  # of the angles beyond the integral
        self._angle_ns = self._newest_ns = 0

    def add(self, frame: Frame) -> None:
        """Take the rates and angles of a frame, those that run forward in time and not far beyond the frame: a sample
        that another clock has stamped would leave out all after it.
        """
        end_ns = frame.stamp_ns + round(MAX_AGE_S * NANOSECONDS)
        for stamp_ns, rates in _rows(frame.gyro if self.rates else None, end_ns):
            self._integrate(stamp_ns, rates[0], rates[1])
        for stamp_ns, angles in _rows(frame.tilt, end_ns):
            self._correct(stamp_ns, angles[0], angles[1])

    def lean(self, stamp_ns: int) -> tuple[float, float] | None:
        """Roll and pitch (rad) at a stamp; None without angles in the quarter of a second before."""
        if self._offset is None or abs(stamp_ns - self._angle_ns) > MAX_AGE_S * NANOSECONDS:
            return None
        roll, pitch = self.turned(stamp_ns)
        return self._offset[0] + roll, self._offset[1] + pitch

    def at_image(self, frame: Frame, late_ns: int = 0) -> Frame:
        """Add a frame's samples; the frame, with the lean late_ns before its stamp in the place of the angles, and with
        the camera's pose, which holds the same late angles, turned on by the rates.
        """
        self.add(frame)
        lean = self.lean(frame.stamp_ns - late_ns)
        tilt = None if lean is None else Samples(np.array([frame.stamp_ns]), np.array([lean]))
        camera = frame.base_from_camera
        if camera is not None:
            now, then = self.turned(frame.stamp_ns - late_ns), self.turned(frame.stamp_ns - round(LAG_S * NANOSECONDS))
            camera = Pose3.from_roll_pitch_yaw(now[0] - then[0], now[1] - then[1]).compose(camera)
        return replace(frame, tilt=tilt, base_from_camera=camera)

    def _integrate(self, stamp_ns: int, roll_rad_s: float, pitch_rad_s: float) -> None:
        roll = pitch = 0.0
        if self._integral:
            last_ns, roll, pitch, last_roll, last_pitch = self._integral[-1]
            half_s = 0.5 * min((stamp_ns - last_ns) / NANOSECONDS, MAX_AGE_S)
            if half_s <= 0.0:
                return
            roll, pitch = roll + half_s * (last_roll + roll_rad_s), pitch + half_s * (last_pitch + pitch_rad_s)
        self._integral.append((stamp_ns, roll, pitch, roll_rad_s, pitch_rad_s))

    def turned(self, stamp_ns: int) -> tuple[float, float]:
        """The integral of the rates at a stamp, extrapolated at both ends by the nearest rate; 0 without rates."""
        return self.turned_all((stamp_ns,))[0]

    def turned_all(self, stamps_ns: Sequence[int]) -> list[tuple[float, float]]:
        """`turned` at stamps, the newest first."""
        newest_first = reversed(self._integral)
        row, found = next(newest_first, (0, 0.0, 0.0, 0.0, 0.0)), []
        for stamp_ns in stamps_ns:
            while row[0] > stamp_ns and (before := next(newest_first, None)) is not None:
                row = before
            ahead_s = min(max((stamp_ns - row[0]) / NANOSECONDS, -MAX_AGE_S), MAX_AGE_S)
            found.append((row[1] + ahead_s * row[3], row[2] + ahead_s * row[4]))
        return found

    def _correct(self, stamp_ns: int, roll_rad: float, pitch_rad: float) -> None:
        if self._offset is not None and stamp_ns <= self._angle_ns:
            return
        turned = self.turned(stamp_ns - round(LAG_S * NANOSECONDS))
        roll, pitch = roll_rad - turned[0], pitch_rad - turned[1]
        gap_s = (stamp_ns - self._angle_ns) / NANOSECONDS
        if self._offset is None or gap_s > MAX_AGE_S or not self._integral:
            self._offset, self._age_s = (roll, pitch), 0.0
        else:
            self._age_s += gap_s
            gain = min(1.0, gap_s / min(self._age_s + gap_s, MEMORY_S))
            before = self._offset
            self._offset = before[0] + gain * (roll - before[0]), before[1] + gain * (pitch - before[1])
        self._angle_ns = stamp_ns


def _rows(samples: Samples | None, end_ns: int) -> list[tuple[int, list[float]]]:
    """Stamps and values up to a stamp, those that are measurements."""
    if samples is None:
        return []
    each = zip(samples.stamp_ns.tolist(), samples.values.tolist(), strict=True)
    return [
        (stamp_ns, row)
        for stamp_ns, row in each
        if stamp_ns <= end_ns and all(abs(value) < MAX_VALUE for value in row[:2])
    ]
