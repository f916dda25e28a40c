"""Sensors that are summed up: wheel counters that may start again at zero, turning rates with gaps."""

from __future__ import annotations

import math
from collections.abc import Iterable

from touchline.motion.history import NANOSECONDS, History
from touchline.types import Samples

_ZEROED_M_S = 1.0  # a step to exactly zero at less than this speed is no restart but a robot that rolls about


class Sum(History):
    """Summed-up samples, and the times in which the sum is not known.

    Values are continuous: a piece that is missing is bridged by the motion around it and noted. Nothing is forgotten
    by its age, but by `forget_before` once it has been used.
    """

    def __init__(self, columns: int, reach_s: float) -> None:
        """reach_s: how long the last motion is believed to go on after the newest sample (s)."""
        super().__init__(columns)
        self._reach_ns = int(reach_s * NANOSECONDS)
        self._missing_ns: list[tuple[int, int]] = []

    def gaps_ns(self, start_ns: int, end_ns: int) -> list[tuple[int, int]]:
        """Pieces between two stamps in which nothing is known of the sensor: first and last stamp of each."""
        if len(self) == 0:
            return [(start_ns, end_ns)]
        outside = [(start_ns, self.first_ns), (self.last_ns + self._reach_ns, end_ns)]
        pieces = ((max(first, start_ns), min(last, end_ns)) for first, last in (*outside, *self._missing_ns))
        return [(first, last) for first, last in pieces if first < last]

    def forget_before(self, stamp_ns: int) -> None:
        """As History's; gaps that have passed are forgotten, too."""
        super().forget_before(stamp_ns)
        self._missing_ns = [gap for gap in self._missing_ns if gap[1] > stamp_ns]

    def clear(self) -> None:
        """Forget all samples."""
        super().clear()
        self._missing_ns = []

    def _append(self, stamp_ns: int, row: list[float], missing: bool) -> None:
        if missing:
            self._missing_ns.append((self.last_ns, stamp_ns))
        self.append(stamp_ns, row)


def covered_s(pieces_ns: Iterable[tuple[int, int]]) -> float:
    """Time (s) that pieces, each with first and last stamp, cover together; where they overlap it counts once."""
    pieces_ns = sorted(pieces_ns)
    total_ns, until_ns = 0, pieces_ns[0][0] if pieces_ns else 0
    for first_ns, last_ns in pieces_ns:
        total_ns += max(last_ns - max(first_ns, until_ns), 0)
        until_ns = max(until_ns, last_ns)
    return total_ns / NANOSECONDS


class WheelCounters(Sum):
    """Travels of wheels a and b (m), going on where a counter was set to zero."""

    def __init__(self, scales: tuple[float, float], most_speed_m_s: float, reach_s: float) -> None:
        """scales: true travel per travel counted. most_speed_m_s: a step faster than that is a restart."""
        super().__init__(2, reach_s)
        self._scales = scales
        self._most_speed_m_s = most_speed_m_s
        self._counted: list[float] = []
        self.restarts = 0

    def add_counts(self, samples: Samples | None) -> None:
        """Append counter readings a, b (m). Rows that aren't finite or not later than the newest are dropped."""
        if samples is None:
            return
        for stamp_ns, values in zip(samples.stamp_ns.tolist(), samples.values.tolist(), strict=True):
            counted = values[:2]
            if not all(map(math.isfinite, counted)) or (len(self) and stamp_ns <= self.last_ns):
                self.dropped += 1
                continue
            if len(self) == 0:
                self._append(stamp_ns, [0.0, 0.0], missing=False)
            else:
                self._continue(stamp_ns, counted)
            self._counted = counted

    def clear(self) -> None:
        """Forget all samples."""
        super().clear()
        self._counted = []

    def _continue(self, stamp_ns: int, counted: list[float]) -> None:
        last, duration_s = self.at(self.last_ns), (stamp_ns - self.last_ns) / NANOSECONDS
        steps = [new - old for new, old in zip(counted, self._counted, strict=True)]
        speed_m_s = max(abs(step) for step in steps) / duration_s
        zeroed = counted == [0.0, 0.0] and speed_m_s > _ZEROED_M_S
        restarted = zeroed or speed_m_s > self._most_speed_m_s
        if restarted:
            self.restarts += 1
            reach_s = self._reach_ns / NANOSECONDS
            steps = [float(rate) * min(duration_s, reach_s) for rate in self.slope(reach_s)]
        else:
            steps = [scale * step for scale, step in zip(self._scales, steps, strict=True)]
        self._append(stamp_ns, [x + step for x, step in zip(last, steps, strict=True)], restarted)


class Turning(Sum):
    """Equation (1): the turning rate of a gyro, summed up to an angle by trapezoids."""

    def __init__(self, scale: float, bias_rad_s: float, gap_s: float, reach_s: float) -> None:
        """True rate = scale · (reading − bias). gap_s: longer without a reading, and the turn is not known."""
        super().__init__(1, reach_s)
        self._scale = scale
        self._bias_rad_s = bias_rad_s
        self._gap_ns = int(gap_s * NANOSECONDS)
        self._rate_rad_s = 0.0

    def add_rates(self, samples: Samples | None) -> None:
        """Append readings gx, gy, gz (rad/s). Rows whose gz isn't finite or not later than the newest are dropped."""
        if samples is None:
            return
        for stamp_ns, reading in zip(samples.stamp_ns.tolist(), samples.values[:, 2].tolist(), strict=True):
            if not math.isfinite(reading) or (len(self) and stamp_ns <= self.last_ns):
                self.dropped += 1
                continue
            rate_rad_s = self._scale * (reading - self._bias_rad_s)
            if len(self) == 0:
                self._append(stamp_ns, [0.0], missing=False)
            else:
                duration_ns = stamp_ns - self.last_ns
                turned_rad = 0.5 * (self._rate_rad_s + rate_rad_s) * duration_ns / NANOSECONDS
                self._append(stamp_ns, [self.at(self.last_ns)[0] + turned_rad], duration_ns > self._gap_ns)
            self._rate_rad_s = rate_rad_s
