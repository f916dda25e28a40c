"""field.yaml: read, checked and written. See docs/how-to-field.md."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from touchline.errors import InputError
from touchline.field.model import FieldModel, Goal, Pole
from touchline.files.yaml_text import read_yaml_mapping, yaml_line
from touchline.messages import did_you_mean, shown

_SIZES = ("length", "width", "line_width")
_ROWS = {"segments": 4, "circles": 3, "arcs": 5, "discs": 3}
_REMARKS = ("frame", "measured_to", "primitives", "format")
_KNOWN = ("name", "description", *_SIZES, "border", "letters", *_ROWS, "goals", "poles", *_REMARKS)
_GOAL = ("x", "y_posts", "post_width", "post_shape", "height", "depth", "color")
_POLE = ("x", "y", "diameter", "height", "bands_from_ground")


def load_field(path: Path) -> FieldModel:
    """The field of a field.yaml. Rows of lines, goals and poles are optional; unknown keys are refused unless text.

    Raises InputError naming the file, the line, the key and the row of what is wrong.
    """
    mapping = read_yaml_mapping(path)
    try:
        return _field_from_mapping(mapping, default_name=path.stem)
    except InputError as error:
        key, _, rest = str(error).partition(":")
        raise InputError(f"{path}{_line_of(path, key)}: {key}:{rest}") from None


def _field_from_mapping(mapping: dict[str, Any], default_name: str) -> FieldModel:
    """The field in the keys of a field.yaml; the text of an InputError starts with `key:` or `key, row N:`."""
    for key, value in mapping.items():
        # A remark is text; a misspelt `segment:` holds rows and would silently lose lines.
        if key not in _KNOWN and not isinstance(value, str):
            raise InputError(f"{key}: is not a key of a field; {did_you_mean(str(key), _KNOWN)}")
    for key in _SIZES:
        if key not in mapping:
            raise InputError(f"{key}: is missing")
    return FieldModel(
        name=str(mapping.get("name", default_name)),
        length=_number("length", mapping["length"]),
        width=_number("width", mapping["width"]),
        line_width=_number("line_width", mapping["line_width"]),
        border=_number("border", mapping.get("border", 1.0)),
        goals=[_goal(f"goals, row {i}", row) for i, row in enumerate(_list("goals", mapping), start=1)],
        poles=[_pole(f"poles, row {i}", row) for i, row in enumerate(_list("poles", mapping), start=1)],
        description=str(mapping.get("description", "")),
        letters=_letters(mapping.get("letters")),
        **{key: _number_rows(key, _list(key, mapping), columns) for key, columns in _ROWS.items()},
    )


def _list(key: str, mapping: dict[str, Any]) -> list[Any]:
    value = mapping.get(key)
    if value is None:
        return []
    if not isinstance(value, list):
        raise InputError(f"{key}: expected a list of rows, found {shown(value)}")
    return value


def _letters(value: Any) -> dict[str, float]:
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise InputError(f"letters: expected rulebook letters and metres, found {shown(value)}")
    return {str(letter): _number("letters", metres) for letter, metres in value.items()}


def _number(where: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{where}: expected a number, found {shown(value)}")
    return float(value)


def _positive(where: str, value: Any) -> float:
    number = _number(where, value)
    if number <= 0.0:
        raise InputError(f"{where}: expected a positive number, found {shown(value)}")
    return number


def _number_rows(key: str, rows: list[Any], columns: int) -> Any:
    for number, row in enumerate(rows, start=1):
        if not isinstance(row, list) or len(row) != columns:
            raise InputError(f"{key}, row {number}: expected {columns} numbers, found {shown(row)}")
        for value in row:
            _number(f"{key}, row {number}", value)
    return rows


def _entries(where: str, row: Any, known: tuple[str, ...]) -> dict[str, Any]:
    if not isinstance(row, dict):
        raise InputError(f"{where}: expected the keys {', '.join(known)}, found {shown(row)}")
    for key in row:
        if key not in known:
            raise InputError(f"{where}: has no key '{key}'; {did_you_mean(str(key), known)}")
    for key in known:
        if key not in row:
            raise InputError(f"{where}: '{key}' is missing")
    return row


def _goal(where: str, row: Any) -> Goal:
    entries = _entries(where, row, _GOAL)
    posts = entries["y_posts"]
    if not isinstance(posts, list) or not posts:
        raise InputError(f"{where}: y_posts needs a list of numbers, found {shown(posts)}")
    if entries["post_shape"] not in ("round", "square"):
        raise InputError(f"{where}: post_shape is round or square, found {shown(entries['post_shape'])}")
    return Goal(
        x=_number(f"{where}: x", entries["x"]),
        y_posts=tuple(_number(f"{where}: y_posts", y) for y in posts),
        post_width=_positive(f"{where}: post_width", entries["post_width"]),
        post_shape=entries["post_shape"],
        height=_positive(f"{where}: height", entries["height"]),
        depth=_positive(f"{where}: depth", entries["depth"]),
        color=str(entries["color"]),
    )


def _pole(where: str, row: Any) -> Pole:
    entries = _entries(where, row, _POLE)
    bands = entries["bands_from_ground"]
    if not isinstance(bands, list) or not bands:
        raise InputError(f"{where}: bands_from_ground needs a list of colours, found {shown(bands)}")
    return Pole(
        x=_number(f"{where}: x", entries["x"]),
        y=_number(f"{where}: y", entries["y"]),
        diameter=_positive(f"{where}: diameter", entries["diameter"]),
        height=_positive(f"{where}: height", entries["height"]),
        bands_from_ground=tuple(str(band) for band in bands),
    )


def _line_of(path: Path, key: str) -> str:
    """', line N' of a top-level key, or of its row for 'key, row N'; nothing if the key is not there."""
    name, _, row = key.partition(", row ")
    line = yaml_line(path, [name, int(row) - 1] if row else [name])
    return "" if line is None else f", line {line}"
