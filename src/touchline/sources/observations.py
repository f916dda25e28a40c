"""observations.csv: what a detector of the robot's own found, read image by image."""

from __future__ import annotations

import math
from array import array
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
import numpy.typing as npt

from touchline.errors import InputError
from touchline.geometry import FloatArray
from touchline.messages import did_you_mean
from touchline.sources.problems import ProblemKind, ProblemLog
from touchline.sources.sensors import increasing_rows, report_disorder
from touchline.sources.tables import (
    Line,
    StampArray,
    Table,
    open_table,
    parse_row,
    read_lines,
    shown,
    to_number,
    to_stamps,
)
from touchline.sources.units import advice_on_times
from touchline.types import (
    MAX_VALUE,
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
_UNKNOWN = (math.nan, math.nan, math.nan)
_MAX_BYTES = 4_000_000  # of one image's rows: memory stays bounded whatever the file holds


class _RowError(Exception):
    """Why one row can't be used."""


class _Seen(NamedTuple):
    """One row in plain numbers, NaN where unknown. covariance, covariance2: xx, xy, yy of both ends."""

    x: float
    y: float
    x2: float
    y2: float
    covariance: tuple[float, float, float]
    covariance2: tuple[float, float, float]
    orientation_rad: float
    colors: tuple[str, ...]
    confidence: float


@dataclass(frozen=True, eq=False, slots=True)
class ObservationList:
    """observations.csv without its text: 32 bytes per image.

    stamp_ns: int64 (N,), strictly increasing. lines: int64 (N,), line number of each image's first row. offsets, ends:
    int64 (N,), where its rows start and end in the file.
    """

    table: Table
    stamp_ns: StampArray
    lines: npt.NDArray[np.int64]
    offsets: npt.NDArray[np.int64]
    ends: npt.NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def indices_at(self, stamps: StampArray) -> npt.NDArray[np.int64]:
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
            except _RowError as error:
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
    for line in _lines(table):
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
    stamps, lines = to_stamps(np.array(times)), np.array(numbers, dtype=np.int64)
    keep = increasing_rows(stamps)
    outcome = " (the rows of an image stand together); what was seen is left out"
    report_disorder(table.name, np.array(times), lines, keep, log, outcome)
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
        except _RowError as error:
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


def _lines(table: Table) -> Iterator[Line]:
    for lines in read_lines(table):
        yield from lines


def _time_cell(table: Table, text: str) -> str | None:
    """The text of a line's time; None if the line is too short to have one."""
    position = table.columns["t"]
    cells = text.split(",", position + 1)
    return cells[position] if position < len(cells) else None


def _row(table: Table, text: str) -> tuple[str, _Seen | None]:
    """Kind and content of a row; None for `none`."""
    cells = [cell.strip() for cell in text.split(",")]
    if len(cells) != table.width:
        raise _RowError(f"has {len(cells)} values where the header names {table.width} columns")
    return _seen({name: cells[position] for name, position in table.columns.items()})


def _seen(row: Mapping[str, str]) -> tuple[str, _Seen | None]:
    """Kind and content of the cells of a row by column; None for `none`."""
    kind = row.get("kind", "").strip('"')
    if kind not in KINDS:
        raise _RowError(f"kind {shown(kind)} is not known; {did_you_mean(kind, KINDS)}")
    if kind == NOTHING:
        return kind, None
    x, y, x2, y2 = _needed(row, "x_m"), _needed(row, "y_m"), math.nan, math.nan
    if kind == LINE:
        x2, y2 = _needed(row, "x2_m"), _needed(row, "y2_m")
    confidence = _optional(row, "confidence")
    if not (math.isnan(confidence) or 0.0 <= confidence <= 1.0):
        raise _RowError(f"confidence is {confidence:g}, expected 0 to 1")
    colors = tuple(filter(None, row.get("color", "").strip('"').split("-")))
    seen = _Seen(
        x,
        y,
        x2,
        y2,
        _covariance(row, "cov"),
        _covariance(row, "cov2") if kind == LINE else _UNKNOWN,
        _optional(row, "orientation_rad"),
        colors,
        1.0 if math.isnan(confidence) else confidence,
    )
    return kind, seen


def _needed(row: Mapping[str, str], name: str) -> float:
    value = _optional(row, name)
    if math.isnan(value):
        raise _RowError(f"column '{name}' is {'empty' if name in row else 'missing'}, but a {row['kind']} needs it")
    return value


def _optional(row: Mapping[str, str], name: str) -> float:
    """A number; NaN where the cell is empty, or the file has no such column."""
    cell = row.get(name, "")
    if not cell:
        return math.nan
    value = to_number(cell)
    if value is None:
        raise _RowError(f"column '{name}' reads {shown(cell)}, which is not a number")
    if not math.isfinite(value) or abs(value) >= MAX_VALUE:
        raise _RowError(f"column '{name}' is {value:g}, which is no measurement")
    return value


def _covariance(row: Mapping[str, str], name: str) -> tuple[float, float, float]:
    """xx, xy, yy; all NaN where none is given."""
    xx, xy, yy = (_optional(row, f"{name}_{axes}") for axes in ("xx", "xy", "yy"))
    if math.isnan(xx) and math.isnan(xy) and math.isnan(yy):
        return _UNKNOWN
    xy = 0.0 if math.isnan(xy) else xy
    if not (xx > 0.0 and yy > 0.0 and xx * yy > xy * xy):  # False for NaN, too
        raise _RowError(f"{name}_xx, {name}_xy, {name}_yy are no covariance")
    return xx, xy, yy


def _observation(stamp_ns: int, found: dict[str, list[_Seen]]) -> Observation:
    crossings = [(kind.value, seen) for kind in CrossingKind for seen in found.get(kind, [])]
    landmarks = [(kind.value, seen) for kind in LandmarkKind for seen in found.get(kind, [])]
    lines = found.get(LINE, [])
    crossed, marked = [seen for _, seen in crossings], [seen for _, seen in landmarks]
    return Observation(
        stamp_ns,
        points=LinePoints(**_places(found.get(POINT, []))),
        lines=Lines(
            *_ends(lines),
            np.array([seen.confidence for seen in lines], dtype=np.float64),
            np.full((len(lines), 2, 2), np.nan),
        ),
        crossings=Crossings(
            kinds=np.array([kind for kind, _ in crossings], dtype=np.str_),
            orientations_rad=np.array([seen.orientation_rad for seen in crossed], dtype=np.float64),
            **_places(crossed),
        ),
        landmarks=Landmarks(
            kinds=np.array([kind for kind, _ in landmarks], dtype=np.str_),
            colors=tuple(seen.colors for seen in marked),
            **_places(marked),
        ),
        boundary=LinePoints(**_places(found.get(BOUNDARY, []))),
    )


def _places(seen: list[_Seen]) -> dict[str, FloatArray]:
    """positions_m: (N, 2); covariances_m2: (N, 2, 2); confidences: (N,); pixels: (N, 2), all NaN."""
    positions = np.array([(each.x, each.y) for each in seen], dtype=np.float64).reshape(-1, 2)
    return {
        "positions_m": positions,
        "covariances_m2": _covariances(positions, [each.covariance for each in seen]),
        "confidences": np.array([each.confidence for each in seen], dtype=np.float64),
        "pixels": np.full((len(seen), 2), np.nan),
    }


def _ends(lines: list[_Seen]) -> tuple[FloatArray, FloatArray]:
    """Ends (N, 2, 2) of lines, and their covariances (N, 2, 2, 2)."""
    ends = np.array([(each.x, each.y, each.x2, each.y2) for each in lines], dtype=np.float64).reshape(-1, 2)
    each_end = [covariance for each in lines for covariance in (each.covariance, each.covariance2)]
    return ends.reshape(-1, 2, 2), _covariances(ends, each_end).reshape(-1, 2, 2, 2)


def _covariances(positions_m: FloatArray, upper: list[tuple[float, float, float]]) -> FloatArray:
    """(N, 2, 2) of xx, xy, yy of each; those of a usual camera where they are not known."""
    rows = np.array(upper, dtype=np.float64).reshape(-1, 3)
    known = rows[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
    missing = np.isnan(known)
    return np.where(missing, generic_covariances(positions_m), known) if missing.any() else known


def _cells(values: Iterable[float]) -> list[str]:
    """Numbers as cells; empty where they are NaN."""
    return ["" if math.isnan(value) else f"{value:.7g}" for value in values]
