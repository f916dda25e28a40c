"""Line points from a CSV file, or from whatever else holds them."""

import csv
import math
from array import array
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from touchline.errors import InputError
from touchline.files.opened import text_lines
from touchline.geometry import FloatArray
from touchline.given import given_path
from touchline.localization.registration.weights import WeightSettings, precision_weights
from touchline.types import MAX_OBSERVED_POINTS, LinePoints, Observation

_NAMES = {"x_m": "x", "x": "x", "y_m": "y", "y": "y", "weight": "weight"}


def points_and_weights(
    points: str | Path | FloatArray | Sequence[Sequence[float]] | LinePoints | Observation,
) -> tuple[FloatArray, FloatArray | None]:
    """Points (N, 2) in m, robot frame, and weights (N,) or None, from a file, pairs of numbers or detected points.

    Raises InputError for a file that can't be read and for what is no table of numbers.
    """
    if isinstance(points, LinePoints):
        known = points.usable()
        return known.positions_m, precision_weights(known, WeightSettings())
    if isinstance(points, Observation):
        return points_and_weights(points.points)
    if isinstance(points, str | Path):
        return read_points(given_path("points", "the path of a CSV file", points))
    try:
        return np.asarray(points, dtype=np.float64), None
    except (TypeError, ValueError):
        raise InputError(
            "line points need two columns, x and y in metres: an array (N, 2) or a list of pairs"
        ) from None


def read_points(path: Path) -> tuple[FloatArray, FloatArray | None]:
    """Points (N, 2) in m, robot frame, and weights (N,) or None, from a CSV file.

    The header names the columns x_m and y_m (or x and y) and, if there is one, weight; others are passed over.
    Raises InputError with file and line for whatever can't be read.
    """
    columns: dict[str, int] | None = None
    numbers, lines = array("d"), array("q")
    reader = csv.reader(text_lines(path))
    try:
        for row in reader:
            if not any(map(str.strip, row)):
                continue
            if columns is None:
                columns = _columns(path, reader.line_num, row)
                continue
            if len(lines) == MAX_OBSERVED_POINTS:
                raise InputError(f"{path}: holds more than {MAX_OBSERVED_POINTS} points, the most of one observation")
            numbers.extend(_numbers(path, reader.line_num, row, columns))
            lines.append(reader.line_num)
    except csv.Error as error:
        raise InputError(f"{path}, line {reader.line_num}: cannot be read ({error})") from None
    if columns is None:
        raise InputError(f"{path}: is empty; expected a header x_m,y_m and one point per line")
    if not lines:
        raise InputError(f"{path}: holds no points after the header")
    table = np.frombuffer(numbers).reshape(len(lines), len(columns))
    if "weight" not in columns:
        return table, None
    negative = np.flatnonzero(table[:, 2] < 0)
    if len(negative):
        raise InputError(f"{path}, line {lines[int(negative[0])]}: a weight can't be negative")
    return np.ascontiguousarray(table[:, :2]), table[:, 2].copy()


def _columns(path: Path, line: int, header: list[str]) -> dict[str, int]:
    """Index of each known column, x and y first."""
    found: dict[str, int] = {}
    for index, name in enumerate(header):
        known = _NAMES.get(name.strip().lower())
        if known is not None and known not in found:
            found[known] = index
    if "x" not in found or "y" not in found:
        raise InputError(f"{path}, line {line}: expected the header x_m,y_m, found '{','.join(header)}'")
    return {name: found[name] for name in ("x", "y", "weight") if name in found}


def _numbers(path: Path, line: int, row: list[str], columns: dict[str, int]) -> list[float]:
    numbers = []
    for name, index in columns.items():
        if index >= len(row):
            raise InputError(f"{path}, line {line}: the {name} is missing")
        try:
            value = float(row[index])
        except ValueError:
            raise InputError(f"{path}, line {line}: the {name} '{row[index].strip()}' is not a number") from None
        if not math.isfinite(value):
            raise InputError(f"{path}, line {line}: the {name} '{row[index].strip()}' is not a finite number")
        numbers.append(value)
    return numbers
