"""How late the images of a walking robot are stamped, by how it sways: lines give the lean at the image, the IMU's
rates the lean before and after.

A robot that walks sways by 20° per second, so that an image gives the time to 10 ms, and thirty of them to 2 ms.
"""

import math

import numpy as np

from touchline.geometry import FloatArray
from touchline.localization.camera_errors.perspective import ahead
from touchline.motion import LeanFilter

LAGS_S = np.arange(-0.05, 0.26, 0.01)  # by how much stamps may be late: a driver that waits, a network
MEMORY_IMAGES = 150  # over which it is averaged
MIN_IMAGES = 40  # five seconds
CLOCK_S = 0.005  # standard deviation of what an IMU's own stamps err by
MAX_RAD = 0.15  # error of a lean beyond which an image was taken for another place's


class SwayDelay:
    """`delay_s`, `deviation_s`: what it is, and its standard deviation; infinite while nothing is known."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Nothing is known."""
        self.delay_s, self.deviation_s = 0.0, math.inf
        self._squares, self._images = np.zeros(len(LAGS_S)), 0.0

    def update(self, lean_rad: FloatArray, leaning: LeanFilter, stamp_ns: int, lag_s: float) -> tuple[float, float]:
        """Take an image stamped so; returns `delay_s` and `deviation_s`.

        lean_rad (2,): lean of the camera by the lines, without its mounting error, less that by the IMU lag_s before
        the stamp. leaning: the lean by the IMU.
        """
        lags_ns = np.rint(1e9 * np.append(LAGS_S, lag_s)).astype(np.int64)
        turned = leaning.turned_all(stamp_ns - lags_ns)
        self._add(lean_rad, turned[:-1] - turned[-1])
        return self.delay_s, self.deviation_s

    def _add(self, lean_rad: FloatArray, turned_rad: FloatArray) -> None:
        """turned_rad (L, 2): further lean by the IMU at each of LAGS_S before the stamp."""
        if not np.isfinite(turned_rad).all() or np.abs(lean_rad).max() > MAX_RAD:
            return
        kept = 1.0 - 1.0 / MEMORY_IMAGES
        self._squares = kept * self._squares + ((lean_rad - turned_rad) ** 2).sum(axis=1)
        self._images = kept * self._images + 1.0
        best = int(np.argmin(self._squares))
        if self._images < MIN_IMAGES or best in (0, len(LAGS_S) - 1):
            self.delay_s, self.deviation_s = 0.0, math.inf
            return
        below, least, above = self._squares[best - 1 : best + 2]
        step_s = float(LAGS_S[1] - LAGS_S[0])
        bend = (below - 2.0 * least + above) / step_s**2
        self.delay_s = float(LAGS_S[best] + 0.5 * step_s * (below - above) / (below - 2.0 * least + above))
        variance = least / self._images / bend  # each of the two leans errs by half of the mean square
        self.deviation_s = math.sqrt(variance + CLOCK_S**2)


def lean_by(attitude: FloatArray, axis: FloatArray) -> FloatArray:
    """Roll and pitch (2,) about the robot's axes of a camera that looks along an axis, from those about its own."""
    (roll, pitch), (x, y) = attitude.tolist(), ahead(axis)
    return np.array([x * roll - y * pitch, y * roll + x * pitch])
