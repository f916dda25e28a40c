"""field.yaml: read, checked and written. See docs/how-to-field.md."""

import functools
import math
from dataclasses import fields
from pathlib import Path
from typing import Any

from touchline.errors import InputError
from touchline.field.model import COLUMNS, FieldModel, Goal, Pole
from touchline.files.yaml_text import read_yaml_mapping, yaml_line
from touchline.messages import did_you_mean, shown

_SIZES = ("length", "width", "line_width")
_LISTS = {"y_posts": "numbers", "bands_from_ground": "colours"}
_REMARKS = ("frame", "measured_to", "primitives", "format")
_KNOWN = ("name", "description", *_SIZES, "border", "letters", *COLUMNS, "goals", "poles", *_REMARKS)


def load_field(path: Path) -> FieldModel:
    """The field of a field.yaml. Rows of lines, goals and poles are optional; unknown keys are refused unless text.

    The same field again is the same model, whose maps are there already.
    Raises InputError naming the file, the line, the key and the row of what is wrong.
    """
    mapping = read_yaml_mapping(path)
    try:
        field = _field_from_mapping(mapping, default_name=path.stem)
    except InputError as error:
        key, _, rest = str(error).partition(":")
        raise InputError(f"{path}{_line_of(path, key)}: {key}:{rest}") from None
    return _first_of_equal(field, field.description, tuple(field.letters.items()))


@functools.lru_cache(maxsize=2)
def _first_of_equal(field: FieldModel, *_not_compared: object) -> FieldModel:
    """The model of the first call with equal arguments; description and letters, which a field's == leaves out, too."""
    return field


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
        goals=_upright(Goal, "goals", _list("goals", mapping)),
        poles=_upright(Pole, "poles", _list("poles", mapping)),
        description=str(mapping.get("description", "")),
        letters=_letters(mapping.get("letters")),
        **{key: _number_rows(key, _list(key, mapping), columns) for key, columns in COLUMNS.items()},
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


def _number_rows(key: str, rows: list[Any], columns: int) -> Any:
    for number, row in enumerate(rows, start=1):
        if not isinstance(row, list) or len(row) != columns:
            raise InputError(f"{key}, row {number}: expected {columns} numbers, found {shown(row)}")
        for value in row:
            _number(f"{key}, row {number}", value)
    return rows


def _upright(kind: type[Any], key: str, rows: list[Any]) -> list[Any]:
    """The goals or poles of rows, which have the keys of their class."""
    known = [each.name for each in fields(kind)]
    found = []
    for number, row in enumerate(rows, start=1):
        where = f"{key}, row {number}"
        if not isinstance(row, dict):
            raise InputError(f"{where}: expected the keys {', '.join(known)}, found {shown(row)}")
        if unknown := [name for name in row if name not in known]:
            raise InputError(f"{where}: has no key '{unknown[0]}'; {did_you_mean(str(unknown[0]), known)}")
        if missing := [name for name in known if name not in row]:
            raise InputError(f"{where}: '{missing[0]}' is missing")
        found.append(kind(**{name: _entry(where, name, row[name]) for name in known}))
    return found


def _entry(where: str, key: str, value: Any) -> Any:
    """A value of a goal or a pole."""
    if key in _LISTS and (not isinstance(value, list) or not value):
        raise InputError(f"{where}: {key} needs a list of {_LISTS[key]}, found {shown(value)}")
    if key == "y_posts":
        return tuple(_number(f"{where}: {key}", y) for y in value)
    if key == "bands_from_ground":
        return tuple(map(str, value))
    if key == "post_shape" and value not in ("round", "square"):
        raise InputError(f"{where}: post_shape is round or square, found {shown(value)}")
    if key in ("post_shape", "color"):
        return str(value)
    number = _number(f"{where}: {key}", value)
    if number <= 0.0 and key not in ("x", "y"):
        raise InputError(f"{where}: {key}: expected a positive number, found {shown(value)}")
    return number


def _line_of(path: Path, key: str) -> str:
    """', line N' of a top-level key, or of its row for 'key, row N'; nothing if the key is not there."""
    name, _, row = key.partition(", row ")
    line = yaml_line(path, [name, int(row) - 1] if row else [name])
    return "" if line is None else f", line {line}"
