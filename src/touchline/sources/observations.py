"""observations.csv: what a detector of the robot's own found, read image by image."""

import math
from array import array
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import chain, repeat
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from touchline.errors import InputError
from touchline.geometry import FloatArray, IntArray
from touchline.messages import did_you_mean
from touchline.sources.problems import ProblemKind, ProblemLog
from touchline.sources.sensors import rows_in_order
from touchline.sources.tables import (
    RowError,
    StampArray,
    Table,
    open_table,
    parse_row,
    read_cell,
    read_lines,
    shown,
    to_number,
)
from touchline.sources.units import advice_on_times
from touchline.types import (
    CrossingKind,
    Crossings,
    LandmarkKind,
    Landmarks,
    LinePoints,
    Lines,
    Observation,
    generic_covariances,
)

OBSERVATIONS = "observations.csv"
HEADER = "t,kind,x_m,y_m,x2_m,y2_m,orientation_rad,cov_xx,cov_xy,cov_yy,cov2_xx,cov2_xy,cov2_yy,color,confidence"
POINT, LINE, BOUNDARY, NOTHING = "point", "line", "boundary", "none"
KINDS = (POINT, LINE, *CrossingKind, *LandmarkKind, BOUNDARY, NOTHING)
SAME_TIME_NS = 500_000  # an image and its rows may be written with a different number of digits
_NUMBERS = [name for name in HEADER.split(",") if name not in ("t", "kind", "color")]
_SECOND_END = ("x2_m", "y2_m", "cov2_xx", "cov2_xy", "cov2_yy")  # of a line alone
_MAX_BYTES = 4_000_000  # of one image's rows: memory stays bounded whatever the file holds


class _Seen(NamedTuple):
    """One row: its numbers in the order of _NUMBERS, NaN where unknown."""

    numbers: list[float]
    colors: tuple[str, ...]


@dataclass(frozen=True, eq=False, slots=True)
class ObservationList:
    """observations.csv without its text: 32 bytes per image.

    stamp_ns: int64 (N,), strictly increasing. lines: int64 (N,), line number of each image's first row. offsets, ends:
    int64 (N,), where its rows start and end in the file.
    """

    table: Table
    stamp_ns: StampArray
    lines: IntArray
    offsets: IntArray
    ends: IntArray

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def indices_at(self, stamps: StampArray) -> IntArray:
        """(M,) the observation at each of some stamps (M,); -1 where there is none."""
        after = np.searchsorted(self.stamp_ns, stamps - SAME_TIME_NS).clip(max=len(self) - 1)
        there = np.abs(self.stamp_ns[after] - stamps) <= SAME_TIME_NS
        return np.where(there, after, -1).astype(np.int64)

    def _is_at(self, index: int, text: str) -> bool:
        """Whether a line is a row at the time of an observation."""
        time_s = to_number((_time_cell(self.table, text) or "").strip())
        return time_s is not None and abs(time_s - self.stamp_ns[index] / 1e9) < 1e-6

    def read(self, index: int, file: BinaryIO, log: ProblemLog) -> Observation:
        """What was found in one image; `file` is the table, opened. Rows that can't be used go to the log."""
        start, end = int(self.offsets[index]), int(self.ends[index])
        file.seek(start)
        texts = file.read(min(end - start, _MAX_BYTES)).decode("latin-1").split("\n")
        if end - start > _MAX_BYTES:
            what = f"more than {_MAX_BYTES // 1_000_000} MB of rows at one time; the rest of them are left out"
            log.add(ProblemKind.BROKEN_ROW, self.table.name, what, line=int(self.lines[index]))
            texts.pop()
        found: defaultdict[str, list[_Seen]] = defaultdict(list)
        for number, text in enumerate(texts, start=int(self.lines[index])):
            if not self._is_at(index, text):  # blank, or told of when the times were read
                continue
            try:
                kind, seen = _row(self.table, text)
            except RowError as error:
                log.add(ProblemKind.BROKEN_ROW, self.table.name, f"{error}; the row is left out", line=number)
                continue
            if seen is not None:
                found[kind].append(seen)
        return _observation(int(self.stamp_ns[index]), found)


def read_observation_list(path: Path, log: ProblemLog) -> ObservationList:
    """Find where each image's rows stand; those at a time that is none go to the log.

    Raises InputError if no row is usable.
    """
    table = open_table(path, ["t", "kind", "x_m", "y_m"])
    times, numbers, offsets, ends = array("d"), array("q"), array("q"), array("q")
    last: str | None = None
    for line in chain.from_iterable(read_lines(table)):
        cell = _time_cell(table, line.text)
        end = line.offset + len(line.text)
        if cell is not None and cell == last:
            ends[-1] = end
            continue
        row = parse_row(table, line, ["t"], log)
        if row is None:
            continue
        last = cell
        if times and row[0] == times[-1]:
            ends[-1] = end
            continue
        times.append(row[0])
        numbers.append(line.number)
        offsets.append(line.offset)
        ends.append(end)
    if not times:
        why = advice_on_times(table) or f"; every line after the header has to read {HEADER}"
        raise InputError(f"{path}: holds no observation{why}")
    lines = np.array(numbers, dtype=np.int64)
    outcome = " (the rows of an image stand together); what was seen is left out"
    stamps, keep = rows_in_order(table.name, np.array(times), lines, log, outcome)
    where = (np.array(values, dtype=np.int64)[keep] for values in (offsets, ends))
    return ObservationList(table, stamps[keep], lines[keep], *where)


def observation_of(stamp_ns: int, rows: Iterable[Mapping[str, str]]) -> Observation:
    """What rows say that stand for those of observations.csv: their cells by column, without the time.

    Raises InputError for a row that can't be used.
    """
    found: defaultdict[str, list[_Seen]] = defaultdict(list)
    for number, row in enumerate(rows, start=1):
        try:
            kind, seen = _seen(row)
        except RowError as error:
            raise InputError(f"row {number}: {error}") from None
        if seen is not None:
            found[kind].append(seen)
    return _observation(stamp_ns, found)


def observation_rows(observation: Observation) -> list[str]:
    """An observation as the rows of an observations.csv with the columns of HEADER; at least one."""
    time = f"{observation.stamp_ns / 1e9:.9f}".rstrip("0").rstrip(".")
    points, lines, crossings = observation.points.usable(), observation.lines, observation.crossings
    landmarks, boundary = observation.landmarks, observation.boundary.usable()
    rows = _table_rows(repeat(POINT), points.positions_m, points)
    rows += _table_rows(repeat(LINE), lines.ends_m, lines)
    rows += _table_rows(crossings.kinds, crossings.positions_m, crossings, turns=crossings.orientations_rad)
    rows += _table_rows(landmarks.kinds, landmarks.positions_m, landmarks, colors=landmarks.colors)
    rows += _table_rows(repeat(BOUNDARY), boundary.positions_m, boundary)
    return [",".join([time, *row]) for row in rows or [[NOTHING, *[""] * 13]]]


def _table_rows(
    kinds: Iterable[str],
    places: FloatArray,
    found: LinePoints | Lines | Crossings | Landmarks,
    turns: Iterable[float] = repeat(math.nan),
    colors: Iterable[tuple[str, ...]] = repeat(()),
) -> list[list[str]]:
    """The cells of things of one sort, without their time. places: (N, 2), or (N, 2, 2) ends."""
    rows = []
    each = zip(kinds, places, found.covariances_m2, found.confidences, turns, colors, strict=False)
    for kind, at, covariance, sure, turn, color in each:
        ends, upper = np.ravel(at).tolist(), np.ravel(covariance.reshape(-1, 4)[:, [0, 1, 3]]).tolist()
        numbers = [*ends, *[math.nan] * (4 - len(ends)), turn, *upper, *[math.nan] * (6 - len(upper))]
        rows.append([kind, *_cells(numbers), "-".join(color), *_cells([sure])])
    return rows


def _time_cell(table: Table, text: str) -> str | None:
    """The text of a line's time; None if the line is too short to have one."""
    position = table.columns["t"]
    cells = text.split(",", position + 1)
    return cells[position] if position < len(cells) else None


def _row(table: Table, text: str) -> tuple[str, _Seen | None]:
    """Kind and content of a row; None for `none`."""
    cells = [cell.strip() for cell in text.split(",")]
    if len(cells) != table.width:
        raise RowError(f"has {len(cells)} values where the header names {table.width} columns")
    return _seen({name: cells[position] for name, position in table.columns.items()})


def _seen(row: Mapping[str, str]) -> tuple[str, _Seen | None]:
    """Kind and content of the cells of a row by column; None for `none`."""
    kind = row.get("kind", "").strip('"')
    if kind not in KINDS:
        raise RowError(f"kind {shown(kind)} is not known; {did_you_mean(kind, KINDS)}")
    if kind == NOTHING:
        return kind, None
    left_out = () if kind == LINE else _SECOND_END
    numbers = {name: math.nan if name in left_out else _number(row, name) for name in _NUMBERS}
    for name in ("x_m", "y_m", *(("x2_m", "y2_m") if kind == LINE else ())):
        if math.isnan(numbers[name]):
            raise RowError(f"column '{name}' is {'empty' if name in row else 'missing'}, but a {kind} needs it")
    if math.isnan(numbers["confidence"]):
        numbers["confidence"] = 1.0
    if not 0.0 <= numbers["confidence"] <= 1.0:
        raise RowError(f"confidence is {numbers['confidence']:g}, expected 0 to 1")
    for end in ("cov", "cov2"):
        names = [f"{end}_{axes}" for axes in ("xx", "xy", "yy")]
        xx, xy, yy = (numbers[name] for name in names)
        if not all(math.isnan(value) for value in (xx, xy, yy)):
            numbers[names[1]] = xy = 0.0 if math.isnan(xy) else xy
            if not (xx > 0.0 and yy > 0.0 and xx * yy > xy * xy):  # False for NaN, too
                raise RowError(f"{', '.join(names)} are no covariance")
    return kind, _Seen(list(numbers.values()), tuple(filter(None, row.get("color", "").strip('"').split("-"))))


def _number(row: Mapping[str, str], name: str) -> float:
    """NaN where the cell is empty, or the file has no such column."""
    cell = row.get(name, "")
    return read_cell(f"column '{name}'", cell) if cell else math.nan


def _observation(stamp_ns: int, found: Mapping[str, list[_Seen]]) -> Observation:
    crossings, landmarks = (
        [(kind.value, seen) for kind in kinds for seen in found.get(kind, [])] for kinds in (CrossingKind, LandmarkKind)
    )
    lines = _array(found.get(LINE, []))
    ends = lines[:, :4].reshape(-1, 2)
    return Observation(
        stamp_ns,
        points=LinePoints(**_places(found.get(POINT, []))),
        lines=Lines(
            ends.reshape(-1, 2, 2),
            _covariances(ends, lines[:, 5:11].reshape(-1, 3)).reshape(-1, 2, 2, 2),
            lines[:, 11].copy(),
            np.full((len(lines), 2, 2), np.nan),
        ),
        crossings=Crossings(
            kinds=np.array([kind for kind, _ in crossings], dtype=np.str_),
            orientations_rad=_array([seen for _, seen in crossings])[:, 4].copy(),
            **_places([seen for _, seen in crossings]),
        ),
        landmarks=Landmarks(
            kinds=np.array([kind for kind, _ in landmarks], dtype=np.str_),
            colors=tuple(seen.colors for _, seen in landmarks),
            **_places([seen for _, seen in landmarks]),
        ),
        boundary=LinePoints(**_places(found.get(BOUNDARY, []))),
    )


def _array(seen: list[_Seen]) -> FloatArray:
    return np.array([each.numbers for each in seen], dtype=np.float64).reshape(-1, len(_NUMBERS))


def _places(seen: list[_Seen]) -> dict[str, FloatArray]:
    """positions_m: (N, 2); covariances_m2: (N, 2, 2); confidences: (N,); pixels: (N, 2), all NaN."""
    rows = _array(seen)
    positions = rows[:, :2].copy()
    return {
        "positions_m": positions,
        "covariances_m2": _covariances(positions, rows[:, 5:8]),
        "confidences": rows[:, 11].copy(),
        "pixels": np.full((len(seen), 2), np.nan),
    }


def _covariances(positions_m: FloatArray, upper: FloatArray) -> FloatArray:
    """(N, 2, 2) of xx, xy, yy (N, 3); those of a usual camera where they are not known."""
    known = upper[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
    missing = np.isnan(known)
    return np.where(missing, generic_covariances(positions_m), known) if missing.any() else known


def _cells(values: Iterable[float]) -> list[str]:
    """Numbers as cells; empty where they are NaN."""
    return ["" if math.isnan(value) else f"{value:.7g}" for value in values]
