"""The list of images of a recording, kept compact."""

from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np

from touchline.errors import InputError
from touchline.files.opened import MAX_LINE, open_bytes
from touchline.geometry import FloatArray, IntArray
from touchline.sources.problems import ProblemKind, ProblemLog
from touchline.sources.sensors import rows_in_order
from touchline.sources.tables import (
    Line,
    StampArray,
    Table,
    open_table,
    parse_row,
    read_lines,
    shown,
    to_number,
)
from touchline.sources.units import advice_on_times


@dataclass(frozen=True, eq=False, slots=True)
class ImageList:
    """images.csv without its text: 36 bytes per image.

    stamp_ns: int64 (N,), strictly increasing. exposure_ms, gain: float64 (N,), NaN where unknown.
    lines: int64 (N,), line numbers. offsets: int64 (N,), where the line starts in the file.
    """

    table: Table
    stamp_ns: StampArray
    exposure_ms: FloatArray
    gain: FloatArray
    lines: IntArray
    offsets: IntArray

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def file_names(self, start: int = 0) -> Iterator[str]:
        """The images' files, relative to the recording, from one index on."""
        with open_bytes(self.table.path) as file:
            for offset in self.offsets[start:]:
                file.seek(offset)
                yield _file_cell(self.table, file.readline(MAX_LINE).decode("utf-8", errors="replace"))

    def listed(self) -> Iterator[tuple[int, str]]:
        """Row (from 0, the line after the header) and file of every line that names one, usable or not."""
        for line in chain.from_iterable(read_lines(self.table)):
            if name := _file_cell(self.table, line.text):
                yield line.number - 2, name


def read_image_list(path: Path, log: ProblemLog) -> ImageList:
    """Read images.csv once; bad rows go to the log, InputError if no row is usable."""
    table = open_table(path, ["t", "file"])
    times, exposures, gains = array("d"), array("d"), array("d")
    numbers, offsets = array("q"), array("q")
    for line in chain.from_iterable(read_lines(table)):
        row = parse_row(table, line, ["t"], log)
        if row is None:
            continue
        if not _file_cell(table, line.text):
            log.add(ProblemKind.BROKEN_ROW, table.name, "names no file; the row is left out", line=line.number)
            continue
        times.append(row[0])
        exposures.append(_setting(table, line, "exposure_ms", log))
        gains.append(_setting(table, line, "gain", log))
        numbers.append(line.number)
        offsets.append(line.offset)
    if not times:
        why = advice_on_times(table) or "; every line after the header has to read t,file,exposure_ms,gain"
        raise InputError(f"{path}: names no image{why}")
    lines_read = np.array(numbers, dtype=np.int64)
    stamps, keep = rows_in_order(table.name, np.array(times), lines_read, log, "; the image is left out")
    return ImageList(
        table,
        stamps[keep],
        np.array(exposures)[keep],
        np.array(gains)[keep],
        lines_read[keep],
        np.array(offsets, dtype=np.int64)[keep],
    )


def _file_cell(table: Table, text: str) -> str:
    cells = text.split(",")
    position = table.columns["file"]
    return cells[position].strip().strip('"') if position < len(cells) else ""


def _setting(table: Table, line: Line, name: str, log: ProblemLog) -> float:
    """An optional positive number of a row; NaN, and a report, if it is there but broken."""
    if name not in table.columns:
        return float("nan")
    cell = line.text.split(",")[table.columns[name]].strip()
    value = to_number(cell)
    if value is not None and 0.0 < value < float("inf"):
        return value
    if cell:
        what = f"column '{name}' reads {shown(cell)}, expected a positive number; the image is used without it"
        log.add(ProblemKind.BROKEN_ROW, table.name, what, line=line.number)
    return float("nan")
