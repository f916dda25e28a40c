"""A bag opened as a recording, whose images are fetched one by one, as they are stored."""

from pathlib import Path
from typing import Any

import cv2

from touchline.errors import InputError
from touchline.files.opened import UnreadableError
from touchline.sources.bags.extraction import ImagePlaces, extract_own
from touchline.sources.bags.foreign import Foreign
from touchline.sources.bags.kinds import BagFiles, BagKind
from touchline.sources.bags.layout import SEQUENCE_TOPIC
from touchline.sources.bags.mcap_file import McapBag
from touchline.sources.bags.messages import Bag, Place
from touchline.sources.bags.pixels import demosaiced, image_pixels, is_bayer
from touchline.sources.bags.roles import BagOptions
from touchline.sources.bags.with_rosbags import BadMessageError, Codec, RosbagsBag
from touchline.sources.decoding import Decoded, decode_bytes
from touchline.sources.folder import Recording
from touchline.sources.new_description import TemporaryFolder
from touchline.sources.problems import ProblemKind, ProblemLog


def open_bag(path: Path, files: BagFiles, options: BagOptions) -> Recording:
    """The recording in a bag. Its tables are copied into a temporary folder, which goes with it; its images stay.
    options: what a bag that Touchline did not write leaves open.

    Raises InputError if it cannot be read as a recording.
    """
    problems = ProblemLog()
    bag = _open(files, problems)
    if not bag.topics:
        raise InputError(f"{path}: holds no message that can be read{_said(problems)}")
    codec = Codec()
    folder = TemporaryFolder()
    if SEQUENCE_TOPIC not in bag.topics:
        places = Foreign(bag, codec, options, path, problems).extract(folder.path)
    elif options.given():
        raise InputError(f"{path}: is a recording that Touchline wrote: its topics, field and camera are known")
    else:
        places = extract_own(bag, codec, folder.path, problems)
    images = BagImages(bag, codec, places)
    try:
        recording = Recording(folder.path, path=path, images=images, problems=problems)
    except InputError as error:  # the user knows the bag, not the folder
        raise InputError(f"{str(error).replace(str(folder.path), str(path))}{_said(problems)}") from None
    recording.options, recording.kept = options, folder
    return recording


def _open(files: BagFiles, problems: ProblemLog) -> Bag:
    if files.kind is BagKind.MCAP:
        return McapBag(files.paths, problems)
    return RosbagsBag(files.paths, files.kind is BagKind.ROS1, problems)


def _said(problems: ProblemLog) -> str:
    return f" ({problems[0].message})" if problems.total else ""


class BagImages:
    """An image store (see `ImageStore`) of the images of one topic."""

    def __init__(self, bag: Bag, codec: Codec, images: ImagePlaces) -> None:
        self._bag = bag
        self._codec = codec
        self._images = images

    def decode(self, row: int, name: str, expected: tuple[int, int] | None) -> Decoded:
        """As `ImageStore` says."""
        try:
            message = self._message(row, name)
        except UnreadableError as error:
            return Decoded(None, ProblemKind.MISSING_IMAGE, error.what)
        if hasattr(message, "encoding"):
            pixels = image_pixels(message)
            return Decoded(None, ProblemKind.BROKEN_IMAGE, pixels) if isinstance(pixels, str) else Decoded(pixels)
        decoded = decode_bytes(bytes(message.data), expected)
        if decoded.pixels is None or not is_bayer(message.format):
            return decoded
        return Decoded(demosaiced(decoded.pixels, message.format))

    def file_bytes(self, row: int, name: str) -> bytes:
        """As `ImageStore` says: a compressed image as it is, pixels as a PNG file."""
        message = self._message(row, name)
        if not hasattr(message, "encoding") and not is_bayer(message.format):
            return bytes(message.data)
        decoded = self.decode(row, name, None)
        if decoded.pixels is None:
            raise UnreadableError(Path(name), decoded.what)
        return cv2.imencode(".png", decoded.pixels, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()

    def _message(self, row: int, name: str) -> Any:
        if not 0 <= row < len(self._images.places) or self._images.places[row, 0] < 0:
            raise UnreadableError(Path(name), "is not in the bag", missing=True)
        place = Place(*self._images.places[row].tolist())
        topic = self._bag.topics[self._images.topic]
        try:
            return self._codec.decode(topic, self._bag.fetch(topic.name, place))
        except BadMessageError as error:
            raise UnreadableError(Path(name), f"cannot be read ({error})") from None
