"""Where the images of a recording are kept, and how one is decoded: what a decoder would fill in is broken here."""

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt

from touchline.files.images import ImageSize, decode, image_size, jpeg_header, read_image_bytes
from touchline.files.opened import OwnFolder, UnreadableError
from touchline.geometry import ByteArray
from touchline.sources.problems import ProblemKind
from touchline.types import ImageArray

_FLAGS = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
_PNG_START, _PNG_END = b"\x89PNG", b"IEND\xaeB`\x82"
_JPEG_START, _JPEG_END = b"\xff\xd8", b"\xff\xd9"
# In the coded pixels of a JPEG file 0xFF is followed by 0, a restart marker, 0xFF, or by what starts a new scan; the
# first that is not should be the file's end.
_JPEG_STRAY = re.compile(rb"\xff[^\x00\xc4\xd0-\xd7\xda-\xdd\xff]")
_SMALL_PX = 4_000_000  # decoded even where another size is expected: they may be damaged rather than too large
_FILL = 128  # what libjpeg paints where the coded pixels end before the image does


@dataclass(frozen=True, eq=False, slots=True)
class Decoded:
    """An image as it was stored (uint8 or uint16, BGR), or why there is none."""

    pixels: ByteArray | npt.NDArray[np.uint16] | None
    kind: ProblemKind | None = None
    what: str = ""


class ImageStore(Protocol):
    """Images by their row of images.csv, from 0, and by the name that stands there."""

    def decode(self, row: int, name: str, expected: tuple[int, int] | None) -> Decoded:
        """The image as it was stored, or why there is none. expected: width and height, where they are known."""

    def file_bytes(self, row: int, name: str) -> bytes:
        """The image as the content of a file of that name. Raises UnreadableError if there is none."""


class FolderImages:
    """Image files in a recording's folder."""

    def __init__(self, folder: OwnFolder) -> None:
        self._folder = folder

    def decode(self, row: int, name: str, expected: tuple[int, int] | None) -> Decoded:
        """As `ImageStore` says."""
        try:
            return decode_image(self._folder.file(name), expected)
        except UnreadableError as error:
            return Decoded(None, ProblemKind.MISSING_IMAGE, error.what)

    def file_bytes(self, row: int, name: str) -> bytes:
        """As `ImageStore` says."""
        return read_image_bytes(self._folder.file(name))


def decode_image(path: Path, expected: tuple[int, int] | None = None) -> Decoded:
    """Decode a file as it is stored. Files that end early or are damaged inside are broken, as far as can be told:
    OpenCV itself would give half an image without a word. A large image with more pixels than one of the expected
    size (width, height) is not decoded at all.
    """
    try:
        data = read_image_bytes(path)
    except UnreadableError as error:
        return Decoded(None, ProblemKind.MISSING_IMAGE, "is missing" if error.missing else error.what)
    return decode_bytes(data, expected)


def decode_bytes(data: bytes, expected: tuple[int, int] | None = None) -> Decoded:
    """As `decode_image`, of what a file holds."""
    if not data:
        return Decoded(None, ProblemKind.BROKEN_IMAGE, "is empty")
    if (damage := _damage(data)) is not None:
        return Decoded(None, ProblemKind.BROKEN_IMAGE, damage)
    size = image_size(data)
    if expected is not None and size is not None and math.prod(size) > max(math.prod(expected), _SMALL_PX):
        return _of_other_size(size, expected)
    pixels = decode(data, _FLAGS, size)
    if isinstance(pixels, str):
        return Decoded(None, ProblemKind.BROKEN_IMAGE, pixels)
    if data.startswith(_JPEG_START) and bool((pixels[-8:, -8:] == _FILL).all()) and bool((pixels != _FILL).any()):
        return Decoded(None, ProblemKind.BROKEN_IMAGE, "is a damaged JPEG file: its lower part is lost")
    return Decoded(pixels)


def usable_image(decoded: Decoded, size: tuple[int, int] | None) -> tuple[ImageArray | None, Decoded]:
    """The pixels as perception takes them (uint8, of `size` = width, height), or None and why."""
    pixels = decoded.pixels
    if pixels is None:
        return None, decoded
    height, width = pixels.shape[:2]
    if pixels.dtype != np.uint8:
        what = f"holds {8 * pixels.itemsize}-bit linear values; exposure and gain have to be applied before it is seen"
        return None, Decoded(None, ProblemKind.LINEAR_IMAGE, what)
    if size is not None and (width, height) != size:
        return None, _of_other_size(ImageSize(width, height), size)
    return pixels.astype(np.uint8, copy=False), decoded


def _of_other_size(found: ImageSize, expected: tuple[int, int]) -> Decoded:
    what = f"is {found.width}×{found.height} pixels, expected {expected[0]}×{expected[1]}"
    if found.width * expected[1] == found.height * expected[0]:
        what += f": {found.width / expected[0]:.3g} times that size"
    return Decoded(None, ProblemKind.IMAGE_SIZE, what)


def _damage(data: bytes) -> str | None:
    """What is wrong with the bytes of a JPEG or PNG file; None if nothing can be seen, or for another format."""
    if data.startswith(_PNG_START):
        return None if _PNG_END in data[-4096:] else "is a PNG file that ends early"
    if not data.startswith(_JPEG_START):
        return None
    start = jpeg_header(data).scan
    if start is None:
        return None  # the decoder will tell
    stray = _JPEG_STRAY.search(data, start)
    if stray is None or data.find(_JPEG_END, stray.start()) < 0:
        return "is a JPEG file that ends early"
    return None if data.startswith(_JPEG_END, stray.start()) else "is a damaged JPEG file"
