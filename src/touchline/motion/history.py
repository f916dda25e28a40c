"""The recent samples of one sensor, looked up by time."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from touchline.geometry import FloatArray, wrap_angles
from touchline.types import Samples

NANOSECONDS = 1e9


class History:
    """Samples of one sensor in the order of time; those older than `keep_s` before the newest are forgotten.

    Rows with a value that is not finite and rows that don't come after the newest are left out and counted in
    `dropped`. `angles`: columns that hold angles (rad); they are unwrapped here and interpolate the short way.
    """

    def __init__(self, columns: int, angles: tuple[int, ...] = (), keep_s: float = 5.0) -> None:
        self.stamp_ns: npt.NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        self.values: FloatArray = np.zeros((0, columns))
        self.dropped = 0
        self._angles = angles
        self._keep_ns = int(keep_s * NANOSECONDS)

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def add(self, samples: Samples | None) -> None:
        """Append samples; their first columns are used. None, when the sensor said nothing, is fine."""
        if samples is None or len(samples) == 0:
            return
        values = samples.values[:, : self.values.shape[1]]
        newest = np.maximum.accumulate(samples.stamp_ns)
        before = np.concatenate(([self.stamp_ns[-1] if len(self) else np.iinfo(np.int64).min], newest[:-1]))
        usable = np.all(np.isfinite(values), axis=1) & (samples.stamp_ns > before)
        self.dropped += int(len(usable) - np.count_nonzero(usable))
        if not np.any(usable):
            return
        fresh = np.array(values[usable], dtype=np.float64)
        for column in self._angles:
            last = self.values[-1, column] if len(self) else 0.0
            fresh[:, column] = last + np.unwrap(np.concatenate(([0.0], wrap_angles(fresh[:, column] - last))))[1:]
        self.stamp_ns = np.concatenate((self.stamp_ns, samples.stamp_ns[usable]))
        self.values = np.concatenate((self.values, fresh))
        first = int(np.searchsorted(self.stamp_ns, self.stamp_ns[-1] - self._keep_ns))
        self.stamp_ns, self.values = self.stamp_ns[first:], self.values[first:]

    def clear(self) -> None:
        """Forget all samples."""
        self.stamp_ns, self.values = self.stamp_ns[:0], self.values[:0]

    def at(self, stamp_ns: int) -> FloatArray:
        """Values (columns,) by linear interpolation; before the first and after the last sample, that sample's."""
        if len(self) == 0:
            raise ValueError("there are no samples to look up")
        offsets = (self.stamp_ns - stamp_ns).astype(np.float64)
        return np.array([np.interp(0.0, offsets, column) for column in self.values.T])

    def slope(self, window_s: float) -> FloatArray:
        """Rate of change (columns,) per second over the newest `window_s`; zero with fewer than two samples there."""
        if len(self) == 0:
            return np.zeros(self.values.shape[1])
        first = int(np.searchsorted(self.stamp_ns, self.stamp_ns[-1] - int(window_s * NANOSECONDS)))
        if len(self) - first < 2:
            return np.zeros(self.values.shape[1])
        t = (self.stamp_ns[first:] - self.stamp_ns[-1]) / NANOSECONDS
        t = t - t.mean()
        return np.asarray(t @ (self.values[first:] - self.values[first:].mean(axis=0)) / (t @ t))
