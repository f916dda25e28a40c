"""A recording written as a bag: its files line by line, and beside them what other programs of ROS understand."""

import heapq
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from mcap.writer import CompressionType, Writer

from touchline.files.opened import UnreadableError, read_text
from touchline.geometry import Pose3
from touchline.sources.bags.camera_file import ros_camera
from touchline.sources.bags.layout import (
    COMPRESSED_IMAGE,
    EPOCH_KEY,
    IMAGE_ROWS,
    IMAGES,
    LATCHED,
    LATCHED_TOPICS,
    STRING,
    TABLES,
    WHOLE,
)
from touchline.sources.bags.standard import StandardMessages
from touchline.sources.bags.table_rows import MAX_STAMP_NS, Rows, read_rows
from touchline.sources.bags.with_rosbags import Codec, Rosbag2Writer
from touchline.sources.camera_poses import CAMERA_POSES
from touchline.sources.camera_poses import COLUMNS as CAMERA_POSE_COLUMNS
from touchline.sources.folder import Recording
from touchline.sources.tables import to_number
from touchline.sources.truth import TUM_COLUMNS, heading_of

_TF = "tf2_msgs/msg/TFMessage"
_MAX_BYTES = 8_000_000  # of a file that becomes one message
_CHUNK_BYTES = 256_000  # what a cut, or damage, can cost


class Outgoing(NamedTuple):
    """A message on its way into a bag."""

    log_ns: int
    topic: str
    kind: str
    data: bytes


class McapWriter:
    """A new MCAP file, as ROS 2 writes it, compressed with LZ4. Raises OSError where it is there already."""

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
            qos = {"offered_qos_profiles": LATCHED} if topic in LATCHED_TOPICS else {}
            self._channels[topic] = self._writer.register_channel(topic, "cdr", self._schemas[kind], qos)
        self._writer.add_message(self._channels[topic], log_ns, data, log_ns)

    def close(self) -> None:
        """Write the index."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.close()


BagWriter: TypeAlias = McapWriter | Rosbag2Writer


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
        self._standard = StandardMessages(codec)
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
                yield self._string(topic, self._start_ns, read_text(self._recording.file(name), _MAX_BYTES))
        yield from self._camera()
        streams = [
            self._images(path) if topic == IMAGE_ROWS else self._table(path, topic)
            for path, topic in self._tables.items()
        ]
        yield from heapq.merge(*streams, key=lambda message: message.log_ns)

    def _log_ns(self, stamp_ns: int) -> int:
        """The time at which a message is logged: no bag has one before 0."""
        return min(max(stamp_ns + self._epoch_ns, 0), MAX_STAMP_NS)

    def _string(self, topic: str, log_ns: int, text: str) -> Outgoing:
        return self._outgoing(log_ns, topic, STRING, self._codec.make(STRING, data=text))

    def _outgoing(self, log_ns: int, topic: str, kind: str, message: Any) -> Outgoing:
        return Outgoing(log_ns, topic, kind, self._codec.encode(kind, message))

    def _table(self, path: Path, topic: str) -> Iterator[Outgoing]:
        last = self._start_ns
        names: Sequence[str] = TUM_COLUMNS
        for rows in read_rows(path):
            names = rows.cells if rows.header else names
            last = last if rows.header else max(last, self._log_ns(rows.stamp_ns))
            standard = None if rows.header else self._beside(path.name, names, rows)
            yield self._string(topic, last, rows.text)
            if standard is not None:
                yield self._outgoing(last, *standard)

    def _beside(self, name: str, columns: Sequence[str], rows: Rows) -> tuple[str, str, Any] | None:
        """Topic, type and message of what ROS has a message for; None for a row that cannot be used."""
        cells = {column: to_number(cell) for column, cell in zip(columns, rows.cells, strict=False)}
        stamp_ns, make = rows.stamp_ns + self._epoch_ns, self._standard

        def numbers(*names: str) -> list[float]:
            found = (cells.get(name) for name in names)
            return [math.nan if value is None else value for value in found]

        if name == "odometry.csv" and np.isfinite(pose := numbers("x", "y", "theta")).all():
            return "/odom", "nav_msgs/msg/Odometry", make.odometry(stamp_ns, *pose)
        if name == "imu.csv":
            imu = make.imu(stamp_ns, numbers("roll", "pitch", "yaw"), numbers("gx", "gy", "gz"))
            return "/imu/data", "sensor_msgs/msg/Imu", imu
        if name == "camera_pose.csv" and np.isfinite(row := numbers(*CAMERA_POSE_COLUMNS)).all():
            body = Pose3.from_roll_pitch_yaw(row[3], row[4], row[5], row[:3])
            return "/tf", _TF, make.camera_at(stamp_ns, body)
        if name == "ground_truth.tum" and np.isfinite(row := numbers(*TUM_COLUMNS[1:])).all():
            pose = make.pose(stamp_ns, row[0], row[1], heading_of(*row[3:]))
            return "/ground_truth/pose", "geometry_msgs/msg/PoseStamped", pose
        return None

    def _camera(self) -> Iterator[Outgoing]:
        """What ROS knows of a perspective camera."""
        camera = ros_camera(self._recording)
        if camera is None:
            return  # one that is none is copied as it is
        info = self._standard.camera_info(self._start_ns, camera)
        yield self._outgoing(self._start_ns, "/camera/camera_info", "sensor_msgs/msg/CameraInfo", info)
        if not (self._recording.folder / CAMERA_POSES).exists():
            placed = self._standard.camera_at(self._start_ns, camera.base_from_camera)
            yield self._outgoing(self._start_ns, "/tf_static", _TF, placed)

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
        message = self._standard.compressed(rows.stamp_ns + self._epoch_ns, data)
        yield self._outgoing(log_ns, IMAGES, COMPRESSED_IMAGE, message)


def epoch_ns(recording: Recording) -> int:
    """What the clock of the bag, from which a recording came, showed at t = 0; 0 of other recordings."""
    value = recording.sequence.get(EPOCH_KEY, 0)
    return value if isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= MAX_STAMP_NS else 0
