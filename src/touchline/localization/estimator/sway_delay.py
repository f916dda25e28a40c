"""How late the images of a walking robot are stamped, by how it sways: lines give the lean at the image, the IMU's
rates the lean before and after.

A robot that walks sways by 20° per second, so that an image gives the time to 10 ms, and thirty of them to 2 ms.
"""

import math

import numpy as np
from numba import njit

from touchline.geometry import FloatArray
from touchline.localization.camera_errors.perspective import ahead
from touchline.motion import LeanFilter

LAGS_S = np.arange(-0.05, 0.26, 0.01)  # by how much stamps may be late: a driver that waits, a network
_LAGS_NS, _STEP_S = np.rint(1e9 * LAGS_S).astype(np.int64), float(LAGS_S[1] - LAGS_S[0])
MEMORY_IMAGES = 150  # over which it is averaged
KEPT = 1.0 - 1.0 / MEMORY_IMAGES
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
        taken_ns = np.full(len(_LAGS_NS) + 1, stamp_ns - round(1e9 * lag_s))
        taken_ns[:-1] = stamp_ns - _LAGS_NS
        turned = leaning.turned_all(taken_ns)
        best = _add(self._squares, lean_rad, turned)
        if best < 0:
            return self.delay_s, self.deviation_s
        self._images = KEPT * self._images + 1.0
        self.delay_s, self.deviation_s = 0.0, math.inf
        if self._images >= MIN_IMAGES and 0 < best < len(LAGS_S) - 1:
            below, least, above = self._squares[best - 1 : best + 2].tolist()
            bend = (below - 2.0 * least + above) / _STEP_S**2
            self.delay_s = float(LAGS_S[best]) + 0.5 * _STEP_S * (below - above) / (below - 2.0 * least + above)
            variance = least / self._images / bend  # each of the two leans errs by half of the mean square
            self.deviation_s = math.sqrt(variance + CLOCK_S**2)
        return self.delay_s, self.deviation_s


@njit(cache=True)
def _add(squares: FloatArray, lean_rad: FloatArray, turned_rad: FloatArray) -> int:
    """Into the sums of squares (L,) the lean of an image (2,) and the leans (L + 1, 2) by the IMU, that at the time of
    the image last; returns the index of the least sum, -1 where nothing is taken.
    """
    if not np.isfinite(turned_rad).all() or not np.abs(lean_rad).max() <= MAX_RAD:
        return -1
    best = 0
    for k in range(len(squares)):
        squares[k] *= KEPT
        for axis in range(2):
            squares[k] += (lean_rad[axis] - (turned_rad[k, axis] - turned_rad[-1, axis])) ** 2
        best = k if squares[k] < squares[best] else best
    return best


def lean_by(attitude: FloatArray, axis: FloatArray) -> FloatArray:
    """Roll and pitch (2,) about the robot's axes of a camera that looks along an axis, from those about its own."""
    (roll, pitch), (x, y) = attitude.tolist(), ahead(axis)
    return np.array([x * roll - y * pitch, y * roll + x * pitch])
