"""A video, or a folder of numbered images, as a recording; odometry from a CSV file beside it."""

from __future__ import annotations

import itertools
import math
import re
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from touchline.errors import InputError
from touchline.files.images import ImageSize, read_image_bytes, too_large
from touchline.files.opened import UnreadableError, open_bytes, text_lines
from touchline.messages import did_you_mean, listed
from touchline.sources.bags.roles import BagOptions
from touchline.sources.bags.table_rows import decimal_ns, decimal_seconds
from touchline.sources.decoding import Decoded, ImageStore, decode_image
from touchline.sources.description import SEQUENCE
from touchline.sources.folder import Recording
from touchline.sources.new_description import TemporaryFolder, copy_camera, named_field, write_field, write_yaml
from touchline.sources.problems import ProblemKind, ProblemLog
from touchline.sources.tables import to_number

_IMAGES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm")


@dataclass(frozen=True, slots=True)
class LooseOptions:
    """What loose images do not say of themselves. rate_hz: of the images; None for a video's own times.

    odometry: a CSV file; columns: see `parse_columns`. first_s: the time of the first image on the CSV's clock, as
    decimal text.
    """

    rate_hz: float | None = None
    odometry: Path | None = None
    columns: str = "t=t,x=x,y=y,theta=theta"
    first_s: str = "0"


def is_loose(path: Path) -> bool:
    """Whether a path is a video, or a folder of images that is no recording."""
    if path.is_dir():
        return not (path / SEQUENCE).exists() and any(file.suffix.lower() in _IMAGES for file in path.iterdir())
    return path.suffix.lower() in ENDINGS


def open_loose(path: Path, options: LooseOptions, described: BagOptions) -> Recording:
    """The recording that a video or numbered images make. described: its field and camera.

    Raises InputError for what is missing, and for what cannot be read.
    """
    field = named_field(path, described.field)
    first_ns = decimal_ns(options.first_s)
    if first_ns is None:
        raise InputError(f"--first-image-at {options.first_s}: expected seconds, as a decimal number")
    if options.rate_hz is not None and not 0.001 <= options.rate_hz <= 100_000.0:
        raise InputError(f"--rate {options.rate_hz:g}: expected images per second")
    folder = TemporaryFolder()
    images, stamps, ending = _folder_images(path, options) if path.is_dir() else _video_images(path, options)
    target = folder.path
    about: dict[str, Any] = {"format": 1, "name": path.stem, "field": write_field(field, described.field, target)}
    about["camera"] = "pinhole" if described.camera is None else copy_camera(described.camera, target)
    if len(stamps) > 1 and stamps[-1] > stamps[0]:
        about["rate_hz"] = round((len(stamps) - 1) * 1e9 / (stamps[-1] - stamps[0]), 3)
    write_yaml(target / SEQUENCE, about)
    rows = (
        f"{decimal_seconds(first_ns + stamp)},images/{index:06d}{ending(index)}" for index, stamp in enumerate(stamps)
    )
    _write_lines(target / "images.csv", itertools.chain(["t,file"], rows))
    if options.odometry is not None:
        columns = parse_columns(options.columns)
        odometry = itertools.chain(["t,x,y,theta"], odometry_rows(options.odometry, columns))
        _write_lines(target / "odometry.csv", odometry)
    problems = ProblemLog()
    if described.camera is None:
        problems.add(ProblemKind.TOPIC, path.name, "tells no camera: --camera FILE gives one")
    recording = Recording(target, path=path, images=images, problems=problems)
    recording.kept = folder
    return recording


def _video_images(path: Path, options: LooseOptions) -> tuple[ImageStore, array[int], Any]:
    video = VideoImages(path)
    stamps = video.stamps()
    if options.rate_hz is not None:
        stamps = _even(len(stamps), options.rate_hz)
    return video, stamps, lambda index: ".png"


def _folder_images(path: Path, options: LooseOptions) -> tuple[ImageStore, array[int], Any]:
    files = sorted((file for file in path.iterdir() if file.suffix.lower() in _IMAGES), key=_numbers)
    if options.rate_hz is None:
        raise InputError(f"{path}: holds {len(files)} images, but nobody says when they were taken: --rate HZ")
    return ListedImages(files), _even(len(files), options.rate_hz), lambda index: files[index].suffix


def _even(count: int, rate_hz: float) -> array[int]:
    return array("q", [round(index * 1e9 / rate_hz) for index in range(count)])


def _numbers(file: Path) -> tuple[tuple[int, ...], str]:
    """Sort key of img-9.png before img-10.png."""
    return tuple(int(digits) for digits in re.findall(r"\d+", file.stem)), file.name


def _write_lines(path: Path, lines: Iterable[str]) -> None:
    with path.open("x", encoding="utf-8") as file:
        file.writelines(f"{line}\n" for line in lines)


class ListedImages:
    """An image store (see `ImageStore`) of files, whatever their names."""

    def __init__(self, files: list[Path]) -> None:
        self._files = files

    def decode(self, row: int, name: str, expected: tuple[int, int] | None) -> Decoded:
        """As `ImageStore` says."""
        return decode_image(self._files[row], expected)

    def file_bytes(self, row: int, name: str) -> bytes:
        """As `ImageStore` says."""
        if not 0 <= row < len(self._files):
            raise UnreadableError(Path(name), "is not there", missing=True)
        return read_image_bytes(self._files[row])


# --- odometry ---------------------------------------------------------------------------------------------------------


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


# --- videos -----------------------------------------------------------------------------------------------------------


ENDINGS = (".mp4", ".avi", ".mov", ".mkv", ".m4v", ".webm")


class VideoImages:
    """An image store (see `ImageStore`) of the images of a video, decoded one after the other.

    Raises UnreadableError if the file is no video.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._next = 0
        self._capture = self._opened()
        sides = (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
        if (what := too_large(ImageSize(*(int(self._capture.get(side)) for side in sides)))) is not None:
            raise UnreadableError(path, what)

    def stamps(self) -> array[int]:
        """The time of every image (ns), from 0, as the file tells it; as its rate tells it where it tells none."""
        self._restart()
        rate = float(self._capture.get(cv2.CAP_PROP_FPS))
        stamps = array("q")
        while self._capture.grab():
            stamp = round(1e6 * float(self._capture.get(cv2.CAP_PROP_POS_MSEC)))
            if stamps and stamp <= stamps[-1]:
                stamp = round(len(stamps) * 1e9 / rate) if rate > 0.0 else stamps[-1] + 1
            stamps.append(stamp)
        self._restart()
        if not stamps:
            raise UnreadableError(self._path, "holds no image that can be decoded")
        return array("q", [stamp - stamps[0] for stamp in stamps])

    def decode(self, row: int, name: str, expected: tuple[int, int] | None) -> Decoded:
        """As `ImageStore` says."""
        if row < self._next:
            self._restart()
        while self._next < row and self._capture.grab():
            self._next += 1
        done, pixels = self._capture.read()
        self._next += 1
        if not done or pixels is None:
            return Decoded(None, ProblemKind.BROKEN_IMAGE, "cannot be decoded")
        return Decoded(np.asarray(pixels, dtype=np.uint8))

    def file_bytes(self, row: int, name: str) -> bytes:
        """As `ImageStore` says: a PNG file, which loses nothing of what the video holds."""
        decoded = self.decode(row, name, None)
        if decoded.pixels is None:
            raise UnreadableError(self._path, decoded.what)
        return cv2.imencode(".png", decoded.pixels, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()

    def _restart(self) -> None:
        self._capture.release()
        self._capture, self._next = self._opened(), 0

    def _opened(self) -> Any:
        open_bytes(self._path).close()  # a regular file: OpenCV would open devices and addresses, too
        capture = cv2.VideoCapture(str(self._path.resolve()), cv2.CAP_FFMPEG)
        if not capture.isOpened():
            raise UnreadableError(self._path, "is not a video that can be read")
        return capture
