"""MCAP files, read by the mcap package chunk by chunk up to where they are damaged (https://mcap.dev/spec)."""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

from mcap import records
from mcap.reader import SeekingReader
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.summary import Summary
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat

from touchline.files.opened import open_bytes
from touchline.messages import counted
from touchline.sources.bags.messages import Bag, Message, Place, Topic
from touchline.sources.problems import ProblemLog

_MAX_RECORD_BYTES = 512_000_000  # of a chunk, compressed or not: usual chunks have some megabytes
_FORMATS = {
    "ros2msg": MessageDefinitionFormat.MSG,
    "ros1msg": MessageDefinitionFormat.MSG,
    "ros2idl": MessageDefinitionFormat.IDL,
}
_FILE_STEP = 1 << 48  # between the places of two files


class McapBag(Bag):
    """One or several MCAP files as one bag. A place is the offset of a chunk and the number of a record in it."""

    def __init__(self, paths: Sequence[Path], problems: ProblemLog) -> None:
        super().__init__(problems)
        self._paths = paths
        self._summaries = [_summary(path) for path in paths]

    @cached_property
    def topics(self) -> Mapping[str, Topic]:
        """By name, from the files' summaries; from what a file holds where it has none."""
        found: dict[str, Topic] = {}
        for number, summary in enumerate(self._summaries):
            if summary.statistics is None:
                counts: Mapping[int, int] = Counter(message.channel_id for _, message in self._stored(number))
            else:
                counts = summary.statistics.channel_message_counts
            for channel in summary.channels.values():
                schema = summary.schemas.get(channel.schema_id)
                if schema is None or channel.message_encoding not in ("cdr", "ros1"):
                    continue
                text = schema.data.decode(errors="replace")
                definition = MessageDefinition(_FORMATS[schema.encoding], text) if schema.encoding in _FORMATS else None
                before = found[channel.topic].messages if channel.topic in found else 0
                found[channel.topic] = Topic(
                    channel.topic,
                    _ros2_type(schema.name),
                    channel.message_encoding,
                    definition,
                    before + counts.get(channel.id, 0),
                )
        return found

    def messages(self, topics: Collection[str], start: Place | None = None) -> Iterator[Message]:
        """The messages of some topics, in the order of the file."""
        first, offset = divmod(start.first, _FILE_STEP) if start else (0, 0)
        for number in range(first, len(self._paths)):
            channels = self._summaries[number].channels
            for place, message in self._stored(number, offset if number == first else 0):
                channel = channels.get(message.channel_id)
                if channel is not None and channel.topic in topics:
                    yield Message(channel.topic, message.log_time, message.data, place)

    def _stored(self, number: int, offset: int = 0) -> Iterator[tuple[Place, records.Message]]:
        """All messages of a file from an offset on. Schemas and channels go to the summary."""
        path, summary, count = self._paths[number], self._summaries[number], 0
        with open_bytes(path) as file:
            file.seek(offset)
            reader = StreamReader(file, offset > 0, emit_chunks=True, record_size_limit=_MAX_RECORD_BYTES)
            try:
                for record in reader.records:
                    if isinstance(record, records.DataEnd):
                        return
                    packed = isinstance(record, records.Chunk)
                    for at, inner in enumerate(self._unpacked(number, offset, record) if packed else [record]):
                        if isinstance(inner, records.Message):
                            count += 1
                            yield Place(number * _FILE_STEP + offset, at), inner
                        elif isinstance(inner, records.Schema):
                            summary.schemas[inner.id] = inner
                        elif isinstance(inner, records.Channel):
                            summary.channels[inner.id] = inner
                    offset = file.tell()
            except Exception:  # whatever cut or damaged bytes raise within mcap
                size = path.stat().st_size
                what = f"ends early, at byte {size}: {counted(count, 'message')} before it can be read"
                self._report((number, offset), path.name, what)

    def _unpacked(self, number: int, offset: int, chunk: Any) -> list[records.McapRecord]:
        """The records of a chunk; none of a damaged one."""
        try:
            if chunk.uncompressed_size > _MAX_RECORD_BYTES:
                raise ValueError(f"it would hold {chunk.uncompressed_size / 1e6:.0f} MB")
            return breakup_chunk(chunk, validate_crc=True)
        except Exception as error:  # of mcap, and of what it decompresses with
            what = f"a part at byte {offset} is left out: it cannot be read ({type(error).__name__}: {error})"
            self._report((number, offset), self._paths[number].name, what)
            return []


def _ros2_type(name: str) -> str:
    """sensor_msgs/Image, as ROS 1 writes it, as sensor_msgs/msg/Image."""
    return name.replace("/", "/msg/") if name.count("/") == 1 else name


def _summary(path: Path) -> Summary:
    """What the end of a file says of its channels; nothing where the file has no end."""
    with open_bytes(path) as file:
        try:
            summary = SeekingReader(file, record_size_limit=_MAX_RECORD_BYTES).get_summary()
        except Exception:  # whatever cut or damaged bytes raise within mcap
            return Summary()
    return summary if summary is not None and summary.statistics and summary.channels else Summary()
