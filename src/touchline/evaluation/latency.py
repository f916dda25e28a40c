"""Time spent per frame, in constant memory: counts in logarithmic bins instead of every value."""

import math
import platform
from pathlib import Path

import numpy as np

from touchline.evaluation.summary import Durations, Latency
from touchline.geometry import FloatArray

FIRST_MS = 1e-3
LAST_MS = 1e5
BINS_PER_DECADE = 200
START_FRAMES = 10  # in the first ones code is loaded and colours are learned: no measure of the speed


class LatencyHistogram:
    """Counts of durations (ms) in bins 1.2 % wide, 1 µs to 100 s; what lies outside falls in the end bins.

    Median and percentiles are the middle of their bin: within 0.6 % of the exact value.
    """

    def __init__(self) -> None:
        decades = math.log10(LAST_MS / FIRST_MS)
        self.edges_ms: FloatArray = np.logspace(
            math.log10(FIRST_MS), math.log10(LAST_MS), round(decades * BINS_PER_DECADE) + 1
        )
        self.counts = np.zeros(len(self.edges_ms) - 1, dtype=np.int64)
        self.max_ms = 0.0

    def add(self, duration_ms: float) -> None:
        """Count one frame."""
        place = int((math.log10(max(duration_ms, FIRST_MS)) - math.log10(FIRST_MS)) * BINS_PER_DECADE)
        self.counts[min(place, len(self.counts) - 1)] += 1
        self.max_ms = max(self.max_ms, duration_ms)

    def __len__(self) -> int:
        return int(self.counts.sum())

    def percentile_ms(self, percent: float) -> float:
        """The duration that `percent` of the frames do not exceed; NaN without frames."""
        total = len(self)
        if total == 0:
            return math.nan
        rank = max(1, math.ceil(total * percent / 100.0))
        place = int(np.searchsorted(np.cumsum(self.counts), rank))
        return min(math.sqrt(float(self.edges_ms[place] * self.edges_ms[place + 1])), self.max_ms)

    def summary(self) -> Durations:
        """Median, p99 and maximum (ms)."""
        if len(self) == 0:
            return Durations()
        median, p99 = self.percentile_ms(50), self.percentile_ms(99)
        return Durations(median=round(median, 4), p99=round(p99, 4), max=round(self.max_ms, 4))


class FrameTimes:
    """Time per frame of perception, of localization and of both together, the first START_FRAMES apart from the rest.

    Whatever tells a latency takes it from `summary`: there are no other medians and percentiles of a run.
    """

    def __init__(self) -> None:
        self._start = _histograms()
        self._later = _histograms()

    def add(self, perception_ms: float, localization_ms: float) -> None:
        """Count one frame."""
        group = self._start if len(self._start["total"]) < START_FRAMES else self._later
        for name, spent_ms in zip(
            group, (perception_ms, localization_ms, perception_ms + localization_ms), strict=True
        ):
            group[name].add(spent_ms)

    def summary(self) -> Latency:
        """Perception, localization and total, each of the frames after the first START_FRAMES.

        Where there are no others, no frames are left out.
        """
        has_later = len(self._later["total"]) > 0
        group = self._later if has_later else self._start
        return Latency(
            first_left_out=START_FRAMES if has_later else 0,
            **{name: histogram.summary() for name, histogram in group.items()},
            start_max=self._start["total"].summary().max,
        )


def _histograms() -> dict[str, LatencyHistogram]:
    return {name: LatencyHistogram() for name in ("perception", "localization", "total")}


def milliseconds(value_ms: float) -> str:
    """A duration with three digits that matter: 0.0123, 2.36, 1510."""
    return f"{value_ms:.0f}" if value_ms >= 100.0 else f"{value_ms:.3g}"


def cpu_name() -> str:
    """The processor's name, which every speed figure needs beside it."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass  # not Linux: what Python knows has to do
    return platform.processor() or platform.machine()
