"""The one place that knows the rosbags package (0.11): its readers, its writer and its message types."""

import re
import sqlite3
import weakref
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import cache, cached_property, lru_cache
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from rosbags.interfaces import (
    Connection,
    MessageDefinitionFormat,
    Nodetype,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag1 import ReaderError as Ros1Error
from rosbags.rosbag2 import Reader as Ros2Reader
from rosbags.rosbag2 import ReaderError as Ros2Error
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from touchline.files.opened import UnreadableError, open_bytes
from touchline.sources.bags.layout import LATCHED_TOPICS
from touchline.sources.bags.messages import Definition, Message, Place, Topic
from touchline.sources.problems import ProblemKind, ProblemLog

_CONFIDENCE = "soccer_vision_attribute_msgs/Confidence confidence\n"
_OBJECT = "string label\n{color}float64 confidence\nint64 xmin\nint64 ymin\nint64 xmax\nint64 ymax\n{pixel}"
_PLACES = "float32[] received_pos\nfloat32[] position\nfloat32[] position_projection\n"
_SEEN = "std_msgs/Header header\nvision_interface/DetectedObject[] detected_objects\n"

DEFINITIONS = {
    "nav2_msgs/msg/Particle": "geometry_msgs/Pose pose\nfloat64 weight\n",
    "nav2_msgs/msg/ParticleCloud": "std_msgs/Header header\nnav2_msgs/Particle[] particles\n",
    "vision_interface/msg/DetectedObject": _OBJECT.format(color="string color\n", pixel="float32[] target_uv\n")
    + _PLACES
    + "float32[] position_cam\nint32 position_confidence\n",
    "vision_interface/msg/Detections": _SEEN + "float32[] radar_x\nfloat32[] radar_y\nfloat32[] corner_pos\n",
    "vision_interface/msg/LineSegments": "std_msgs/Header header\nfloat32[] coordinates\nfloat32[] coordinates_uv\n",
    "booster_interface/msg/Odometer": "float32 x\nfloat32 y\nfloat32 theta\n",
    "booster_interface/msg/ImuState": "float32[3] rpy\nfloat32[3] gyro\nfloat32[3] acc\n",
    "booster_interface/msg/MotorState": "int8 mode\nfloat32 q\nfloat32 dq\nfloat32 ddq\nfloat32 tau_est\n"
    "int8 temperature\nuint32 lost\nuint32[2] reserve\n",
    "booster_interface/msg/LowState": "booster_interface/ImuState imu_state\n"
    "booster_interface/MotorState[] motor_state_parallel\nbooster_interface/MotorState[] motor_state_serial\n",
    "soccer_vision_attribute_msgs/msg/Confidence": "float32 CONFIDENCE_UNKNOWN=-1\nfloat32 confidence -1\n",
    "soccer_vision_attribute_msgs/msg/Goalpost": "uint8 side\nuint8 team\n",
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    "vision_msgs/msg/Point2D": "float64 x\nfloat64 y\n",
    "vision_msgs/msg/Pose2D": "vision_msgs/Point2D position\nfloat64 theta\n",
    "vision_msgs/msg/BoundingBox2D": "vision_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y\n",
    "soccer_vision_3d_msgs/msg/MarkingEllipse": "float64 diameter\ngeometry_msgs/Pose center\n" + _CONFIDENCE,
    "soccer_vision_3d_msgs/msg/MarkingIntersection": "geometry_msgs/Pose center\nint32 num_rays\n"
    "geometry_msgs/Vector3[] rays\n" + _CONFIDENCE,
    "soccer_vision_3d_msgs/msg/MarkingSegment": "geometry_msgs/Point start\ngeometry_msgs/Point end\n" + _CONFIDENCE,
    "soccer_vision_3d_msgs/msg/MarkingArray": "std_msgs/Header header\n"
    "soccer_vision_3d_msgs/MarkingEllipse[] ellipses\nsoccer_vision_3d_msgs/MarkingIntersection[] intersections\n"
    "soccer_vision_3d_msgs/MarkingSegment[] segments\n",
    "soccer_vision_3d_msgs/msg/Goalpost": "vision_msgs/BoundingBox3D bb\n"
    "soccer_vision_attribute_msgs/Goalpost attributes\n" + _CONFIDENCE,
    "soccer_vision_3d_msgs/msg/GoalpostArray": "std_msgs/Header header\nsoccer_vision_3d_msgs/Goalpost[] posts\n",
    "soccer_vision_2d_msgs/msg/MarkingEllipse": "vision_msgs/BoundingBox2D bb\nvision_msgs/Point2D center\n"
    + _CONFIDENCE,
    "soccer_vision_2d_msgs/msg/MarkingIntersection": "vision_msgs/Point2D center\nint32 num_rays\n"
    "float64[] heading_rays\n" + _CONFIDENCE,
    "soccer_vision_2d_msgs/msg/MarkingSegment": "vision_msgs/Point2D start\nvision_msgs/Point2D end\n" + _CONFIDENCE,
    "soccer_vision_2d_msgs/msg/MarkingArray": "std_msgs/Header header\n"
    "soccer_vision_2d_msgs/MarkingEllipse[] ellipses\nsoccer_vision_2d_msgs/MarkingIntersection[] intersections\n"
    "soccer_vision_2d_msgs/MarkingSegment[] segments\n",
    "soccer_vision_2d_msgs/msg/Goalpost": "vision_msgs/BoundingBox2D bb\n"
    "soccer_vision_attribute_msgs/Goalpost attributes\n" + _CONFIDENCE,
    "soccer_vision_2d_msgs/msg/GoalpostArray": "std_msgs/Header header\nsoccer_vision_2d_msgs/Goalpost[] posts\n",
}
"""By type of ROS 2, all with their packages."""
EARLIER = {
    "vision_interface/msg/DetectedObject": _OBJECT.format(color="", pixel="") + _PLACES,
    "vision_interface/msg/Detections": _SEEN,
    **{
        name: text.replace("vision_msgs/Point2D", "geometry_msgs/Point")
        for name, text in DEFINITIONS.items()
        if name.startswith("soccer_vision_2d_msgs/msg/Marking")
    },
}
"""The same types as the first robots, and as vision_msgs before ROS 2 Humble, had them: tried where a message isn't of
the present definition.
"""


_IDL_LINE = "=" * 80 + "\n"
_LANGUAGES = {MessageDefinitionFormat.MSG: "msg", MessageDefinitionFormat.IDL: "idl"}
MAX_MESSAGE_BYTES = 200_000_000
_MAX_RATIO, _SMALL_BYTES, _PART_BYTES = 100, 64_000_000, 1_000_000  # of a packed file: unpacked to packed
_COMPUTED = re.compile(rb"\bVIRTUAL\b|\bAS\b", re.IGNORECASE)  # rosbag2 writes plain tables
_SUCCESSORS = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}
_NO_TIME = QosTime(0, 0)
_LATCHED = Qos(
    QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL,
    _NO_TIME, _NO_TIME, QosLiveliness.SYSTEM_DEFAULT, _NO_TIME, False,
)  # fmt: skip


class BadMessageError(Exception):
    """A message that cannot be decoded: why."""


@cache
def _humble() -> Any:
    return get_typestore(Stores.ROS2_HUMBLE)


@cache
def _known(earlier: bool = False) -> Any:
    """The types of ROS 2 Humble and teams' own; earlier: as these were once."""
    store: Any = get_typestore(Stores.ROS2_HUMBLE)
    texts = {**DEFINITIONS, **(EARLIER if earlier else {})}
    found: dict[str, Any] = {}
    for name, text in texts.items():
        found.update(get_types_from_msg(text, name))
    store.register(found)
    return store


@lru_cache(maxsize=64)
def _types_of(definition: Definition | None, kind: str) -> Any:
    """Those that a definition tells; those that are known where there is none, or none that can be read."""
    if definition is None:
        return _known()
    try:
        store: Any = get_typestore(Stores.EMPTY)
        store.register(_parsed(definition, kind))
    except Exception:  # the code that rosbags makes of a definition may raise anything: NameError of a constant inf
        return _known()
    unlike = [name for name in store.fielddefs if not _is_like_standard(store, name)]
    if unlike:
        raise BadMessageError(f"the bag's own definition of {unlike[0]:.80} lacks fields of ROS's own")
    return store


def _is_like_standard(types: Any, name: str) -> bool:
    """Whether a type has all fields of its namesake in ROS 2 Humble, if it has one. ROS 1 writes some as capitals."""
    known = _humble().fielddefs.get(_SUCCESSORS.get(name, name))
    own = {each.lower(): field for each, field in types.fielddefs[name][1]}
    return known is None or all(own.get(each) == field for each, field in known[1])


def field_kinds(kind: str) -> Sequence[tuple[str, Any]]:
    """Names of the fields of a type that is known, and what each is, as rosbags has it. Raises KeyError."""
    return _known().fielddefs[kind][1]


class Codec:
    """Messages to and from bytes. Definitions that stand in the bag come before those of ROS 2 Humble and of teams."""

    def __init__(self) -> None:
        self.standard = _known()
        self._own: dict[str, Any] = {}

    def decode(self, topic: Topic, data: bytes | memoryview) -> Any:
        """A message with its fields as attributes. Raises BadMessageError."""
        types = self._own.get(topic.name)
        if types is None:
            types = self._own[topic.name] = _types_of(topic.definition, topic.type)
        try:
            return self._decoded(types, topic, data)
        except BadMessageError:
            if types is not _known() or topic.type not in EARLIER:
                raise
            message = self._decoded(_known(earlier=True), topic, data)
            self._own[topic.name] = _known(earlier=True)
            return message

    @staticmethod
    def _decoded(types: Any, topic: Topic, data: bytes | memoryview) -> Any:
        try:
            if topic.encoding == "ros1":
                return types.deserialize_ros1(data, topic.type)
            return types.deserialize_cdr(data, topic.type)
        except Exception as error:  # whatever a decoder that is made of the bag's own definition may raise
            raise BadMessageError(f"{type(error).__name__}: {error}") from None

    def make(self, kind: str, **fields: Any) -> Any:
        """A message of a ROS 2 type. A message within may be the mapping of its fields; what isn't named is zero, or
        empty.
        """
        own = {name: self._field(of, fields.pop(name, None)) for name, of in self.standard.fielddefs[kind][1]}
        return self.standard.types[kind](**own, **fields)  # which refuses what is left

    def _field(self, of: Any, value: Any) -> Any:
        """A field as its message wants it. of: node and type, as rosbags has them."""
        node, inner = of
        if node == Nodetype.NAME:
            return self.make(inner, **(value or {})) if value is None or isinstance(value, Mapping) else value
        if node == Nodetype.BASE:
            return value if value is not None else {"string": "", "bool": False}.get(inner[0], 0)
        element, count = inner
        if element[0] == Nodetype.NAME:
            return [self._field(element, each) for each in value or ()]
        kind = element[1][0]
        if kind == "string":
            return list(value or ())
        return np.asarray(np.zeros(count) if value is None else value, "uint8" if kind in ("byte", "char") else kind)

    def encode(self, kind: str, message: Any) -> bytes:
        """A message as CDR."""
        return bytes(self.standard.serialize_cdr(message, kind))

    def definition(self, kind: str) -> str:
        """The text of a type and of all that it is made of."""
        return str(self.standard.generate_msgdef(kind, ros_version=2)[0])


def _parsed(definition: Definition, name: str) -> dict[str, Any]:
    if definition.language == "msg":
        return get_types_from_msg(definition.text, name)
    if not definition.text.startswith(f"{_IDL_LINE}IDL: "):
        return get_types_from_idl(definition.text)
    found: dict[str, Any] = {}
    for part in definition.text.split(_IDL_LINE)[1:]:
        found.update(get_types_from_idl(part.split("\n", 1)[1]))
    return found


class RosbagsBag:
    """A rosbag2 folder, its .db3 files, or a ROS 1 bag, as far as rosbags reads it.

    Raises UnreadableError, with the reason, for what it refuses.
    """

    def __init__(self, paths: Sequence[Path], ros1: bool, problems: ProblemLog) -> None:
        self._paths = paths
        self._problems = problems
        self._encoding = "ros1" if ros1 else "cdr"
        self._readers: list[Any] = []
        self._following: dict[str, Iterator[Message]] = {}  # what comes behind the message fetched last
        stack = ExitStack()
        weakref.finalize(self, _close, stack, self._following)
        for path in paths:
            for file in path.glob("*.db3") if path.is_dir() else [path] if path.suffix == ".db3" else []:
                _check_tables(file)
            for file in path.glob("*.zstd") if path.is_dir() else ():
                _check_packed(file)
            with _refusals(path):
                self._readers.append(stack.enter_context(Ros1Reader(path) if ros1 else Ros2Reader(path)))

    @cached_property
    def topics(self) -> Mapping[str, Topic]:
        """By name."""
        found: dict[str, Topic] = {}
        for connection in chain.from_iterable(map(_sound, self._readers)):
            language = _LANGUAGES.get(connection.msgdef.format)
            definition = None if language is None else Definition(language, connection.msgdef.data)
            name = connection.topic
            count = connection.msgcount if isinstance(connection.msgcount, int) else 0
            count += found[name].messages if name in found else 0
            found[name] = Topic(name, connection.msgtype, self._encoding, definition, count)
        return found

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Those of some topics, in the order in which they were received."""
        return self._from(topics, None)

    def fetch(self, topic: str, place: Place) -> bytes | memoryview:
        """The data of one message. Raises UnreadableError if it is not there any more."""
        following = self._following.pop(topic, None)
        message = None if following is None else next(following, None)
        if message is None or message.place != place:
            following = self._from((topic,), place.first)
            message = next((message for message in following if message.place >= place), None)
        if message is None or following is None or message.place != place:
            raise UnreadableError(self._paths[0], f"a message of {topic} is not where it was")
        self._following[topic] = following
        return message.data

    def _from(self, topics: Collection[str], start_ns: int | None) -> Iterator[Message]:
        """From a time on. The second number of a place counts the messages of a topic with the same time."""
        last: dict[str, Place] = {}
        for path, reader in zip(self._paths, self._readers, strict=True):
            wanted = [connection for connection in _sound(reader) if connection.topic in topics]
            if not wanted:
                continue
            try:
                for connection, log_ns, data in reader.messages(wanted, start=start_ns):
                    if not isinstance(data, bytes | memoryview) or type(log_ns) is not int or not 0 <= log_ns < 2**63:
                        raise ValueError("a message is no message")  # sqlite stores anything in any column
                    if connection.topic not in topics:  # the index of a damaged bag may lead elsewhere
                        continue
                    before = last.get(connection.topic)
                    same = before is not None and before.first == log_ns
                    place = last[connection.topic] = Place(log_ns, before.second + 1 if same and before else 0)
                    yield Message(connection.topic, log_ns, data, place)
            except Exception as error:  # rosbags lets those of its own libraries through: apsw, struct, zstd, lz4
                what = f"is damaged ({error}); what stands before that is read"
                if not self._problems.file_counts[ProblemKind.BAG, path.name]:
                    self._problems.add(ProblemKind.BAG, path.name, what)


def _sound(reader: Any) -> list[Connection]:
    """Those with a name and a type: rosbags takes over what metadata.yaml says, of whatever type."""
    return [each for each in reader.connections if isinstance(each.topic, str) and isinstance(each.msgtype, str)]


def _check_packed(path: Path) -> None:
    """Raises UnreadableError for a file that would unpack to far more than recorded data do."""
    most, found = max(_SMALL_BYTES, _MAX_RATIO * path.stat().st_size), 0
    with suppress(zstandard.ZstdError), open_bytes(path) as packed:
        reader = zstandard.ZstdDecompressor(max_window_size=MAX_MESSAGE_BYTES).stream_reader(packed)
        while part := reader.read(_PART_BYTES):
            found += len(part)
            if found > most:
                raise UnreadableError(path, f"unpacks to more than {most / 1e6:.0f} MB, {_MAX_RATIO} times its size")


def _check_tables(path: Path) -> None:
    """Raises UnreadableError for a database that would compute its rows, maybe without end, or has one of any size."""
    broken = (sqlite3.Error, UnicodeDecodeError)  # of text, also of an error's: rosbags says what cannot be read
    with suppress(*broken), closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as database:
        tables = database.execute("SELECT CAST(sql AS BLOB) FROM sqlite_master WHERE type IN ('table', 'view')")
        for (statement,) in tables:
            if statement is not None and _COMPUTED.search(bytes(statement)):
                raise UnreadableError(path, "is no bag: it holds a view or computed columns")
        (largest,) = database.execute("SELECT max(length(data)) FROM messages").fetchone()
        if isinstance(largest, int) and largest > MAX_MESSAGE_BYTES:
            what = f"holds a message of {largest / 1e6:.0f} MB; at most {MAX_MESSAGE_BYTES / 1e6:.0f} MB are read"
            raise UnreadableError(path, what)


def _close(stack: ExitStack, following: dict[str, Iterator[Message]]) -> None:
    following.clear()  # sqlite closes no database that is being read
    with suppress(Exception):
        stack.close()


@contextmanager
def _refusals(path: Path) -> Iterator[None]:
    """Turns what rosbags raises at opening into UnreadableError."""
    try:
        yield
    except Exception as error:
        why = str(error) if isinstance(error, Ros1Error | Ros2Error) else f"{type(error).__name__}: {error}"
        raise UnreadableError(path, f"cannot be read as a bag ({why})") from None


class Rosbag2Writer:
    """A new rosbag2 folder of version 8, which ROS 2 Humble reads, too.

    in_mcap: messages in an MCAP file, else sqlite3.
    Raises OSError where it cannot be made.
    """

    def __init__(self, folder: Path, codec: Codec, in_mcap: bool) -> None:
        self._codec = codec
        plugin = StoragePlugin.MCAP if in_mcap else StoragePlugin.SQLITE3
        self._writer = Writer(folder, version=8, storage_plugin=plugin)
        self._writer.open()
        self._connections: dict[str, Connection] = {}

    def write(self, topic: str, kind: str, log_ns: int, data: bytes) -> None:
        """Add a message."""
        if topic not in self._connections:
            qos = (_LATCHED,) if topic in LATCHED_TOPICS else ()
            self._connections[topic] = self._writer.add_connection(
                topic, kind, typestore=self._codec.standard, offered_qos_profiles=qos
            )
        self._writer.write(self._connections[topic], log_ns, data)

    def close(self) -> None:
        """Write what comes last."""
        self._writer.close()
