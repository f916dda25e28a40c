"""The recent samples of one sensor, looked up by time."""

import math
from bisect import bisect_left, bisect_right

import numpy as np
from numba import njit

from touchline.geometry import FloatArray, IntArray
from touchline.types import MAX_VALUE, Samples

NANOSECONDS = 1e9
_FULL_TURN = 2.0 * math.pi
EXTRAPOLATION_S = 0.1  # how long the last motion is believed to go on without samples: one image period


@njit(cache=True, error_model="numpy")
def row_after(times, stamp_ns):  # type: ignore[no-untyped-def]
    """Row of the first of the times (N,), in order, that lies after a stamp."""
    low, high = 0, len(times)
    while low < high:
        middle = (low + high) // 2
        if times[middle] > stamp_ns:
            high = middle
        else:
            low = middle + 1
    return low


@njit(cache=True, error_model="numpy")
def interpolate(times, table, stamp_ns, out):  # type: ignore[no-untyped-def]
    """`SampleHistory.at` for its `arrays`, into out (columns,)."""
    after = row_after(times, stamp_ns)
    low, high = max(after - 1, 0), min(after, len(times) - 1)
    share = 0.0 if low == high else float(stamp_ns - times[low]) / float(times[high] - times[low])
    for k in range(len(out)):
        out[k] = table[low, k] + share * (table[high, k] - table[low, k])


@njit(cache=True, error_model="numpy")
def slope_of(times, table, start_ns):  # type: ignore[no-untyped-def]
    """Rate of change (columns,) per second of samples from a stamp on; zeros of fewer than two."""
    first, last = row_after(times, start_ns - 1), len(times) - 1
    slope, count = np.zeros(table.shape[1]), last + 1 - first
    if count < 2:
        return slope
    mean_s = squares = 0.0
    for i in range(first, last + 1):
        mean_s += float(times[i] - times[last]) / NANOSECONDS / count
    for i in range(first, last + 1):
        squares += (float(times[i] - times[last]) / NANOSECONDS - mean_s) ** 2
    for k in range(len(slope)):
        mean = 0.0
        for i in range(first, last + 1):
            mean += table[i, k] / count
        for i in range(first, last + 1):
            slope[k] += (float(times[i] - times[last]) / NANOSECONDS - mean_s) * (table[i, k] - mean) / squares
    return slope


class SampleHistory:
    """Samples of one sensor in the order of time, until `forget_before`.

    Rows with a value that is no number or too large, and rows that don't come after the newest are left out and counted
    in `dropped`. `angle`: the column that holds one (rad); it is unwrapped here and interpolates the short way.
    """

    # Plain lists: a frame brings a handful of rows, for which arrays cost ten times as much. `arrays` is made of what
    # is new when somebody asks for it.

    def __init__(self, columns: int, angle: int | None = None) -> None:
        self.dropped = 0
        self._columns = columns
        self._angle = angle
        self._arrays: tuple[IntArray, FloatArray] | None = None  # views of the newest times and table
        self.clear()

    def __len__(self) -> int:
        return len(self._stamps_ns)

    @property
    def first_ns(self) -> int:
        """Stamp of the oldest sample kept. Raises IndexError without samples."""
        return self._stamps_ns[0]

    @property
    def last_ns(self) -> int:
        """Stamp of the newest sample. Raises IndexError without samples."""
        return self._stamps_ns[-1]

    @property
    def last(self) -> list[float]:
        """Values (columns,) of the newest sample, not to be changed. Raises IndexError without samples."""
        return self._rows[-1]

    def add(self, samples: Samples | None) -> None:
        """Append samples; their first columns are used. None, when the sensor said nothing, is fine."""
        if samples is None:
            return
        stamps_ns, rows, angle = self._stamps_ns, self._rows, self._angle
        newest_ns, self._arrays = stamps_ns[-1] if stamps_ns else -math.inf, None
        last = 0.0 if angle is None or not rows else rows[-1][angle]
        for stamp_ns, row in zip(samples.stamp_ns.tolist(), samples.values[:, : self._columns].tolist(), strict=True):
            if not (math.hypot(*row) < MAX_VALUE and stamp_ns > newest_ns):
                self.dropped += 1
                continue
            if angle is not None:
                row[angle] = last = last + math.remainder(row[angle] - last, _FULL_TURN)
            newest_ns = stamp_ns
            stamps_ns.append(stamp_ns)
            rows.append(row)

    def append(self, stamp_ns: int, row: list[float]) -> None:
        """Append one sample that is finite and later than the newest."""
        self._stamps_ns.append(stamp_ns)
        self._rows.append(row)
        self._arrays = None

    def stamps_within(self, start_ns: int, end_ns: int) -> list[int]:
        """Stamps of the samples after one stamp and before another, in the order of time."""
        return self._stamps_ns[bisect_right(self._stamps_ns, start_ns) : bisect_left(self._stamps_ns, end_ns)]

    def forget_before(self, stamp_ns: int) -> None:
        """Forget what isn't needed to look up values from a stamp on."""
        old = bisect_right(self._stamps_ns, stamp_ns) - 1
        if old > 0:
            del self._stamps_ns[:old], self._rows[:old]
            self._begin += min(old, self._end - self._begin)
            self._arrays = None

    def clear(self) -> None:
        """Forget all samples."""
        self._stamps_ns: list[int] = []
        self._rows: list[list[float]] = []
        self._begin, self._end = 0, 0  # rows of the table that hold the oldest samples
        self._times, self._table = np.zeros(0, dtype=np.int64), np.zeros((0, self._columns))
        self._arrays = None
        self._slope: tuple[int, float, FloatArray] | None = None

    @property
    def arrays(self) -> tuple[IntArray, FloatArray]:
        """Stamps (N,) and values (N, columns), not to be changed."""
        if self._arrays is None:
            begin, copied, end = self._begin, self._end, self._begin + len(self)
            if end > len(self._times):
                times, table, known = self._times, self._table, slice(begin, copied)
                begin, copied, end = 0, copied - begin, len(self)
                self._times, self._table = (
                    np.empty(2 * end + 64, dtype=np.int64),
                    np.empty((2 * end + 64, self._columns)),
                )
                self._times[:copied], self._table[:copied] = times[known], table[known]
            if end > copied:
                self._times[copied:end] = self._stamps_ns[copied - end :]
                self._table[copied:end] = self._rows[copied - end :]
            self._begin, self._end = begin, end
            self._arrays = self._times[begin:end], self._table[begin:end]
        return self._arrays

    @property
    def is_repeated(self) -> bool:
        """Whether the newest sample has the values of the one before."""
        return len(self._rows) > 1 and self._rows[-1] == self._rows[-2]

    def at(self, stamp_ns: int) -> list[float]:
        """Values (columns,) by linear interpolation; before the first and after the last sample, that sample's."""
        if not self._rows:
            raise ValueError("there are no samples to look up")
        after = bisect_right(self._stamps_ns, stamp_ns)
        if after == 0 or after == len(self):
            return list(self._rows[min(after, len(self) - 1)])
        start_ns, end_ns = self._stamps_ns[after - 1], self._stamps_ns[after]
        share = (stamp_ns - start_ns) / (end_ns - start_ns)
        return [a + share * (b - a) for a, b in zip(self._rows[after - 1], self._rows[after], strict=True)]

    def rows_within(self, start_ns: int, end_ns: int) -> list[list[float]]:
        """Values of the samples from one stamp to another, both included; not to be changed."""
        return self._rows[bisect_left(self._stamps_ns, start_ns) : bisect_right(self._stamps_ns, end_ns)]

    def slope(self, window_s: float) -> FloatArray:
        """Rate of change (columns,) per second over the newest `window_s`; zero with fewer than two samples there."""
        if len(self) < 2:
            return np.zeros(self._columns)
        newest_ns = self._stamps_ns[-1]
        if self._slope is None or self._slope[:2] != (newest_ns, window_s):
            start_ns = newest_ns - int(window_s * NANOSECONDS)
            self._slope = newest_ns, window_s, slope_of(*self.arrays, start_ns)
        return self._slope[2]
