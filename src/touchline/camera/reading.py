"""The values of a camera.yaml, checked; every error names the file and the key."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from touchline.errors import InputError
from touchline.geometry import FloatArray


def require_keys(tree: Mapping[str, Any], keys: Sequence[str], path: Path, what: str) -> None:
    """Raises InputError for the first missing key, with the unknown one that may have been meant for it."""
    for key in keys:
        if key not in tree:
            unknown = [str(other) for other in tree if other not in (*keys, "model")]
            alike = difflib.get_close_matches(key, unknown, n=1)
            hint = f" (is '{alike[0]}' meant for it?)" if alike else ""
            raise InputError(f"{path}: '{key}' is missing{hint}; {what} needs {', '.join(keys)}")


def read_number(value: Any, path: Path, key: str) -> float:
    """A finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise InputError(f"{path}: '{key}' must be a number, found {value!r}")
    return float(value)


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
            raise InputError(f"{path}: '{key}' must be a whole number of pixels, found {tree[key]!r}")
    return int(sizes["width"]), int(sizes["height"])


def read_switch(tree: Mapping[str, Any], key: str, default: bool, path: Path) -> bool:
    """true or false; the default where the key is missing."""
    value = tree.get(key, default)
    if not isinstance(value, bool):
        raise InputError(f"{path}: '{key}' must be true or false, found {value!r}")
    return value
