"""The images of a bag: fetched one by one, as they are stored."""

from __future__ import annotations

import tempfile
from pathlib import Path

from touchline.opened_files import UnreadableError
from touchline.sources.bags.extraction import ImagePlaces
from touchline.sources.bags.messages import Bag, Place
from touchline.sources.bags.with_rosbags import BadMessageError, Codec
from touchline.sources.decoding import Decoded, decode_bytes
from touchline.sources.problems import ProblemKind


class BagImages:
    """An image store (see `ImageStore`) of a bag's compressed images. folder: of the tables, kept as long as this."""

    def __init__(self, bag: Bag, codec: Codec, images: ImagePlaces, folder: tempfile.TemporaryDirectory[str]) -> None:
        self._bag = bag
        self._codec = codec
        self._images = images
        self._folder = folder

    def decode(self, row: int, name: str, expected: tuple[int, int] | None) -> Decoded:
        """As `ImageStore` says."""
        try:
            return decode_bytes(self.file_bytes(row, name), expected)
        except UnreadableError as error:
            return Decoded(None, ProblemKind.MISSING_IMAGE, error.what)

    def file_bytes(self, row: int, name: str) -> bytes:
        """As `ImageStore` says."""
        if not 0 <= row < len(self._images.places) or self._images.places[row, 0] < 0:
            raise UnreadableError(Path(name), "is not in the bag", missing=True)
        place = Place(*self._images.places[row].tolist())
        topic = self._bag.topics[self._images.topic]
        try:
            message = self._codec.decode(topic, self._bag.fetch(topic.name, place))
        except BadMessageError as error:
            raise UnreadableError(Path(name), f"cannot be read ({error})") from None
        return bytes(message.data)
