"""Sensors whose samples add up to a motion: a sum that goes on over gaps, and the times in which it is not known."""

from collections.abc import Iterable

from touchline.motion.samples import EXTRAPOLATION_S, NANOSECONDS, SampleHistory

_EXTRAPOLATION_NS = int(EXTRAPOLATION_S * NANOSECONDS)


class IntegratedSensor:
    """The integral of a sensor at the stamps of its samples.

    Values are continuous: over a gap the sensor's owner bridges them by the motion around it, and the gap is noted.
    """

    def __init__(self, columns: int) -> None:
        self.samples = SampleHistory(columns)
        self._gaps_ns: list[tuple[int, int]] = []

    def append(self, stamp_ns: int, values: list[float], after_gap: bool) -> None:
        """Append the integral (columns,) at a stamp later than the newest; after_gap: unknown since that one."""
        if after_gap:
            self.note_gap(self.samples.last_ns, stamp_ns)
        self.samples.append(stamp_ns, values)

    def note_gap(self, start_ns: int, end_ns: int) -> None:
        """Nothing is known between two stamps."""
        self._gaps_ns.append((start_ns, end_ns))

    def gaps_ns(self, start_ns: int, end_ns: int) -> list[tuple[int, int]]:
        """Pieces between two stamps in which nothing is known of the sensor: first and last stamp of each."""
        if len(self.samples) == 0:
            return [(start_ns, end_ns)]
        first_ns, until_ns = self.samples.first_ns, self.samples.last_ns + _EXTRAPOLATION_NS
        if first_ns <= start_ns and end_ns <= until_ns and not self._gaps_ns:  # nearly always
            return []
        outside = (start_ns, first_ns), (until_ns, end_ns)
        pieces = ((max(first, start_ns), min(last, end_ns)) for first, last in (*outside, *self._gaps_ns))
        return [(first, last) for first, last in pieces if first < last]

    def forget_before(self, stamp_ns: int) -> None:
        """Forget what isn't needed to look up values from a stamp on."""
        self.samples.forget_before(stamp_ns)
        self._gaps_ns = [gap for gap in self._gaps_ns if gap[1] > stamp_ns]

    def clear(self) -> None:
        """Forget all samples."""
        self.samples.clear()
        self._gaps_ns = []


def covered_s(pieces_ns: Iterable[tuple[int, int]]) -> float:
    """Time (s) that pieces, each with first and last stamp, cover together; where they overlap it counts once."""
    pieces_ns = sorted(pieces_ns)
    total_ns, until_ns = 0, pieces_ns[0][0] if pieces_ns else 0
    for first_ns, last_ns in pieces_ns:
        total_ns += max(last_ns - max(first_ns, until_ns), 0)
        until_ns = max(until_ns, last_ns)
    return total_ns / NANOSECONDS
