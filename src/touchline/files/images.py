"""Image files: the size is read from the header, before a decoder asks for memory."""

from __future__ import annotations

import functools
import io
import os
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from touchline.errors import InputError
from touchline.files.opened import UnreadableError, read_bytes

if TYPE_CHECKING:
    from PIL import ImageFile

MAX_SIDE_PX = 20_000
MAX_MEGAPIXELS = 50.0
MEGAPIXELS_VARIABLE = "TOUCHLINE_MAX_MEGAPIXELS"
_BYTES_PER_PIXEL = 4  # no file is larger than its pixels, uncompressed: 50 megapixels are 200 MB
_FORMATS = "JPEG, PNG, BMP, TIFF, WebP, PGM or PPM"
_PNG_START = b"\x89PNG\r\n\x1a\n"
_JPEG_START, _JPEG_MARKER, _JPEG_SCAN = b"\xff\xd8", 0xFF, 0xDA
_JPEG_BARE = frozenset({0x01, *range(0xD0, 0xD9)})  # markers without a segment, and so without its length
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # markers of the segments that hold the size
_TIFF_TILE = (322, 323)  # the tags of the width and height of what is decoded at once


class ImageSize(NamedTuple):
    """What a header says (pixels)."""

    width: int
    height: int


class JpegHeader(NamedTuple):
    """What the segments before the coded pixels say. scan: where these begin; None where it is unknown."""

    size: ImageSize | None
    scan: int | None


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
    try:
        if data.startswith(_JPEG_START):  # all of a season's: Pillow takes ten times as long
            size = jpeg_header(data).size
            return size if size is not None and min(size) > 0 else None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of damaged tags
            size = _header_size(data)
    except Exception:  # whatever a reader raises of a file that ends within its header, or is damaged there
        return None
    return size if size is not None and min(size) > 0 else None


def jpeg_header(data: bytes) -> JpegHeader:
    """The header of a JPEG file, segment by segment: one of them may hold a thumbnail with a header of its own."""
    at, size = len(_JPEG_START), None
    while at + 4 <= len(data) and data[at] == _JPEG_MARKER:
        marker = data[at + 1]
        if marker == _JPEG_MARKER or marker in _JPEG_BARE:
            at += 1 if marker == _JPEG_MARKER else 2  # what precedes a marker may be repeated
            continue
        if marker in _JPEG_FRAMES and at + 9 <= len(data):
            height, width = (int.from_bytes(data[at + k : at + k + 2], "big") for k in (5, 7))
            size = ImageSize(width, height)
        at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
        if marker == _JPEG_SCAN:
            return JpegHeader(size, at)
    return JpegHeader(size, None)


def decode(data: bytes, flags: int, size: ImageSize | None = None) -> npt.NDArray[Any] | str:
    """The pixels (H, W) or (H, W, 3) BGR of an image file as cv2.imdecode's flags say, or why there are none.

    size: as `image_size` has it, where that was asked already.
    """
    size = size or image_size(data)
    if size is None:
        return f"is not an image that can be decoded ({_FORMATS})"
    if (what := too_large(size)) is not None:
        return what
    if data.startswith(_PNG_START) and _png_claims_more(data):
        return "is a PNG file that ends early, or is damaged inside"
    import cv2  # takes its time, and whoever reads a camera.yaml needs none of it

    try:
        pixels = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
    except cv2.error:
        pixels = None
    return "is not an image that can be decoded" if pixels is None else pixels


def read_image(path: Path) -> npt.NDArray[Any]:
    """The pixels (H, W, 3) BGR of an image file. Raises UnreadableError if it is none, or too large."""
    from cv2 import IMREAD_COLOR

    pixels = decode(read_image_bytes(path), IMREAD_COLOR)
    if isinstance(pixels, str):
        raise UnreadableError(path, pixels)
    return pixels


def _png_claims_more(data: bytes) -> bool:
    """Whether a part of the file says that it is longer than the whole file: OpenCV would make room for it first."""
    at = len(_PNG_START)
    while at + 8 <= len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        if length > len(data):
            return True
        at += length + 12
    return False


@functools.cache
def _readers() -> dict[bytes, type[ImageFile.ImageFile]]:
    """What reads the header of a file, by its first bytes."""
    from PIL import BmpImagePlugin, PngImagePlugin, PpmImagePlugin, TiffImagePlugin, WebPImagePlugin

    return {
        _PNG_START: PngImagePlugin.PngImageFile,
        b"BM": BmpImagePlugin.BmpImageFile,
        b"RIFF": WebPImagePlugin.WebPImageFile,
        **dict.fromkeys((b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"), TiffImagePlugin.TiffImageFile),
        **dict.fromkeys((b"P%d" % kind for kind in range(1, 7)), PpmImagePlugin.PpmImageFile),
    }


def _header_size(data: bytes) -> ImageSize | None:
    """What Pillow reads of a header; of a TIFF file in tiles that of a tile, where it is larger."""
    reader = next((reader for start, reader in _readers().items() if data.startswith(start)), None)
    if reader is None:
        return None
    image = reader(io.BytesIO(data))
    tile = [getattr(image, "tag_v2", {}).get(tag, 0) for tag in _TIFF_TILE]
    size = ImageSize(max(image.width, tile[0]), max(image.height, tile[1]))
    per_byte = 8 if data.startswith(b"P4") else 1
    cut_off = data.startswith(b"P") and len(data) * per_byte < size.width * size.height  # nothing is compressed
    return None if cut_off else size
