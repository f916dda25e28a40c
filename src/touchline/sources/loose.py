"""A video, or a folder of numbered images, as a recording; odometry from a CSV file beside it."""

from __future__ import annotations

import itertools
import re
from array import array
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from touchline.errors import InputError
from touchline.files.images import read_image_bytes
from touchline.files.opened import UnreadableError
from touchline.sources.bags.roles import BagOptions
from touchline.sources.bags.table_rows import decimal_ns, decimal_seconds
from touchline.sources.decoding import Decoded, ImageStore, decode_image
from touchline.sources.description import SEQUENCE
from touchline.sources.folder import Recording
from touchline.sources.new_description import TemporaryFolder, copy_camera, named_field, write_field, write_yaml
from touchline.sources.odometry_csv import odometry_rows, parse_columns
from touchline.sources.problems import ProblemKind, ProblemLog
from touchline.sources.video import ENDINGS, VideoImages

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
