"""The one place that knows the rosbags package (0.11): its readers, its writer and its message types."""

import weakref
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from functools import cache, cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Connection, MessageDefinition, MessageDefinitionFormat, Nodetype
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2 import Reader as Ros2Reader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from touchline.files.opened import UnreadableError
from touchline.sources.bags.layout import LATCHED, LATCHED_TOPICS
from touchline.sources.bags.messages import Bag, Message, Place, Topic
from touchline.sources.problems import ProblemLog

_IDL_LINE = "=" * 80 + "\n"


class BadMessageError(Exception):
    """A message that cannot be decoded: why."""


@cache
def _ros_types(encoding: str) -> Any:
    """The types of ROS itself."""
    return get_typestore(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.ROS2_HUMBLE)


@cache
def _team_types(*files: str) -> Any:
    """The types of ROS 2, and those of files beside this one; of several definitions of a type the last one counts."""
    store: Any = get_typestore(Stores.ROS2_HUMBLE)
    found: dict[str, Any] = {}
    for file in files:
        first, text = Path(__file__).with_name(file).read_text(encoding="utf-8").split("\n", 1)
        found.update(get_types_from_msg(text, first.removeprefix("MSG: ")))
    store.register(found)
    return store


def _known_types() -> Any:
    return _team_types("team_messages.msg")


def earlier_types() -> Any:
    """The types as the first robots had them, and as vision_msgs before ROS 2 Humble: for what no present type fits."""
    return _team_types("team_messages.msg", "team_messages_earlier.msg")


@lru_cache(maxsize=64)
def _types_of(definition: MessageDefinition | None, kind: str, encoding: str) -> Any:
    """The types by which to decode a type: ROS's own before the bag's, the bag's before those that teams have."""
    if kind in _ros_types(encoding).fielddefs:
        return _ros_types(encoding)
    if definition is None:
        return _known_types()
    store: Any = get_typestore(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.ROS2_HUMBLE)
    try:
        parsed = _parsed(definition, kind)
        store.register({name: fields for name, fields in parsed.items() if name not in store.fielddefs})
    except Exception:  # the code that rosbags makes of a definition may raise anything: NameError of a constant inf
        return _known_types()
    return store


class Codec:
    """Messages to and from bytes."""

    def __init__(self) -> None:
        self.standard = _known_types()
        self._own: dict[str, Any] = {}

    def decode(self, topic: Topic, data: bytes | memoryview) -> Any:
        """A message with its fields as attributes. Raises BadMessageError."""
        types = self._own.get(topic.name)
        if types is None:
            types = self._own[topic.name] = _types_of(topic.definition, topic.type, topic.encoding)
        try:
            return self._decoded(types, topic, data)
        except BadMessageError:
            if types is not _known_types():
                raise
            message = self._decoded(earlier_types(), topic, data)
            self._own[topic.name] = earlier_types()
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


def _parsed(definition: MessageDefinition, name: str) -> dict[str, Any]:
    if definition.format == MessageDefinitionFormat.MSG:
        return get_types_from_msg(definition.data, name)
    found: dict[str, Any] = {}
    for part in filter(None, definition.data.split(_IDL_LINE)):  # each may begin with the line `IDL: NAME`
        found.update(get_types_from_idl(part.split("\n", 1)[1] if part.startswith("IDL: ") else part))
    return found


class RosbagsBag(Bag):
    """A rosbag2 folder, its .db3 files, or a ROS 1 bag, as far as rosbags reads it.

    Its `AnyReader` would parse every definition of a bag, and stop at the first one that it cannot.
    A place is the time of a message, and the number of its topic's messages before it with the same time.
    Raises UnreadableError, with the reason, for what rosbags refuses.
    """

    def __init__(self, paths: Sequence[Path], ros1: bool, problems: ProblemLog) -> None:
        super().__init__(problems)
        self._paths = paths
        self._encoding = "ros1" if ros1 else "cdr"
        self._readers: list[Any] = []
        stack = ExitStack()
        stack.enter_context(suppress(Exception))  # sqlite closes no database that is being read
        weakref.finalize(self, stack.close)
        for path in paths:
            try:
                self._readers.append(stack.enter_context(Ros1Reader(path) if ros1 else Ros2Reader(path)))
            except Exception as error:  # of rosbags, and of what it reads with: apsw, struct, zstd, lz4
                raise UnreadableError(path, f"cannot be read as a bag ({type(error).__name__}: {error})") from None

    @cached_property
    def topics(self) -> Mapping[str, Topic]:
        """By name."""
        found: dict[str, Topic] = {}
        for reader in self._readers:
            for each in _sound(reader):
                definition = None if each.msgdef.format == MessageDefinitionFormat.NONE else each.msgdef
                count = each.msgcount if isinstance(each.msgcount, int) else 0
                count += found[each.topic].messages if each.topic in found else 0
                found[each.topic] = Topic(each.topic, each.msgtype, self._encoding, definition, count)
        return found

    def messages(self, topics: Collection[str], start: Place | None = None) -> Iterator[Message]:
        """The messages of some topics, in the order in which they were received."""
        last: dict[str, Place] = {}
        for path, reader in zip(self._paths, self._readers, strict=True):
            wanted = [each for each in _sound(reader) if each.topic in topics]
            try:
                for each, log_ns, data in reader.messages(wanted, start=start and start.first) if wanted else ():
                    if not isinstance(data, bytes) or type(log_ns) is not int or not 0 <= log_ns < 2**63:
                        raise ValueError("a message is no message")  # sqlite stores anything in any column
                    if each.topic not in topics:  # the index of a damaged bag may lead elsewhere
                        continue
                    before = last.get(each.topic)
                    same = before is not None and before.first == log_ns
                    place = last[each.topic] = Place(log_ns, before.second + 1 if same and before else 0)
                    yield Message(each.topic, log_ns, data, place)
            except Exception as error:
                self._report(path, path.name, f"is damaged ({error}); what stands before that is read")


def _sound(reader: Any) -> list[Connection]:
    """The connections with a name and a type: rosbags takes over what metadata.yaml says, of whatever type."""
    return [each for each in reader.connections if isinstance(each.topic, str) and isinstance(each.msgtype, str)]


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
            qos = parse_qos(LATCHED) if topic in LATCHED_TOPICS else ()
            self._connections[topic] = self._writer.add_connection(
                topic, kind, typestore=self._codec.standard, offered_qos_profiles=qos
            )
        self._writer.write(self._connections[topic], log_ns, data)

    def close(self) -> None:
        """Write what comes last."""
        self._writer.close()
