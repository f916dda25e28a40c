"""The tables of a bag in a folder of their own; its images stay where they are."""

from array import array
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from typing_extensions import Self

from touchline.geometry import IntArray
from touchline.sources.bags.layout import COMPRESSED_IMAGE, IMAGE_ROWS, IMAGES, STRING, TABLES, WHOLE
from touchline.sources.bags.messages import Bag
from touchline.sources.bags.with_rosbags import BadMessageError, Codec
from touchline.sources.problems import ProblemKind, ProblemLog


class ImagePlaces(NamedTuple):
    """Where the images of a bag are, in the order of the rows of images.csv.

    topic: that they are on. places: int64 (N, 2), a `Place` each, (-1, -1) where there is none.
    """

    topic: str
    places: IntArray


def extract_own(bag: Bag, codec: Codec, folder: Path, problems: ProblemLog) -> ImagePlaces:
    """Write the files that a bag of Touchline holds, in one pass over it, in constant memory but for 32 bytes an image.

    A row of an image whose own message is lost, at the end of a bag that was cut off, is left out.
    """
    topics = bag.topics
    kinds = {**dict.fromkeys((*WHOLE.values(), *TABLES.values()), STRING), IMAGES: COMPRESSED_IMAGE}
    wanted = [topic for topic, kind in kinds.items() if topic in topics and topics[topic].type == kind]
    names = {topic: name for name, topic in {**WHOLE, **TABLES}.items()}
    places, image_times, row_times = array("q"), array("q"), array("q")
    header_seen = False
    with NewFiles(folder) as files:
        for message in bag.messages(wanted):
            if message.topic == IMAGES:
                image_times.append(message.log_ns)
                places.extend(message.place)
                continue
            try:
                text = codec.decode(topics[message.topic], message.data).data
            except BadMessageError as error:
                problems.add(ProblemKind.BAG, message.topic, f"a message cannot be read ({error}); it is left out")
                continue
            files.write(names[message.topic], text)
            if message.topic == IMAGE_ROWS:
                if header_seen:
                    row_times.append(message.log_ns)
                header_seen = True
    return ImagePlaces(IMAGES, _joined(np.array(row_times), np.array(image_times), np.array(places).reshape(-1, 2)))


def _joined(row_times: IntArray, image_times: IntArray, places: IntArray) -> IntArray:
    """(N, 2) the place of the image that was logged at the time of each row."""
    found = np.full((len(row_times), 2), -1, dtype=np.int64)
    order = np.argsort(image_times, kind="stable")
    after = np.searchsorted(image_times[order], row_times).clip(max=max(len(order) - 1, 0))
    if len(order):
        same = image_times[order][after] == row_times
        found[same] = places[order][after[same]]
    return found


class NewFiles:
    """New files of a folder, each opened when something is written into it first."""

    def __init__(self, folder: Path, headers: Mapping[str, str] | None = None) -> None:
        """headers: first lines, by the name of the file."""
        self._folder, self._headers = folder, headers or {}
        self._open: dict[str, BinaryIO] = {}
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def write(self, name: str, text: str) -> None:
        """Add a text to a file."""
        if name not in self._open:
            self._open[name] = self._stack.enter_context((self._folder / name).open("xb"))
            if name in self._headers:
                text = f"{self._headers[name]}\n{text}"
        self._open[name].write(text.encode())
