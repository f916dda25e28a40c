"""Odometry from a CSV file of any columns, in any order and in some other units, as odometry.csv."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from decimal import Decimal, InvalidOperation
from pathlib import Path

from touchline.errors import InputError
from touchline.files.opened import text_lines
from touchline.messages import did_you_mean, listed
from touchline.sources.bags.table_rows import decimal_ns, decimal_seconds
from touchline.sources.tables import to_number

_NANOSECONDS = {"t": 1_000_000_000, "t_ms": 1_000_000, "t_us": 1_000, "t_ns": 1}
_UNITS = {
    "x": ("x", 1.0),
    "y": ("y", 1.0),
    "theta": ("theta", 1.0),
    "x_mm": ("x", 1e-3),
    "y_mm": ("y", 1e-3),
    "x_cm": ("x", 1e-2),
    "y_cm": ("y", 1e-2),
    "theta_deg": ("theta", math.pi / 180.0),
}
_SEPARATORS = (",", ";", "\t", " ")


def parse_columns(text: str) -> dict[str, str]:
    """t=stamp,x=px,y=py,theta_deg=yaw: what is in which column, by its name or its number from 1.

    Raises InputError for anything else.
    """
    parts = [each.partition("=") for each in text.split(",")]
    found = {key.strip(): name.strip() for key, _, name in parts}
    for key in found:
        if key not in (*_NANOSECONDS, *_UNITS):
            known = did_you_mean(key, [*_NANOSECONDS, *_UNITS])
            raise InputError(f"--columns {text}: {key!r} is not known; {known}")
    held = [*("t" for key in found if key in _NANOSECONDS), *(_UNITS[key][0] for key in found if key in _UNITS)]
    if sorted(held) != ["t", "theta", "x", "y"] or not all(found.values()):
        raise InputError(
            f"--columns {text}: needs t, x, y and theta once each, for example t=stamp,x=px,y=py,theta=yaw"
        )
    return found


def odometry_rows(path: Path, columns: Mapping[str, str]) -> Iterator[str]:
    """The lines of an odometry.csv, without the header. columns: as of `parse_columns`.

    Times are taken over to the nanosecond. Raises InputError for a file without such columns, and for a row that
    cannot be read.
    """
    lines = enumerate(text_lines(path), start=1)
    number, first = next(lines, (0, ""))
    separator = max(_SEPARATORS, key=first.count)
    names = _cells(first, separator)
    bare = bool(names) and all(to_number(name) is not None for name in names)  # no header
    positions = {key: _position(path, name, names, bare) for key, name in columns.items()}
    time_key = next(key for key in columns if key in _NANOSECONDS)
    places = {_UNITS[key][0]: (position, _UNITS[key][1]) for key, position in positions.items() if key in _UNITS}
    if bare:
        yield _row(path, number, names, (positions[time_key], time_key), places)
    for number, line in lines:
        if line.strip():
            yield _row(path, number, _cells(line, separator), (positions[time_key], time_key), places)


def _cells(line: str, separator: str) -> list[str]:
    cells = line.split() if separator == " " else line.split(separator)
    return [cell.strip().strip('"') for cell in cells]


def _position(path: Path, name: str, names: Sequence[str], bare: bool) -> int:
    if name in names and not bare:
        return names.index(name)
    if re.fullmatch("[0-9]{1,6}", name) and 1 <= int(name) <= len(names):
        return int(name) - 1
    raise InputError(f"{path}: has no column {name[:50]!r}; its columns are {listed(list(names))[:300]}")


def _row(
    path: Path, number: int, cells: list[str], time: tuple[int, str], places: Mapping[str, tuple[int, float]]
) -> str:
    try:
        stamp = _stamp_ns(cells[time[0]], time[1])
        values = []
        for key in ("x", "y", "theta"):
            position, unit = places[key]
            value = to_number(cells[position])
            if value is None or not math.isfinite(value):
                raise InputError(f"{path}, line {number}: {key} reads {cells[position][:30]!r}, which is no number")
            values.append(cells[position] if unit == 1.0 else repr(value * unit))
    except IndexError:
        raise InputError(f"{path}, line {number}: has only {len(cells)} values") from None
    if stamp is None:
        raise InputError(f"{path}, line {number}: the time reads {cells[time[0]][:30]!r}, which is no number")
    return ",".join([decimal_seconds(stamp), *values])


def _stamp_ns(cell: str, key: str) -> int | None:
    try:
        return decimal_ns(str(Decimal(cell) * _NANOSECONDS[key] / 1_000_000_000))
    except InvalidOperation:
        return None
