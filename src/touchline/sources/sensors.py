"""One sensor's file as a stream of samples, in the order of time, handed out between image stamps."""

from bisect import bisect_left
from collections.abc import Collection, Iterator, Sequence

import numpy as np

from touchline.geometry import BoolArray, FloatArray, IntArray
from touchline.sources.problems import ProblemKind, ProblemLog
from touchline.sources.tables import Block, StampArray, Table, read_blocks, to_stamps
from touchline.types import Samples

HELD_ROWS = 16  # rows kept back until what follows shows whether their times were right
GAP_NS = 100_000_000
GAP_PERIODS = 3.5


class SensorStream:
    """The samples of one table, read lazily. Rows whose time runs backwards and gaps go to the log.

    optional: columns whose cells may be empty (NaN); `drain` reports how many were.
    """

    def __init__(self, table: Table, names: Sequence[str], log: ProblemLog, optional: Collection[str] = ()) -> None:
        self._table = table
        self._log = log
        self._names = names
        self._rows = 0
        self._empty = np.zeros(len(names), dtype=np.int64)
        self._blocks = self._watched(in_order(table, read_blocks(table, ["t", *names], log, optional), log))
        self._stamps: StampArray = np.zeros(0, dtype=np.int64)
        self._values: FloatArray = np.zeros((0, len(names)))
        self._next = 0
        self._gap_ns = GAP_NS
        self._first_ns: int | None = None
        self._last_ns: int | None = None
        self._ended = False

    def take_until(self, stamp_ns: int) -> Samples | None:
        """The samples not handed out yet with a stamp at or before `stamp_ns`; None if there are none."""
        parts: list[Samples] = []
        while True:
            rest = self._stamps[self._next :]
            count = int(rest.searchsorted(stamp_ns, side="right"))
            if count:
                end = self._next + count
                parts.append(Samples(self._stamps[self._next : end], self._values[self._next : end]))
                self._next = end
            if count < len(rest):
                break
            block = next(self._blocks, None)
            if block is None:
                self._note_end(stamp_ns)
                break
            if self._first_ns is None:
                self._note_start(int(block.stamp_ns[0]), stamp_ns)
            self._stamps, self._values, self._next = block.stamp_ns, block.values, 0
        return Samples.joined(parts)

    def drain(self) -> None:
        """Read to the end of the file, so that its last rows are checked as well."""
        for _ in self._blocks:
            pass
        for name, count in zip(self._names, self._empty.tolist(), strict=True):
            unmeasured = count == self._rows and self._table.name in self._log.topics  # as sensor_msgs/Imu says it
            if count and not unmeasured:
                what = f"column '{name}' is empty in {count} of {self._rows} rows; what it measures is unknown there"
                self._log.add(ProblemKind.EMPTY_COLUMN, self._table.name, what)
        self._empty[:] = 0

    def __iter__(self) -> Iterator[Samples]:
        """The remaining samples, block by block."""
        return self._blocks

    def _watched(self, blocks: Iterator[tuple[Block, StampArray]]) -> Iterator[Samples]:
        for block, stamps in blocks:
            if self._last_ns is None and len(stamps) > 1:
                self._gap_ns = max(GAP_NS, round(GAP_PERIODS * float(np.median(np.diff(stamps)))))
            before = stamps[:1] if self._last_ns is None else np.array([self._last_ns])
            steps = np.diff(stamps, prepend=before)
            for row in np.flatnonzero(steps > self._gap_ns):
                what = (
                    f"nothing for {steps[row] / 1e9:.3f} s before t = {stamps[row] / 1e9:.3f} s "
                    "(sensor gap); the samples around it are used as they are"
                )
                self._log.add(ProblemKind.SENSOR_GAP, self._table.name, what, line=int(block.lines[row]))
            self._last_ns = int(stamps[-1])
            self._rows += len(stamps)
            self._empty += np.isnan(block.values[:, 1:]).sum(axis=0)
            yield Samples(stamps, block.values[:, 1:])

    def _note_start(self, first_ns: int, stamp_ns: int) -> None:
        self._first_ns = first_ns
        if first_ns - stamp_ns > self._gap_ns:
            what = f"starts at t = {first_ns / 1e9:.3f} s, the first image is at t = {stamp_ns / 1e9:.3f} s"
            self._log.add(ProblemKind.SENSOR_GAP, self._table.name, what)

    def _note_end(self, stamp_ns: int) -> None:
        if self._ended:
            return
        if self._last_ns is None:
            self._log.add(ProblemKind.SENSOR_GAP, self._table.name, "holds no usable row")
            self._ended = True
        elif stamp_ns - self._last_ns > self._gap_ns:
            what = f"ends at t = {self._last_ns / 1e9:.3f} s, images go on at t = {stamp_ns / 1e9:.3f} s"
            self._log.add(ProblemKind.SENSOR_GAP, self._table.name, what)
            self._ended = True


def in_order(table: Table, blocks: Iterator[Block], log: ProblemLog) -> Iterator[tuple[Block, StampArray]]:
    """Blocks with strictly increasing stamps: the fewest rows that break the order are reported and left out.

    The last HELD_ROWS rows of a block wait for the next one, so that a single time far in the future is recognised
    as the culprit instead of all that follows it.
    """
    above = np.iinfo(np.int64).min
    held: Block | None = None
    for block in blocks:
        merged = block
        if held is not None:
            merged = Block(np.concatenate((held.lines, block.lines)), np.concatenate((held.values, block.values)))
        done = max(len(merged.lines) - HELD_ROWS, 0)
        held = Block(merged.lines[done:], merged.values[done:])
        yield from (kept := list(_ordered_part(table, merged, done, above, log)))
        if kept:
            above = int(kept[0][1][-1])
    if held is not None:
        yield from _ordered_part(table, held, len(held.lines), above, log)


def _ordered_part(
    table: Table, block: Block, count: int, above: int, log: ProblemLog
) -> Iterator[tuple[Block, StampArray]]:
    """The first `count` rows of the block without those that break the order of the whole block."""
    stamps = to_stamps(block.values[:, 0])
    keep = increasing_rows(stamps, above)[:count]
    _report_disorder(table.name, block.values[:count, 0], block.lines, keep, log)
    if keep.any():
        yield Block(block.lines[:count][keep], block.values[:count][keep]), stamps[:count][keep]


def rows_in_order(
    file: str, times_s: FloatArray, lines: IntArray, log: ProblemLog, outcome: str
) -> tuple[StampArray, BoolArray]:
    """Stamps (n,) of all rows, and which of them are kept so that they increase; the others go to the log.

    lines: their numbers in the file.
    """
    stamps = to_stamps(times_s)
    keep = increasing_rows(stamps)
    _report_disorder(file, times_s, lines, keep, log, outcome)
    return stamps, keep


def _report_disorder(
    file: str,
    times_s: FloatArray,
    lines: IntArray,
    keep: BoolArray,
    log: ProblemLog,
    outcome: str = "; the row is left out",
) -> None:
    for row in np.flatnonzero(~keep):
        what = f"the time {times_s[row]:.6g} s runs backwards or repeats{outcome}"
        log.add(ProblemKind.TIME_ORDER, file, what, line=int(lines[row]))


def increasing_rows(stamps: StampArray, above: int = np.iinfo(np.int64).min) -> BoolArray:
    """Mask (n,) of a longest strictly increasing run of stamps (gaps allowed) that starts above `above`."""
    if len(stamps) == 0 or (int(stamps[0]) > above and bool((np.diff(stamps) > 0).all())):
        return np.ones(len(stamps), dtype=np.bool_)
    negated = (-stamps).tolist()
    starts: list[int] = []  # negated largest first stamp of a run of each length, to the right of `row`
    lengths = np.zeros(len(stamps), dtype=np.int64)  # longest run that starts at the row
    for row in range(len(stamps) - 1, -1, -1):
        if stamps[row] > above:
            length = bisect_left(starts, negated[row])
            starts[length : length + 1] = [negated[row]]
            lengths[row] = length + 1
    mask = np.zeros(len(stamps), dtype=np.bool_)
    missing, last = len(starts), above
    for row, stamp in enumerate(stamps.tolist()):
        if lengths[row] == missing and missing and stamp > last:  # of equally long runs, the one that keeps early rows
            mask[row] = True
            missing, last = missing - 1, stamp
    return mask
