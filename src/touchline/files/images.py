"""Image files: the size is read from the header, before a decoder asks for memory."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from touchline.errors import InputError
from touchline.files.opened import UnreadableError, read_bytes

MAX_SIDE_PX = 20_000
MAX_MEGAPIXELS = 50.0
MEGAPIXELS_VARIABLE = "TOUCHLINE_MAX_MEGAPIXELS"
_BYTES_PER_PIXEL = 4  # no file is larger than its pixels, uncompressed: 50 megapixels are 200 MB
_FORMATS = "JPEG, PNG, BMP, TIFF, WebP, PGM or PPM"
_PNG_START = b"\x89PNG\r\n\x1a\n"
# The tags of a TIFF file that tell how much is decoded at once, and the sizes of their types in bytes.
_TIFF_WIDTHS, _TIFF_HEIGHTS, _TIFF_TYPES = (256, 322), (257, 323), {3: 2, 4: 4, 16: 8}
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_ALONE = frozenset((0x00, 0x01, *range(0xD0, 0xD9)))  # markers without a segment
_JPEG_ENDS = (0xD9, 0xDA)
_JPEG_MARKER = re.compile(rb"\xff+([^\xff])")
_MAX_SEGMENTS = 10_000
_PNM_HEADER = re.compile(rb"P[1-6](?:\s|#[^\n]*\n)+(\d{1,9})(?:\s|#[^\n]*\n)+(\d{1,9})\s")


class ImageSize(NamedTuple):
    """What a header says (pixels)."""

    width: int
    height: int


def max_megapixels() -> float:
    """How large an image may be, which TOUCHLINE_MAX_MEGAPIXELS can set. Raises InputError where it is no number."""
    text = os.environ.get(MEGAPIXELS_VARIABLE, "").strip()
    if not text:
        return MAX_MEGAPIXELS
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if not 0.0 < number <= MAX_SIDE_PX**2 / 1e6:
        raise InputError(
            f"{MEGAPIXELS_VARIABLE}={text:.40}: expected a number of megapixels up to {MAX_SIDE_PX**2 / 1e6:g}"
        )
    return number


def too_large(size: ImageSize) -> str | None:
    """Why images of this size are not read; None if they are."""
    if max(size) > MAX_SIDE_PX:
        return f"is {size.width}×{size.height} pixels; a side may have {MAX_SIDE_PX}"
    if size.width * size.height > max_megapixels() * 1e6:
        return (
            f"is {size.width}×{size.height} pixels, more than {max_megapixels():g} megapixels; "
            f"{MEGAPIXELS_VARIABLE} sets how many are read"
        )
    return None


def read_image_bytes(path: Path) -> bytes:
    """An image file as it is, at most 4 bytes for each pixel that is allowed (200 MB). Raises UnreadableError."""
    return read_bytes(path, int(max_megapixels() * 1e6) * _BYTES_PER_PIXEL, f"; see {MEGAPIXELS_VARIABLE}")


def image_size(data: bytes) -> ImageSize | None:
    """The size in the header of an image file; None for formats that are not known, and where there is none."""
    for start, read in _HEADERS:
        if data.startswith(start):
            try:
                size = read(data)
            except (IndexError, ValueError):  # the file ends within its header
                return None
            return size if size is not None and min(size) > 0 else None
    return None


def decode(data: bytes, flags: int) -> npt.NDArray[Any] | str:
    """The pixels (H, W) or (H, W, 3) BGR of an image file as cv2.imdecode's flags say, or why there are none."""
    size = image_size(data)
    if size is None:
        return f"is not an image that can be decoded ({_FORMATS})"
    if (what := too_large(size)) is not None:
        return what
    if data.startswith(_PNG_START) and _png_claims_more(data):
        return "is a PNG file that ends early, or is damaged inside"
    try:
        pixels = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
    except cv2.error:
        pixels = None
    return "is not an image that can be decoded" if pixels is None else pixels


def read_image(path: Path, flags: int = cv2.IMREAD_COLOR) -> npt.NDArray[Any]:
    """The pixels (H, W) or (H, W, 3) BGR of an image file. Raises UnreadableError if it is none, or too large."""
    pixels = decode(read_image_bytes(path), flags)
    if isinstance(pixels, str):
        raise UnreadableError(path, pixels)
    return pixels


def _png(data: bytes) -> ImageSize:
    return ImageSize(int.from_bytes(data[16:20]), int.from_bytes(data[20:24]))


def _png_claims_more(data: bytes) -> bool:
    """Whether a part of the file says that it is longer than the whole file: OpenCV would make room for it first."""
    at = len(_PNG_START)
    while at + 8 <= len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        if length > len(data):
            return True
        at += length + 12
    return False


def _jpeg(data: bytes) -> ImageSize | None:
    at = 2
    for _ in range(_MAX_SEGMENTS):
        found = _JPEG_MARKER.search(data, at)  # what stands between segments is passed over, as the decoder does
        if found is None:
            return None
        at = found.start(1)
        marker = data[at]
        if marker in _JPEG_FRAMES:
            return ImageSize(int.from_bytes(data[at + 6 : at + 8]), int.from_bytes(data[at + 4 : at + 6]))
        if marker in _JPEG_ENDS:
            return None
        at += 1 if marker in _JPEG_ALONE else 1 + int.from_bytes(data[at + 1 : at + 3])
    return None


def _bmp(data: bytes) -> ImageSize:
    if int.from_bytes(data[14:18], "little") == 12:
        return ImageSize(int.from_bytes(data[18:20], "little"), int.from_bytes(data[20:22], "little"))
    width, height = (int.from_bytes(data[at : at + 4], "little", signed=True) for at in (18, 22))
    return ImageSize(abs(width), abs(height))


def _tiff(data: bytes) -> ImageSize:
    """The size of the first image, or of its tiles where they are larger."""
    order = "little" if data.startswith(b"I") else "big"

    def number(at: int, length: int) -> int:
        if not 0 <= at <= len(data) - length:
            raise IndexError
        return int.from_bytes(data[at : at + length], order)  # type: ignore[arg-type]

    long = number(2, 2) == 43  # BigTIFF
    count_bytes, entry_bytes, value_at = (8, 20, 12) if long else (2, 12, 8)
    start = number(8, 8) if long else number(4, 4)
    sides = {False: 0, True: 0}
    for index in range(min(number(start, count_bytes), 4096)):
        at = start + count_bytes + index * entry_bytes
        tag, length = number(at, 2), _TIFF_TYPES.get(number(at + 2, 2))
        if length is not None and tag in (*_TIFF_WIDTHS, *_TIFF_HEIGHTS):
            wide = tag in _TIFF_WIDTHS
            sides[wide] = max(sides[wide], number(at + value_at, length))
    return ImageSize(sides[True], sides[False])


def _webp(data: bytes) -> ImageSize | None:
    kind = data[12:16]
    if data[8:12] != b"WEBP" or len(data) < 30:
        return None
    if kind == b"VP8X":
        return ImageSize(1 + int.from_bytes(data[24:27], "little"), 1 + int.from_bytes(data[27:30], "little"))
    if kind == b"VP8L":
        bits = int.from_bytes(data[21:25], "little")
        return ImageSize(1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF))
    width, height = (int.from_bytes(data[at : at + 2], "little") & 0x3FFF for at in (26, 28))
    return ImageSize(width, height) if kind == b"VP8 " else None


def _pnm(data: bytes) -> ImageSize | None:
    found = _PNM_HEADER.match(data[:4096])
    if found is None:
        return None
    size = ImageSize(int(found[1]), int(found[2]))
    per_byte = 8 if data.startswith(b"P4") else 1
    whole = len(data) * per_byte >= size.width * size.height  # nothing is compressed: a short file has no such size
    return size if whole else None


_HEADERS: tuple[tuple[tuple[bytes, ...], Callable[[bytes], ImageSize | None]], ...] = (
    ((_PNG_START,), _png),
    ((b"\xff\xd8",), _jpeg),
    ((b"BM",), _bmp),
    ((b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"), _tiff),
    ((b"RIFF",), _webp),
    (tuple(b"P%d" % kind for kind in range(1, 7)), _pnm),
)
