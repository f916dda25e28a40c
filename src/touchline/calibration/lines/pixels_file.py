"""Line points in pixels, from a file: `u_px,v_px`, one row for each."""

import re
from collections.abc import Sequence
from itertools import islice
from pathlib import Path

import numpy as np

from touchline.calibration.lines.images import Circle
from touchline.errors import InputError
from touchline.files.opened import text_lines
from touchline.geometry import FloatArray
from touchline.types import MAX_OBSERVED_POINTS

_MAX_PX = 20_000.0
_COLUMNS = ("u_px", "v_px")


def read_pixels(path: Path) -> FloatArray:
    """Different pixels (N, 2) u, v of a CSV file with the columns u_px and v_px. Raises InputError naming the line."""
    rows = [line.rstrip("\r\n") for line in islice(text_lines(path), MAX_OBSERVED_POINTS + 2)]
    header = [name.strip() for name in rows[0].split(",")] if rows else []
    if any(name not in header for name in _COLUMNS):
        raise InputError(f"{path}: needs the columns {' and '.join(_COLUMNS)}, found {','.join(header)!r}")
    columns = [header.index(name) for name in _COLUMNS]
    pixels = []
    for number, row in enumerate(rows[1:], start=2):
        if not row.strip():
            continue
        try:
            pair = [float(row.split(",")[column]) for column in columns]
        except (ValueError, IndexError):
            pair = [np.nan]
        if not (np.all(np.isfinite(pair)) and max(map(abs, pair)) < _MAX_PX):
            raise InputError(f"{path}, line {number}: expected two numbers, u_px and v_px, found {row!r}")
        pixels.append(pair)
    if len(pixels) > MAX_OBSERVED_POINTS:
        raise InputError(f"{path}: holds more than {MAX_OBSERVED_POINTS} points, the most of one file")
    if not pixels:
        raise InputError(f"{path}: holds no points")
    return np.unique(np.array(pixels), axis=0)


def image_size(text: str | None, pixels: Sequence[FloatArray]) -> tuple[int, int]:
    """Width and height from `640x480`; without it the smallest that hold the points, as whole multiples of 16."""
    farthest = np.concatenate(list(pixels)).max(axis=0)
    if text is None:
        width, height = (16 * int(np.ceil((float(value) + 17.0) / 16.0)) for value in farthest)
        return width, height
    match = re.fullmatch(r"([0-9]{1,5})[xX]([0-9]{1,5})", text.strip())
    if match is None or max(map(int, match.groups())) > _MAX_PX:
        raise InputError(f"--size: expected WIDTHxHEIGHT, 640x480 for instance, found {text[:50]!r}")
    width, height = int(match[1]), int(match[2])
    if farthest[0] > width - 0.5 or farthest[1] > height - 0.5:
        raise InputError(f"--size: points reach to {farthest[0]:g}, {farthest[1]:g}, outside an image of {text}")
    return width, height


def rough_circle(pixels: Sequence[FloatArray]) -> Circle:
    """The middle between the outermost points, and the radius that holds all."""
    points = np.concatenate(list(pixels))
    center = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return Circle(center, float(np.hypot(*(points - center).T).max()))
