"""MCAP files, read record by record up to where they are damaged (https://mcap.dev/spec).

The records are walked through here, not by the mcap package: its readers give up at the end of a file that was cut off,
or give half of the last chunk as if it were whole, and none tells where a message stands.
"""

import struct
import weakref
import zlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import BinaryIO, NamedTuple

import lz4.frame
import zstandard

from touchline.files.opened import UnreadableError, open_bytes
from touchline.messages import counted
from touchline.sources.bags.messages import Definition, Message, Place, Topic
from touchline.sources.problems import ProblemKind, ProblemLog

MAGIC = b"\x89MCAP0\r\n"
MAX_RECORD_BYTES = 512_000_000  # of a chunk, compressed or not: usual ones have some megabytes
_MAX_RATIO, _SMALL_BYTES = 1000, 8_000_000  # unpacked to packed, of a chunk that unpacks to more than this
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END, _STATISTICS = 3, 4, 5, 6, 15, 11
_RECORD, _MESSAGE_HEAD, _CHUNK_HEAD = struct.Struct("<BQ"), struct.Struct("<HIQQ"), struct.Struct("<QQQI")
_LANGUAGES = {"ros2msg": "msg", "ros1msg": "msg", "ros2idl": "idl"}
_FILE_SHIFT = 48  # a place names the file in the bits above


class _DamageError(Exception):
    """What is wrong with a part of the file, and whether more can be read behind it."""


class _Channel(NamedTuple):
    schema: int
    topic: str
    encoding: str


class _Directory:
    """Schemas and channels of one file, as far as it has been read."""

    def __init__(self) -> None:
        self.schemas: dict[int, tuple[str, str, str]] = {}
        self.channels: dict[int, _Channel] = {}
        self.counts: dict[int, int] = {}

    def add(self, opcode: int, body: bytes) -> None:
        """Take a record in, if it is a schema or a channel."""
        if opcode == _SCHEMA:
            number, at = struct.unpack_from("<H", body)[0], 2
            name, at = _text(body, at)
            encoding, at = _text(body, at)
            length = struct.unpack_from("<I", body, at)[0]
            text = body[at + 4 : at + 4 + length].decode("utf-8", errors="replace")
            self.schemas[number] = (name, encoding, text)
        elif opcode == _CHANNEL:
            number, schema = struct.unpack_from("<HH", body)
            topic, at = _text(body, 4)
            self.channels[number] = _Channel(schema, topic, _text(body, at)[0])

    def topics(self) -> dict[str, Topic]:
        """Those in one of the encodings of ROS."""
        found: dict[str, Topic] = {}
        for number, channel in self.channels.items():
            name, language, text = self.schemas.get(channel.schema, ("", "", ""))
            if channel.encoding not in ("cdr", "ros1"):
                continue
            definition = Definition(_LANGUAGES[language], text) if language in _LANGUAGES and text else None
            before = found.get(channel.topic)
            count = self.counts.get(number, 0) + (before.messages if before else 0)
            found[channel.topic] = Topic(channel.topic, ros2_type(name), channel.encoding, definition, count)
        return found


class McapBag:
    """One or several MCAP files as one bag. Raises UnreadableError for a file that is none."""

    def __init__(self, paths: Sequence[Path], problems: ProblemLog) -> None:
        self._paths = paths
        self._problems = problems
        self._files: list[BinaryIO] = []
        for path in paths:
            self._files.append(open_bytes(path))
            weakref.finalize(self, self._files[-1].close)
            if self._files[-1].read(len(MAGIC)) != MAGIC:
                raise UnreadableError(path, "is not an MCAP file")
        self._told: set[tuple[int, int]] = set()
        self._chunk: tuple[int, bytes] = (-1, b"")

    @cached_property
    def topics(self) -> Mapping[str, Topic]:
        """By name, of the files' summaries; of what the files hold where there is none."""
        found: dict[str, Topic] = {}
        for number, file in enumerate(self._files):
            directory = _summary(file) or self._scanned(number)
            for name, topic in directory.topics().items():
                before = found[name].messages if name in found else 0
                found[name] = topic._replace(messages=topic.messages + before)
        return found

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Those of some topics, in the order of the file."""
        for number in range(len(self._files)):
            yield from self._messages_of(number, topics, _Directory())

    def fetch(self, topic: str, place: Place) -> bytes | memoryview:
        """The data of one message. Raises UnreadableError where the file has changed since."""
        number, offset = place.first >> _FILE_SHIFT, place.first & ((1 << _FILE_SHIFT) - 1)
        try:
            if place.second < 0:
                return memoryview(self._body(number, offset))[_MESSAGE_HEAD.size :]
            if self._chunk[0] != place.first:
                self._chunk = (place.first, _unpacked(self._body(number, offset))[0])
            data = self._chunk[1]
            _, length = _RECORD.unpack_from(data, place.second)
            start = place.second + _RECORD.size
            return memoryview(data)[start + _MESSAGE_HEAD.size : start + length]
        except (_DamageError, struct.error) as error:
            raise UnreadableError(self._paths[number], f"has changed while it was read ({error})") from None

    def _body(self, number: int, offset: int) -> bytes:
        """The record at an offset, as much of it as there is."""
        file = self._files[number]
        file.seek(offset)
        _, length = _RECORD.unpack(file.read(_RECORD.size))
        return file.read(min(length, MAX_RECORD_BYTES))

    def _scanned(self, number: int) -> _Directory:
        directory = _Directory()
        names: set[str] = set()
        for _ in self._messages_of(number, names, directory):
            pass
        return directory

    def _messages_of(self, number: int, topics: Collection[str], directory: _Directory) -> Iterator[Message]:
        file, path = self._files[number], self._paths[number]
        size = path.stat().st_size
        offset, base, count = len(MAGIC), number << _FILE_SHIFT, 0
        while True:
            file.seek(offset)
            head = file.read(_RECORD.size)
            opcode, length = _RECORD.unpack(head) if len(head) == _RECORD.size else (0, 0)
            if opcode in (_DATA_END, 0):
                break
            missing = offset + _RECORD.size + length - size
            if opcode == _CHUNK:
                records = self._chunk_records(number, offset)
            elif missing > 0 or opcode > 0x7F:
                break
            else:
                body = file.read(length) if opcode in (_SCHEMA, _CHANNEL, _MESSAGE) else b""
                records = iter([(-1, opcode, memoryview(body))])
            for at, inner, record in records:
                if inner != _MESSAGE:
                    directory.add(inner, bytes(record))
                    continue
                channel_number, _, log_ns, _ = _MESSAGE_HEAD.unpack_from(record)
                count += 1
                directory.counts[channel_number] = directory.counts.get(channel_number, 0) + 1
                channel = directory.channels.get(channel_number)
                if channel is not None and channel.topic in topics:
                    yield Message(channel.topic, log_ns, record[_MESSAGE_HEAD.size :], Place(base + offset, at))
            if missing > 0:
                break
            offset += _RECORD.size + length
        if opcode != _DATA_END:
            self._tell(number, offset, f"ends early, at byte {size}: {counted(count, 'message')} before it can be read")

    def _chunk_records(self, number: int, offset: int) -> Iterator[tuple[int, int, memoryview]]:
        """(offset within, opcode, body) of the records of a chunk."""
        try:
            data, damage = _unpacked(self._body(number, offset))
        except _DamageError as error:
            self._tell(number, offset, f"a part at byte {offset} is left out: {error}")
            return
        if damage:
            self._tell(number, offset, f"a part at byte {offset} is damaged: {damage}; what is whole of it is read")
        view, at, end = memoryview(data), 0, len(data)
        while at + _RECORD.size <= end:
            opcode, length = _RECORD.unpack_from(data, at)
            start = at + _RECORD.size
            if not opcode or start + length > end:  # 0 is no record's
                break
            if opcode != _MESSAGE or length >= _MESSAGE_HEAD.size:
                yield at, opcode, view[start : start + length]
            at = start + length

    def _tell(self, number: int, offset: int, what: str) -> None:
        """Report damage once, however often the file is read."""
        if (number, offset) not in self._told:
            self._told.add((number, offset))
            self._problems.add(ProblemKind.BAG, self._paths[number].name, what)


def ros2_type(name: str) -> str:
    """sensor_msgs/Image, as ROS 1 writes it, as sensor_msgs/msg/Image."""
    parts = name.split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else name


def _text(body: bytes, at: int) -> tuple[str, int]:
    """A string with its length before it, and where it ends."""
    length = struct.unpack_from("<I", body, at)[0]
    end = at + 4 + length
    return body[at + 4 : end].decode("utf-8", errors="replace"), end


def _unpacked(body: bytes) -> tuple[bytes, str]:
    """The records of a chunk, and what is wrong with them: as many as can be had where it was cut off.

    Raises _DamageError if there are none.
    """
    if len(body) < _CHUNK_HEAD.size + 12:
        raise _DamageError("it was cut off")
    _, _, full_size, checksum = _CHUNK_HEAD.unpack_from(body)
    compression, at = _text(body, _CHUNK_HEAD.size)
    if full_size > min(MAX_RECORD_BYTES, max(_SMALL_BYTES, _MAX_RATIO * len(body))):
        raise _DamageError(f"it would hold {full_size / 1e6:.0f} MB, packed in {len(body) / 1e6:.3g} MB")
    if at + 8 > len(body):
        raise _DamageError("the name of its compression has no end")
    packed_size = struct.unpack_from("<Q", body, at)[0]
    packed = memoryview(body)[at + 8 : at + 8 + packed_size]
    try:
        data = _decompressed(compression, packed, full_size)
    except (RuntimeError, zstandard.ZstdError) as error:
        raise _DamageError(f"it cannot be decompressed ({error})") from None
    if len(data) < full_size:
        return data, "" if len(packed) < packed_size else "it ends early"  # of a file that was cut off more is said
    if checksum and zlib.crc32(data) != checksum:
        raise _DamageError("its checksum is wrong")
    return data, ""


def _decompressed(compression: str, packed: memoryview, full_size: int) -> bytes:
    """At most `full_size` bytes; fewer where the data were cut off."""
    if not compression:
        return bytes(packed[:full_size])
    if compression == "lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, full_size))
    if compression == "zstd":
        return zstandard.ZstdDecompressor(max_window_size=MAX_RECORD_BYTES).stream_reader(packed).read(full_size)
    raise _DamageError(f"its compression '{compression:.20}' is not known")


def _summary(file: BinaryIO) -> _Directory | None:
    """What the end of the file says of its channels; None where it says nothing."""
    from mcap.exceptions import McapError
    from mcap.reader import SeekingReader

    file.seek(0)
    try:
        summary = SeekingReader(file, record_size_limit=MAX_RECORD_BYTES).get_summary()
    except (McapError, struct.error, ValueError, OSError, KeyError, AssertionError):
        return None
    if summary is None or summary.statistics is None or not summary.channels:
        return None
    directory = _Directory()
    directory.counts = dict(summary.statistics.channel_message_counts)
    for schema in summary.schemas.values():
        text = schema.data.decode("utf-8", errors="replace")
        directory.schemas[schema.id] = (schema.name, schema.encoding, text)
    for channel in summary.channels.values():
        directory.channels[channel.id] = _Channel(channel.schema_id, channel.topic, channel.message_encoding)
    return directory
