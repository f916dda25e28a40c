"""A recording written as a bag: its files line by line, and beside them what other programs of ROS understand."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from touchline.opened_files import UnreadableError, read_text
from touchline.sources.bags.layout import (
    COMPRESSED_IMAGE,
    EPOCH_KEY,
    IMAGE_ROWS,
    IMAGES,
    STRING,
    TABLES,
    WHOLE,
)
from touchline.sources.bags.table_rows import LATEST_NS, Rows, read_rows
from touchline.sources.bags.with_rosbags import Codec
from touchline.sources.folder import Recording

_MOST_BYTES = 8_000_000  # of a file that becomes one message
_OPTICAL_FRAME = "camera_optical"


class Outgoing(NamedTuple):
    """A message on its way into a bag."""

    log_ns: int
    topic: str
    kind: str
    data: bytes


class BagWriter(Protocol):
    """A new bag."""

    def write(self, topic: str, kind: str, log_ns: int, data: bytes) -> None:
        """Add a message."""
        ...

    def close(self) -> None:
        """Write what comes last."""
        ...


def write_recording(
    recording: Recording, writer: BagWriter, codec: Codec, on_image: Callable[[], None] | None = None
) -> None:
    """Write all of a recording, and close the bag. on_image: called after every image.

    Images are copied as they are stored, not decoded.
    """
    for message in _Outgoing(recording, codec).messages():
        writer.write(message.topic, message.kind, message.log_ns, message.data)
        if message.topic == IMAGE_ROWS and on_image is not None:
            on_image()
    writer.close()


class _Outgoing:
    """The messages of a recording, in the order of time."""

    def __init__(self, recording: Recording, codec: Codec) -> None:
        self._recording = recording
        self._codec = codec
        self._epoch_ns = epoch_ns(recording)
        folder = recording.folder
        self._tables = {recording.file(name): topic for name, topic in TABLES.items() if (folder / name).exists()}
        first = [rows.stamp_ns for path in self._tables for rows in itertools.islice(read_rows(path), 2)]
        self._start_ns = self._log_ns(min(first, default=0))

    def messages(self) -> Iterator[Outgoing]:
        """Files first, then the rows of all tables, merged."""
        for name, topic in WHOLE.items():
            path = self._recording.folder / name
            if path.exists():
                yield self._string(topic, self._start_ns, read_text(self._recording.file(name), _MOST_BYTES))
        streams = [
            self._images(path) if topic == IMAGE_ROWS else self._table(path, topic)
            for path, topic in self._tables.items()
        ]
        yield from heapq.merge(*streams, key=lambda message: message.log_ns)

    def _log_ns(self, stamp_ns: int) -> int:
        """The time at which a message is logged: no bag has one before 0."""
        return min(max(stamp_ns + self._epoch_ns, 0), LATEST_NS)

    def _string(self, topic: str, log_ns: int, text: str) -> Outgoing:
        return Outgoing(log_ns, topic, STRING, self._codec.encode(STRING, self._codec.make(STRING, data=text)))

    def _table(self, path: Path, topic: str) -> Iterator[Outgoing]:
        last = self._start_ns
        for rows in read_rows(path):
            last = last if rows.header else max(last, self._log_ns(rows.stamp_ns))
            yield self._string(topic, last, rows.text)

    def _images(self, path: Path) -> Iterator[Outgoing]:
        """Every image, and then its row, both logged at a time that no other image has."""
        last, row, position = self._start_ns, 0, 1
        for rows in read_rows(path):
            if rows.header:
                position = rows.cells.index("file")
                yield self._string(IMAGE_ROWS, self._start_ns, rows.text)
                continue
            for line in rows.text.splitlines(keepends=True):
                last = max(last + 1, self._log_ns(rows.stamp_ns))
                cells = line.split(",")
                name = cells[position].strip().strip('"') if position < len(cells) else ""
                yield from self._image(row, name, rows, last)
                yield self._string(IMAGE_ROWS, last, line)
                row += 1

    def _image(self, row: int, name: str, rows: Rows, log_ns: int) -> Iterator[Outgoing]:
        try:
            data = self._recording.image_store.file_bytes(row, name)
        except UnreadableError:
            return
        ending = Path(name).suffix.lower().lstrip(".")
        message = self._codec.make(
            COMPRESSED_IMAGE,
            header=self._header(rows.stamp_ns, _OPTICAL_FRAME),
            format={"jpg": "jpeg"}.get(ending, ending),
            data=np.frombuffer(data, dtype=np.uint8),
        )
        yield Outgoing(log_ns, IMAGES, COMPRESSED_IMAGE, self._codec.encode(COMPRESSED_IMAGE, message))

    def _header(self, stamp_ns: int, frame: str) -> object:
        seconds, rest = divmod(stamp_ns + self._epoch_ns, 1_000_000_000)
        stamp = self._codec.make(
            "builtin_interfaces/msg/Time", sec=min(max(seconds, -(2**31)), 2**31 - 1), nanosec=rest
        )
        return self._codec.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def epoch_ns(recording: Recording) -> int:
    """What the clock of the bag, from which a recording came, showed at t = 0; 0 of other recordings."""
    value = recording.sequence.get(EPOCH_KEY, 0)
    return value if isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= LATEST_NS else 0
