"""marks.csv: points that were marked in images, some of them of known place on the ground."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from touchline.errors import InputError, TouchlineError
from touchline.files.images import read_image
from touchline.files.opened import OwnFolder
from touchline.geometry import FloatArray
from touchline.sources import ProblemLog
from touchline.sources.tables import Line, Table, open_table, parse_row, read_lines
from touchline.types import ImageArray

MARKS = "marks.csv"
_COLUMNS = ("u", "v", "x_m", "y_m")


@dataclass(frozen=True, eq=False, slots=True)
class Marks:
    """pixels, places_m: (N, 2); places in the robot frame, NaN where unknown. files, names: of each; lines: where."""

    path: Path
    files: tuple[str, ...]
    names: tuple[str, ...]
    pixels: FloatArray
    places_m: FloatArray
    lines: tuple[int, ...]


def read_marks(path: Path) -> Marks:
    """All marks of a file `file,name,u,v,x_m,y_m`. Raises InputError with file and line for what can't be read."""
    table = open_table(path, ["file", "name", *_COLUMNS])
    rows, cells, numbers = [], [], []
    for lines in read_lines(table):
        for line in lines:
            rows.append(_read(table, line))
            cells.append((_cell(table, line, "file"), _cell(table, line, "name")))
            numbers.append(line.number)
    values = np.array(rows, dtype=np.float64).reshape(-1, 4)
    files, names = zip(*cells, strict=True) if cells else ((), ())
    return Marks(path, tuple(files), tuple(names), values[:, :2], values[:, 2:], tuple(numbers))


def first_image(
    folder: Path, files: Iterable[str], size: tuple[int, int], follow_links: bool = False
) -> tuple[str, ImageArray] | None:
    """The first of these images, and its name, that lies in the folder and has a camera's size (width, height); None
    without one: a calibration does not need it.
    """
    own = OwnFolder(folder, follow_links)
    for name in dict.fromkeys(files):
        try:
            image: ImageArray = read_image(own.file(name))
        except TouchlineError:
            continue
        if image.shape == (size[1], size[0], 3):
            return name, image
    return None


def _read(table: Table, line: Line) -> list[float]:
    log = ProblemLog()
    row = parse_row(table, line, _COLUMNS, log, optional=("x_m", "y_m"))
    if row is None:
        what = str(log[0]).removesuffix("; the row is left out").partition(": ")[2]
        raise InputError(f"{table.path}, line {line.number}: {what}")
    if math.isnan(row[2]) != math.isnan(row[3]):
        raise InputError(f"{table.path}, line {line.number}: needs both x_m and y_m, or neither")
    return row


def _cell(table: Table, line: Line, name: str) -> str:
    return line.text.split(",")[table.columns[name]].strip().strip('"')
