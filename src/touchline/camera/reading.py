"""The values of a camera.yaml, checked; every error names the file and the key."""

import difflib
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from touchline.errors import InputError
from touchline.files.images import MAX_SIDE_PX, ImageSize, too_large
from touchline.files.yaml_text import yaml_line
from touchline.geometry import FloatArray
from touchline.messages import did_you_mean, shown


@contextmanager
def naming_lines(path: Path) -> Iterator[None]:
    """An InputError inside that starts with `path: 'key'` is given the key's line in the file, if it is there."""
    try:
        yield
    except InputError as error:
        text = str(error)
        found = re.match(rf"{re.escape(str(path))}: '([\w.: ]+)'", text)
        line = None if found is None else yaml_line(path, re.split(r"[.:] ?", found[1]))
        if line is None:
            raise
        raise InputError(f"{path}, line {line}{text.removeprefix(str(path))}") from None


def check_keys(tree: Mapping[str, Any], keys: Sequence[str], optional: Sequence[str], path: Path, what: str) -> None:
    """Raises InputError for the first missing key, with the unknown one that may have been meant for it, and for an
    unknown one that is no remark: remarks are text.
    """
    for key in keys:
        if key not in tree:
            unknown = [str(other) for other in tree if other not in (*keys, "model")]
            alike = difflib.get_close_matches(key, unknown, n=1)
            hint = f" (is '{alike[0]}' meant for it?)" if alike else ""
            raise InputError(f"{path}: '{key}' is missing{hint}; {what} needs {', '.join(keys)}")
    known = ("model", *keys, *optional)
    for key, value in tree.items():
        if key not in known and not isinstance(value, str):
            raise InputError(f"{path}: '{key}' is not a key of {what}; {did_you_mean(str(key), known)}")


def check_inner_keys(tree: Mapping[str, Any], known: Sequence[str], path: Path, name: str) -> None:
    """Raises InputError for a key of a mapping inside of the file, called `name`, that is not known."""
    for key in tree:
        if key not in known:
            raise InputError(f"{path}: '{name}.{key}' is not a key of '{name}'; {did_you_mean(str(key), known)}")


def read_number(value: Any, path: Path, key: str) -> float:
    """A finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise InputError(f"{path}: '{key}' must be a number, found {shown(value)}")
    return float(value)


def read_pixels(value: Any, path: Path, key: str) -> float:
    """A place or a radius in an image."""
    number = read_number(value, path, key)
    if abs(number) > MAX_SIDE_PX:
        raise InputError(f"{path}: '{key}' is {number:g}; an image has {MAX_SIDE_PX} pixels a side at most")
    return number


def read_numbers(value: Any, path: Path, key: str, dimensions: int) -> FloatArray:
    """An array of finite numbers with one or two dimensions."""
    try:
        array: FloatArray = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{path}: '{key}' must be a list of numbers (rows of equal length)") from None
    if array.ndim != dimensions or array.size == 0 or not np.all(np.isfinite(array)):
        raise InputError(f"{path}: '{key}' must be a list of finite numbers{' for each bearing' * (dimensions == 2)}")
    return array


def read_image_size(tree: Mapping[str, Any], path: Path) -> tuple[int, int]:
    """Width and height, whole numbers of pixels."""
    sizes = {key: read_number(tree[key], path, key) for key in ("width", "height")}
    for key, size in sizes.items():
        if size != int(size) or size < 1:
            raise InputError(f"{path}: '{key}' must be a whole number of pixels, found {shown(tree[key])}")
        if size > MAX_SIDE_PX:
            raise InputError(f"{path}: '{key}' is {size:g}; a side has {MAX_SIDE_PX} pixels at most")
    image = ImageSize(int(sizes["width"]), int(sizes["height"]))
    if (what := too_large(image)) is not None:
        raise InputError(f"{path}: the image {what}")
    return image.width, image.height


def read_switch(tree: Mapping[str, Any], key: str, default: bool, path: Path) -> bool:
    """true or false; the default where the key is missing."""
    value = tree.get(key, default)
    if not isinstance(value, bool):
        raise InputError(f"{path}: '{key}' must be true or false, found {shown(value)}")
    return value
