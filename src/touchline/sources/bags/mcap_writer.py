"""A new MCAP file, as ROS 2 writes it."""

from __future__ import annotations

from pathlib import Path

from mcap.writer import CompressionType, Writer

from touchline.sources.bags.layout import LATCHED_TOPICS
from touchline.sources.bags.with_rosbags import Codec

_CHUNK_BYTES = 256_000  # what a cut, or damage, can cost
_LATCHED = (
    "- history: 1\n  depth: 1\n  reliability: 1\n  durability: 1\n"
    "  deadline: {sec: 0, nsec: 0}\n  lifespan: {sec: 0, nsec: 0}\n  liveliness: 0\n"
    "  liveliness_lease_duration: {sec: 0, nsec: 0}\n  avoid_ros_namespace_conventions: false\n"
)


class McapWriter:
    """Messages in chunks, compressed with LZ4. Raises OSError where the file cannot be made, or is there already."""

    def __init__(self, path: Path, codec: Codec) -> None:
        self._codec = codec
        self._file = path.open("xb")
        self._writer = Writer(self._file, chunk_size=_CHUNK_BYTES, compression=CompressionType.LZ4)
        self._writer.start(profile="ros2", library="touchline")
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}

    def write(self, topic: str, kind: str, log_ns: int, data: bytes) -> None:
        """Add a message."""
        if topic not in self._channels:
            if kind not in self._schemas:
                text = self._codec.definition(kind).encode()
                self._schemas[kind] = self._writer.register_schema(kind, "ros2msg", text)
            qos = {"offered_qos_profiles": _LATCHED} if topic in LATCHED_TOPICS else {}
            self._channels[topic] = self._writer.register_channel(topic, "cdr", self._schemas[kind], qos)
        self._writer.add_message(self._channels[topic], log_ns, data, log_ns)

    def close(self) -> None:
        """Write the index."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.close()
