"""What was clicked, checked like any file from elsewhere, and the files that hold it."""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from touchline.calibration.marks import MARKS
from touchline.errors import InputError
from touchline.messages import shown
from touchline.perception.marked_colours import CLASSES

REGIONS, PIXELS = "regions.yaml", "pixels.csv"
_MAX_CLICKS = 10_000  # of each kind
_MAX_PX = 20_000.0
_MAX_M = 1_000.0
_MAX_NAME = 60


class Point(NamedTuple):
    """A marked point: image, name, pixel, and its place in the robot frame (m) if it was told."""

    file: str
    name: str
    u: float
    v: float
    place_m: tuple[float, float] | None


class Clicks(NamedTuple):
    """All that was clicked. regions: file, class, corners; lines: file and pixel of points on field lines."""

    points: tuple[Point, ...]
    regions: tuple[tuple[str, str, tuple[tuple[float, float], ...]], ...]
    lines: tuple[tuple[str, float, float], ...]


def read_clicks(text: bytes, files: Sequence[str]) -> Clicks:
    """What the page sends, JSON in UTF-8; files: the images that it shows. Raises InputError for anything else."""
    try:
        tree = json.loads(text.decode("utf-8"))
    except (ValueError, RecursionError):
        raise InputError("marks: expected JSON") from None
    if not isinstance(tree, dict):
        raise InputError(f"marks: expected points, regions and lines, found {shown(tree)}")
    points = tuple(_point(row, files) for row in _rows(tree, "points"))
    regions = tuple(_region(row, files) for row in _rows(tree, "regions"))
    lines = tuple((_file(row, files), _pixel(row, "u"), _pixel(row, "v")) for row in _rows(tree, "lines"))
    named = [(point.file, point.name) for point in points]
    for index, place in enumerate(named):
        if place in named[:index]:
            raise InputError(f"points: {place[1]} is marked twice in {place[0]}")
    return Clicks(points, regions, lines)


def files_of(clicks: Clicks, files: Sequence[str]) -> dict[str, str]:
    """Names and texts of the files that hold the clicks; kinds without any make none.

    Points on lines go into a file for each image, as `calibrate lines` reads them.
    """
    texts: dict[str, str] = {}
    if clicks.points:
        rows = (f"{p.file},{p.name},{p.u:.2f},{p.v:.2f},{_place(p.place_m)}" for p in clicks.points)
        texts[MARKS] = "\n".join(("file,name,u,v,x_m,y_m", *rows, ""))
    if clicks.regions:
        tree = [
            {"file": file, "class": kind, "polygon": [[round(u, 1), round(v, 1)] for u, v in corners]}
            for file, kind, corners in clicks.regions
        ]
        texts[REGIONS] = yaml.safe_dump(tree, sort_keys=False, default_flow_style=None, allow_unicode=True, width=120)
    for file in files:
        pixels = [f"{u:.2f},{v:.2f}" for name, u, v in clicks.lines if name == file]
        if pixels:
            name = PIXELS if len(files) == 1 else f"pixels-{Path(file).stem}.csv"
            texts[name] = "\n".join(("u_px,v_px", *pixels, ""))
    return texts


def _place(place_m: tuple[float, float] | None) -> str:
    return "," if place_m is None else f"{place_m[0]:.4f},{place_m[1]:.4f}"


def _rows(tree: dict[str, Any], key: str) -> list[dict[str, Any]]:
    rows = tree.get(key, [])
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise InputError(f"{key}: expected a list of marks, found {shown(rows)}")
    if len(rows) > _MAX_CLICKS:
        raise InputError(f"{key}: {len(rows)} are too many; {_MAX_CLICKS} are the most")
    return rows


def _point(row: dict[str, Any], files: Sequence[str]) -> Point:
    name = row.get("name")
    if not isinstance(name, str) or not name.strip() or len(name) > _MAX_NAME:
        raise InputError(f"points: a name has 1 to {_MAX_NAME} letters, found {shown(name)}")
    if any(letter in ',"' or not letter.isprintable() for letter in name):
        raise InputError(f"points: a name has no commas and no quotes, found {shown(name)}")
    x, y = row.get("x"), row.get("y")
    if (x is None) != (y is None):
        raise InputError(f"points: {name} needs both x and y, or neither")
    place = None if x is None else (_number(x, f"x of {name}", _MAX_M), _number(y, f"y of {name}", _MAX_M))
    return Point(_file(row, files), name.strip(), _pixel(row, "u"), _pixel(row, "v"), place)


def _region(row: dict[str, Any], files: Sequence[str]) -> tuple[str, str, tuple[tuple[float, float], ...]]:
    kind, corners = row.get("class"), row.get("polygon")
    if kind not in CLASSES:
        raise InputError(f"regions: a class is one of {', '.join(CLASSES)}, found {shown(kind)}")
    if not isinstance(corners, list) or not 3 <= len(corners) <= _MAX_CLICKS:
        raise InputError(f"regions: a polygon needs at least three corners, found {shown(corners)}")
    if not all(isinstance(corner, list) and len(corner) == 2 for corner in corners):
        raise InputError("regions: a corner is [u, v]")
    pixels = tuple((_number(u, "u", _MAX_PX), _number(v, "v", _MAX_PX)) for u, v in corners)
    return _file(row, files), str(kind), pixels


def _file(row: dict[str, Any], files: Sequence[str]) -> str:
    if row.get("file") not in files:
        raise InputError(f"marks: {shown(row.get('file'))} is none of the images")
    return str(row["file"])


def _pixel(row: dict[str, Any], key: str) -> float:
    return _number(row.get(key), key, _MAX_PX)


def _number(value: Any, what: str, largest: float) -> float:
    known = isinstance(value, int | float) and not isinstance(value, bool)
    if not known or not math.isfinite(value) or abs(value) > largest:
        raise InputError(f"marks: {what} is no number up to {largest:g}: {shown(value)}")
    return float(value)
