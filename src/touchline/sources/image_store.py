"""Where the images of a recording are kept: beside its tables, or in a bag."""

from __future__ import annotations

from typing import Protocol

from touchline.files.images import read_image_bytes
from touchline.files.opened import OwnFolder, UnreadableError
from touchline.sources.decoding import Decoded, decode_image
from touchline.sources.problems import ProblemKind


class ImageStore(Protocol):
    """Images by their row of images.csv, from 0, and by the name that stands there."""

    def decode(self, row: int, name: str, expected: tuple[int, int] | None) -> Decoded:
        """The image as it was stored, or why there is none. expected: width and height, where they are known."""
        ...

    def file_bytes(self, row: int, name: str) -> bytes:
        """The image as the content of a file of that name. Raises UnreadableError if there is none."""
        ...


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
