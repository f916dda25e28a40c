"""CSV files of numbers, read in blocks: constant memory at any length, bad rows reported and left out."""

import math
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from touchline.errors import InputError
from touchline.files.opened import MAX_LINE, UnreadableError, open_bytes
from touchline.geometry import FloatArray, IntArray
from touchline.sources.problems import ProblemKind, ProblemLog
from touchline.types import MAX_VALUE

BLOCK_BYTES = 16384
MAX_TIME_S = 9.0e9  # int64 nanoseconds end there

StampArray = IntArray


class Table(NamedTuple):
    """A CSV file whose header is known. columns: name to position; width: number of columns."""

    path: Path
    columns: dict[str, int]
    width: int
    start: int  # byte offset of the first line after the header

    @property
    def name(self) -> str:
        """The file's name, as problems show it."""
        return self.path.name


class Line(NamedTuple):
    """number: counted from 1; offset: in bytes; text: decoded as Latin-1, so that no byte can fail."""

    number: int
    offset: int
    text: str


class Block(NamedTuple):
    """Rows of numbers. lines: (n,) line numbers; values: float64 (n, k), the columns asked for."""

    lines: IntArray
    values: FloatArray


class TableError(InputError):
    """A CSV file that can't be used at all. what: the reason without the place; line: None for the whole file."""

    def __init__(self, path: Path, what: str, line: int | None = None) -> None:
        super().__init__(f"{path}: {what}" if line is None else f"{path}, line {line}: {what}")
        self.what = what
        self.line = line


class RowError(Exception):
    """Why one row can't be used. kind: of the problem."""

    def __init__(self, what: str, kind: ProblemKind = ProblemKind.BROKEN_ROW) -> None:
        super().__init__(what)
        self.kind = kind


def open_table(path: Path, needed: Sequence[str]) -> Table:
    """Read the header; TableError if it can't be read or lacks a needed column."""
    try:
        with open_bytes(path) as file:
            header = file.readline(MAX_LINE)
    except UnreadableError as error:
        raise TableError(path, error.what) from None
    try:
        text = header.decode("utf-8-sig").strip()
    except UnicodeDecodeError:
        text = "\0"
    if not text.replace("\t", " ").isprintable():
        if text.replace("\t", " ").replace("\r", " ").isprintable():
            raise TableError(path, "ends its lines with a lone carriage return (\\r): save it with \\n or \\r\\n")
        raise TableError(path, "is not a text file")
    names = [name.strip().strip('"') for name in text.split(",")]
    for name in needed:
        if name not in names:
            hint = f"found: {', '.join(names)[:200]}" if any(names) else "the file is empty"
            what = f"column '{name}' is missing from the header ({hint}); expected {','.join(needed)}"
            if ";" in text or "\t" in text:
                what += ", separated by commas"
            raise TableError(path, what, 1)
    return Table(path, {name: names.index(name) for name in names}, len(names), len(header))


def read_lines(table: Table) -> Iterator[list[Line]]:
    """The lines after the header, in lists of about BLOCK_BYTES; blank lines are skipped.

    A line longer than MAX_LINE comes as its first MAX_LINE bytes: it can't be a row.
    """
    with open_bytes(table.path) as file:
        offset = file.seek(table.start)
        number, carry, skipping = 2, "", False
        while chunk := file.read(BLOCK_BYTES):
            texts = (carry + chunk.decode("latin-1")).split("\n")
            carry = texts.pop()
            lines: list[Line] = []
            for text in texts:
                if text.strip() and not skipping:
                    lines.append(Line(number, offset, text))
                skipping = False
                offset += len(text) + 1
                number += 1
            if len(carry) > MAX_LINE:
                if not skipping:
                    lines.append(Line(number, offset, carry[:MAX_LINE]))
                offset += len(carry)
                carry, skipping = "", True
            if lines:
                yield lines
        if carry.strip() and not skipping:
            yield [Line(number, offset, carry)]


def read_blocks(table: Table, names: Sequence[str], log: ProblemLog, optional: Collection[str] = ()) -> Iterator[Block]:
    """The named columns as numbers, block by block; broken rows go to the log.

    An empty cell (or NaN) of an optional column is NaN and breaks no row. The first named column is the time (s), which
    has to lie within ±MAX_TIME_S, the others within ±MAX_VALUE.
    """
    wanted = [table.columns[name] for name in names]
    for lines in read_lines(table):
        values = parse_clean(lines, table.width)
        if values is not None:
            picked = values[:, wanted]
            sizes = np.abs(picked)  # a comparison with NaN is False
            if (sizes[:, 0] < MAX_TIME_S).all() and (sizes[:, 1:] < MAX_VALUE).all():
                yield Block(np.array([line.number for line in lines], dtype=np.int64), picked)
                continue
        parsed = ((line.number, parse_row(table, line, names, log, optional)) for line in lines)
        rows = [(number, row) for number, row in parsed if row is not None]
        if rows:
            yield Block(np.array([number for number, _ in rows], dtype=np.int64), np.array([row for _, row in rows]))


def parse_row(
    table: Table, line: Line, names: Sequence[str], log: ProblemLog, optional: Collection[str] = ()
) -> list[float] | None:
    """The named columns of one line; None, and a report, if it is broken. Empty cells of optional columns are NaN."""
    cells = line.text.split(",")
    if len(cells) != table.width:
        values = "1 value" if len(cells) == 1 else f"{len(cells)} values"
        what = f"has {values} where the header names {table.width} columns; the row is left out"
        if "\r" in line.text.rstrip():
            what = "holds a carriage return (\\r) that ends no line: two rows in one; the row is left out"
        log.add(ProblemKind.BROKEN_ROW, table.name, what, line=line.number)
        return None
    row: list[float] = []
    for name in names:
        cell = cells[table.columns[name]].strip()
        if name in optional and (not cell or math.isnan(to_number(cell) or 0.0)):
            row.append(math.nan)
            continue
        try:
            row.append(read_cell(f"column '{name}'", cell, MAX_VALUE if row else MAX_TIME_S))
        except RowError as error:
            log.add(error.kind, table.name, f"{error}; the row is left out", line=line.number)
            return None
    return row


def read_cell(name: str, cell: str, limit: float = MAX_VALUE) -> float:
    """The number of a cell, smaller than the limit. Raises RowError, which begins with the name, for anything else."""
    value = to_number(cell)
    if value is None:
        raise RowError(f"{name} reads {shown(cell)}, which is not a number")
    if not abs(value) < limit:
        if math.isfinite(value):
            raise RowError(f"{name} is {value:g}, beyond any measurement")
        raise RowError(f"{name} is {value}, which is no measurement", ProblemKind.NOT_A_NUMBER)
    return value


def to_number(cell: str) -> float | None:
    """A decimal number as text; None for anything else (underscores, which Python would take, included)."""
    if "_" in cell:
        return None
    try:
        return float(cell)
    except ValueError:
        return None


def shown(cell: str) -> str:
    """A cell as messages quote it."""
    if not cell:
        return "empty"
    return repr(cell if len(cell) <= 30 else cell[:30] + "…")


def to_stamps(times_s: FloatArray) -> StampArray:
    """Seconds as integer nanoseconds."""
    return np.rint(times_s * 1e9).astype(np.int64)


def parse_clean(lines: Sequence[Line], width: int) -> FloatArray | None:
    """All columns of well-formed rows at once; None if any row isn't."""
    try:
        values = np.loadtxt([line.text for line in lines], delimiter=",", comments=None, ndmin=2)  # read already
    except ValueError:
        return None
    return values if values.shape == (len(lines), width) else None
