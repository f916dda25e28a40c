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
from touchline.sources.bags.messages import Bag, Place
from touchline.sources.bags.with_rosbags import BadMessageError, Codec
from touchline.sources.problems import ProblemKind, ProblemLog


class ImagePlaces(NamedTuple):
    """Where the images of a bag are, in the order of the rows of images.csv.

    topic: that they are on. places: int64 (N, 2), a `Place` each, (-1, -1) where there is none.
    """

    topic: str
    places: IntArray


def extract_own(bag: Bag, codec: Codec, folder: Path, problems: ProblemLog) -> ImagePlaces:
    """Write the files that a bag of Touchline holds, in one pass over it; memory grows by some 200 bytes an image.

    A row of an image whose own message is lost, at the end of a bag that was cut off, is left out.
    """
    topics = bag.topics
    kinds = {**dict.fromkeys((*WHOLE.values(), *TABLES.values()), STRING), IMAGES: COMPRESSED_IMAGE}
    wanted = [topic for topic, kind in kinds.items() if topic in topics and topics[topic].type == kind]
    names = {topic: name for name, topic in {**WHOLE, **TABLES}.items()}
    places: dict[int, Place] = {}  # by the time at which the image and its row were logged
    row_times = array("q")
    with NewFiles(folder) as files:
        for message in bag.messages(wanted):
            if message.topic == IMAGES:
                places[message.log_ns] = message.place
                continue
            try:
                text = codec.decode(topics[message.topic], message.data).data
            except BadMessageError as error:
                problems.add(ProblemKind.BAG, message.topic, f"a message cannot be read ({error}); it is left out")
                continue
            files.write(names[message.topic], text)
            if message.topic == IMAGE_ROWS:
                row_times.append(message.log_ns)
    found = [places.get(row_ns, (-1, -1)) for row_ns in row_times[1:]]  # without the header's
    return ImagePlaces(IMAGES, np.array(found, dtype=np.int64).reshape(-1, 2))


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
