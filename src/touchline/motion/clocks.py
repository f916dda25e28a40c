"""Stamps that can't be right: which samples are believed, and what becomes of a frame that runs backwards."""

from collections import Counter
from enum import Enum
from typing import NamedTuple

import numpy as np

from touchline.motion.samples import NANOSECONDS
from touchline.types import Samples

_JUMP_NS = int(1.0 * NANOSECONDS)  # ten image periods: drivers deliver late, but not by that much
_GAP_NS = int(10.0 * NANOSECONDS)  # longest silence of a camera that goes on: reconnecting takes some seconds
_USUAL_GAPS = 3  # a camera that is slower than that may leave out two images
_CONFIRMATIONS = 3  # one wrong stamp is a broken message, several that follow each other are a clock


class FrameOrder(Enum):
    """What a frame's stamp means after the newest frame before it."""

    NEXT = "next"
    """Not older."""
    LATE = "late"
    """Older by up to a second, as of a driver that mixes frames up: to be dropped."""
    UNCONFIRMED = "unconfirmed"
    """Far away: a broken stamp, unless the next frame is there, too."""
    CLOCK_SET_BACK = "clock set back"
    """Older by more than a second, as the one before it was: the histories have to start anew."""


class FrameClock:
    """Compares the stamps of frames with each other: one that jumps is believed when the next one confirms it.

    Far ahead is more than 10 s, or than three times the frames' last distance; the first distance can be any.
    """

    def __init__(self) -> None:
        self.newest_ns: int | None = None
        """Stamp of the newest frame that is believed; after a clock was set back, of the first one by the new clock."""
        self._gap_ns: int | None = None
        self._unconfirmed_ns: int | None = None

    def order(self, stamp_ns: int) -> FrameOrder:
        """How a frame follows those before it."""
        order = self._order(stamp_ns)
        if order is FrameOrder.UNCONFIRMED:
            self._unconfirmed_ns = stamp_ns
        elif order is not FrameOrder.LATE:
            if order is FrameOrder.NEXT and self.newest_ns is not None:
                self._gap_ns = stamp_ns - self.newest_ns
            self.newest_ns, self._unconfirmed_ns = stamp_ns, None
        return order

    def _order(self, stamp_ns: int) -> FrameOrder:
        ahead_ns = 0 if self.newest_ns is None else stamp_ns - self.newest_ns
        if -_JUMP_NS <= ahead_ns < 0:
            return FrameOrder.LATE
        if ahead_ns >= 0 and (self._gap_ns is None or ahead_ns <= max(_GAP_NS, _USUAL_GAPS * self._gap_ns)):
            return FrameOrder.NEXT
        if not self._is_confirmed(stamp_ns):
            return FrameOrder.UNCONFIRMED
        return FrameOrder.NEXT if ahead_ns > 0 else FrameOrder.CLOCK_SET_BACK

    def _is_confirmed(self, stamp_ns: int) -> bool:
        """Whether the frame before was as far away, and isn't newer."""
        before_ns, newest_ns = self._unconfirmed_ns, self.newest_ns
        if before_ns is None or newest_ns is None:
            return False
        return before_ns <= stamp_ns and (before_ns > newest_ns) == (stamp_ns > newest_ns)


class Believed(NamedTuple):
    """Samples whose stamps are believed. clock_jumped: what the sensor said before them belongs to another clock."""

    samples: Samples
    clock_jumped: bool


class SensorClocks:
    """Compares the stamps of each sensor with those of frames and of all other sensors.

    A sample more than 1 s ahead of all of them is refused; three such in a row that follow each other within 1 s are a
    clock that jumped, and are believed. If the frames don't follow, the sensor's next sample at
    the frames' time is believed again.
    """

    def __init__(self) -> None:
        self.refused: Counter[str] = Counter()
        """Samples refused so far, by sensor."""
        self.jumps: Counter[str] = Counter()
        """Times that a sensor's clock has jumped."""
        self.clear()

    def clear(self) -> None:
        """Forget all stamps; the counts stay."""
        self.frame_ns: int | None = None
        self._newest_ns: dict[str, int] = {}
        self._refused_in_a_row: dict[str, list[tuple[int, list[float]]]] = {}

    def newest_ns(self, sensor: str) -> int | None:
        """Stamp of the newest sample of a sensor that is believed."""
        return self._newest_ns.get(sensor)

    def believed(self, sensor: str, samples: Samples) -> Believed:
        """Those of a sensor's new samples that are believed. Rows behind the newest are its history's to judge."""
        last_ns, frame_ns = max(samples.stamp_ns.tolist()), self.frame_ns
        if frame_ns is not None and last_ns <= frame_ns + _JUMP_NS:  # nearly always
            newest_ns = self._newest_ns.get(sensor, last_ns)
            if newest_ns <= frame_ns + _JUMP_NS:
                self._newest_ns[sensor] = max(last_ns, newest_ns)
                self._refused_in_a_row.pop(sensor, None)
                return Believed(samples, False)
        is_first = frame_ns is None and not self._newest_ns
        if self._is_near_others(last_ns) and not is_first and not self._is_ahead_of_frames(sensor):
            self._accept(sensor, last_ns)
            return Believed(samples, False)
        return self._one_by_one(sensor, samples)

    def _is_ahead_of_frames(self, sensor: str) -> bool:
        newest_ns = self._newest_ns.get(sensor)
        return newest_ns is not None and self.frame_ns is not None and newest_ns > self.frame_ns + _JUMP_NS

    def _accept(self, sensor: str, stamp_ns: int) -> None:
        self._newest_ns[sensor] = max(stamp_ns, self._newest_ns.get(sensor, stamp_ns))
        self._refused_in_a_row.pop(sensor, None)

    def _one_by_one(self, sensor: str, samples: Samples) -> Believed:
        rows: list[tuple[int, list[float]]] = []
        jumped = False
        for stamp_ns, values in zip(samples.stamp_ns.tolist(), samples.values.tolist(), strict=True):
            if self._is_ahead_of_frames(sensor) and abs(stamp_ns - (self.frame_ns or 0)) <= _JUMP_NS:
                rows, jumped = [(stamp_ns, values)], True
                del self._newest_ns[sensor]
                self._accept(sensor, stamp_ns)
            elif self._is_near_others(stamp_ns):
                rows.append((stamp_ns, values))
                self._accept(sensor, stamp_ns)
            elif confirmed := self._refuse(sensor, stamp_ns, values):
                rows, jumped = confirmed, True
                self._accept(sensor, stamp_ns)
        self.jumps[sensor] += jumped
        stamps_ns = np.array([stamp_ns for stamp_ns, _ in rows], dtype=np.int64)
        kept = np.array([values for _, values in rows], dtype=np.float64).reshape(-1, samples.values.shape[1])
        return Believed(Samples(stamps_ns, kept), jumped)

    def _is_near_others(self, stamp_ns: int) -> bool:
        """Whether a stamp is not far ahead of the newest frame and of all samples."""
        newest_ns = max(self._newest_ns.values(), default=self.frame_ns)
        if newest_ns is None:
            return True
        return stamp_ns <= newest_ns + _JUMP_NS or (self.frame_ns is not None and stamp_ns <= self.frame_ns + _JUMP_NS)

    def _refuse(self, sensor: str, stamp_ns: int, values: list[float]) -> list[tuple[int, list[float]]]:
        """Refuse a sample. Returns those refused in a row once they are so many that the clock must have jumped."""
        row = self._refused_in_a_row.setdefault(sensor, [])
        if row and not 0 < stamp_ns - row[-1][0] <= _JUMP_NS:
            row.clear()
        row.append((stamp_ns, values))
        self.refused[sensor] += 1
        if len(row) < _CONFIRMATIONS:
            return []
        self.refused[sensor] -= len(row)
        return row
