"""The link of ROS 2 without ROS: DDS by Cyclone, with ROS 2's names of topics and types, and a node that is seen.

Topics are found by their types as publishers appear (or named), and read with what their publishers offer. Bound to
this machine alone unless told otherwise.
"""

from __future__ import annotations

import os
import time
import uuid
from collections import Counter
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any

import numpy as np
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import DDSException
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.internal import InvalidSample
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic as DdsTopic

from touchline.errors import InputError
from touchline.geometry import Pose3
from touchline.live.dds_types import ros_name, sample, sample_type
from touchline.live.heard import Heard, Picture, Reading, Told
from touchline.live.ros import RosReader
from touchline.live.ros_topics import BOOSTER_POSE_TYPE, FIXED_TOPICS, FIXED_TYPES, PLAYED, Outgoing
from touchline.live.ros_writer import RosWriter
from touchline.sources.bags.messages import Topic
from touchline.sources.bags.roles import COMPASS, DETECTIONS, IMU, ROLES, choose_topics
from touchline.sources.bags.team_writing import DETECTION_TOPIC
from touchline.sources.bags.with_rosbags import BadMessageError, Codec
from touchline.sources.problems import ProblemLog

UNUSABLE = (BadMessageError, InputError, ValueError, TypeError, OverflowError, AttributeError, IndexError)
"""What a message that is none may raise where it is read."""
SETTLE_S = 1.0  # after a publisher has appeared, until topics are chosen: others may still come
_POLL_S = 0.0005
_MOST_AT_ONCE = 100
_NODE = "touchline"
_DISCOVERY, _DISCOVERY_KIND = "ros_discovery_info", "rmw_dds_common/msg/ParticipantEntitiesInfo"
_LOOPBACK = """<CycloneDDS><Domain id="any"><General><Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>
<MaxAutoParticipantIndex>60</MaxAutoParticipantIndex><SPDPInterval>1s</SPDPInterval>
<InitialLocatorPruneDelay>inf</InitialLocatorPruneDelay><Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""
_PLAIN = Policy.DataRepresentation(use_cdrv0_representation=True)
_RELIABLE = Policy.Reliability.Reliable(100_000_000)
_KEPT = Qos(_RELIABLE, Policy.Durability.TransientLocal, Policy.History.KeepLast(1), _PLAIN)


class DdsNode:
    """A participant that ROS 2 sees as a node: readers and writers by ROS's names."""

    def __init__(self, name: str, namespace: str = "", network: bool = False) -> None:
        """network: beyond this machine, where CYCLONEDDS_URI says or everywhere. Raises InputError."""
        self.codec = Codec()
        self._name, self._namespace = name, namespace
        domain = _domain_id()
        try:
            if not network:
                _on_this_machine(domain)
            self.participant = DomainParticipant(domain, qos=Qos(Policy.Userdata(b"enclave=/;")))
        except DDSException as error:
            raise InputError(f"DDS: no participant in domain {domain}: {error}") from None
        self._topics: dict[str, Any] = {}
        self._readers: dict[str, Any] = {}
        self._writers: dict[str, Any] = {}
        self._graph = DataWriter(self.participant, self._topic(_DISCOVERY, _DISCOVERY_KIND), qos=_KEPT)
        self._tell_graph()

    def reader(self, name: str, kind: str, qos: Qos) -> Any:
        """A reader of a topic by its name in ROS."""
        made = DataReader(self.participant, self._topic(f"rt{name}", kind), qos=qos)
        self._readers[name] = made
        self._tell_graph()
        return made

    def announce(self, topic: str, kind: str) -> None:
        """Say that something will be published."""
        if topic not in self._writers:
            qos = Qos(_RELIABLE, Policy.Durability.Volatile, Policy.History.KeepLast(10), _PLAIN)
            self._writers[topic] = DataWriter(self.participant, self._topic(f"rt{topic}", kind), qos=qos)
            self._tell_graph()

    def write(self, out: Outgoing) -> None:
        """Publish a message."""
        self.announce(out.topic, out.kind)
        self._writers[out.topic].write(sample(out.kind, self.codec.encode(out.kind, out.message)))

    def _topic(self, name: str, kind: str) -> Any:
        if name not in self._topics:
            self._topics[name] = DdsTopic(self.participant, name, sample_type(kind), qos=Qos(_PLAIN))
        return self._topics[name]

    def _tell_graph(self) -> None:
        """What `ros2 node list` and `ros2 node info` show."""
        make = self.codec.make

        def gid(entity: Any) -> Any:
            whole: uuid.UUID = entity.guid
            return make("rmw_dds_common/msg/Gid", data=np.frombuffer(whole.bytes.ljust(24, b"\0"), dtype=np.uint8))

        node = make(
            "rmw_dds_common/msg/NodeEntitiesInfo",
            node_namespace=self._namespace or "/",
            node_name=self._name,
            reader_gid_seq=[gid(each) for each in self._readers.values()],
            writer_gid_seq=[gid(each) for each in self._writers.values()],
        )
        message = make(_DISCOVERY_KIND, gid=gid(self.participant), node_entities_info_seq=[node])
        self._graph.write(sample(_DISCOVERY_KIND, self.codec.encode(_DISCOVERY_KIND, message)))

    def close(self) -> None:
        """Leave the network."""
        for entities in (self._readers, self._writers, self._topics):
            entities.clear()
        del self._graph, self.participant


class DdsLink:
    """The robot's topics, found as they appear."""

    def __init__(
        self,
        topics: Mapping[str, str] | None = None,
        base: str | None = None,
        namespace: str = "",
        network: bool = False,
        mount: Pose3 | None = None,
    ) -> None:
        """topics: role -> topic, where it isn't found by its type. mount: `head_from_camera`, of a head whose own pose
        a topic tells. Raises InputError.
        """
        self._named = dict(topics or {})
        for role in self._named:
            if role not in ROLES:
                raise InputError(f"--topic {role}: is not known; one of {', '.join(ROLES)}")
        self._node = DdsNode(_NODE, namespace, network)
        self._reader, self._writer = RosReader(base, mount), RosWriter(self._node.codec, namespace)
        self._publishers = BuiltinDataReader(self._node.participant, BuiltinTopicDcpsPublication)
        self._seen: dict[str, tuple[Topic, Qos]] = {}
        self._news_s = 0.0
        self._chosen: dict[str, tuple[set[str], Topic, Any]] = {}  # by topic
        self.refused_messages: Counter[str] = Counter()

    def hear(self, timeout_s: float) -> list[Heard]:
        """What has come; the first message is waited for."""
        ends_s = time.monotonic() + timeout_s
        while True:
            self._discover()
            # where the camera is comes before what it saw
            names = sorted(self._chosen, key=lambda name: name not in FIXED_TOPICS)
            found = [heard for name in names for heard in self._take(name)]
            found += self._reader.due()
            if found or time.monotonic() >= ends_s:
                return found
            time.sleep(_POLL_S)

    def tell(self, told: Told) -> None:
        """Publish an estimate."""
        for out in self._writer.told(told):
            self._node.write(out)

    @property
    def topics(self) -> dict[str, str]:
        """What is read: role -> topic."""
        return {role: name for name, (roles, _, _) in self._chosen.items() for role in roles}

    @property
    def refused(self) -> dict[str, int]:
        """What was left out so far, and how often."""
        return dict(self.refused_messages + self._reader.refused)

    def close(self) -> None:
        """Leave the network."""
        self._chosen.clear()
        del self._publishers
        self._node.close()

    def _discover(self) -> None:
        for end in self._publishers.take(_MOST_AT_ONCE):
            if isinstance(end, InvalidSample) or not (end.type_name and end.topic_name.startswith("rt/")):
                continue
            kind = ros_name(end.type_name)
            if kind is None:
                continue
            name = end.topic_name[2:]
            if name not in self._seen:
                self._seen[name] = (Topic(name, kind, "cdr", None, 1), end.qos)
                self._news_s = time.monotonic()
                if FIXED_TYPES.get(FIXED_TOPICS.get(name, "")) == kind:
                    self._read(FIXED_TOPICS[name], self._seen[name][0])
        if self._news_s and time.monotonic() > self._news_s + SETTLE_S:
            self._news_s = 0.0
            self._choose()

    def _choose(self) -> None:
        """Read what was found for each role that is still free."""
        named = {role: name for role, name in self._named.items() if name in self._seen}
        free = {name: topic for name, (topic, _) in self._seen.items() if name not in FIXED_TOPICS}
        waits = {role for role in self._named if role not in named}
        taken = set(self.topics)
        try:
            found = choose_topics(free, named, ProblemLog())
        except InputError as error:
            self.refused_messages[str(error)] += 1
            return
        for role, topic in found.items():
            if role not in taken and role not in waits:
                self._read(role, topic)

    def _read(self, role: str, topic: Topic) -> None:
        if topic.name in self._chosen:
            self._chosen[topic.name][0].add(role)
            return
        offered = self._seen[topic.name][1]
        reliable = (
            _RELIABLE if offered[Policy.Reliability].__class__ is type(_RELIABLE) else Policy.Reliability.BestEffort
        )
        durable = Policy.Durability.TransientLocal if topic.name == "/tf_static" else Policy.Durability.Volatile
        self._reader.expect(role)
        if role == DETECTIONS and topic.name.startswith(DETECTION_TOPIC):
            own = self._writer.as_booster(topic.name.removeprefix(DETECTION_TOPIC))
            self._node.announce(own, BOOSTER_POSE_TYPE)
        reader = self._node.reader(topic.name, topic.type, Qos(reliable, durable, Policy.History.KeepLast(100), _PLAIN))
        self._chosen[topic.name] = ({role}, topic, reader)

    def _take(self, name: str) -> Iterator[Heard]:
        roles, topic, reader = self._chosen[name]
        for each in reader.take(_MOST_AT_ONCE):
            if isinstance(each, InvalidSample):
                continue
            try:
                message = self._node.codec.decode(topic, each)
                for role in roles - ({COMPASS} if IMU in roles else set()):
                    yield from self._reader.read(role, message, with_compass=COMPASS in roles)
            except UNUSABLE as error:
                self.refused_messages[f"a message of {name} that can't be used ({str(error)[:80]})"] += 1


class DdsRobot:
    """The robot's side: publishes what a recording holds."""

    def __init__(self, network: bool = False) -> None:
        """Announces everything and waits until those that listen have found it."""
        self._node = DdsNode("touchline_play", network=network)
        self._writer = RosWriter(self._node.codec)
        for topic, kind in PLAYED.items():
            self._node.announce(topic, kind)
        time.sleep(2.0 * SETTLE_S)

    def send(self, event: Reading | Picture) -> None:
        """Publish a sample or an image."""
        for out in self._writer.played(event):
            self._node.write(out)

    def close(self) -> None:
        """Send what is left, and leave the network."""
        for out in self._writer.rest():
            self._node.write(out)
        self._node.close()


@cache
def _on_this_machine(domain: int) -> Any:
    """The domain, bound to loopback: a process can set one up only once."""
    return Domain(domain, _LOOPBACK)


def _domain_id() -> int:
    """ROS_DOMAIN_ID, else 0. Raises InputError."""
    text = os.environ.get("ROS_DOMAIN_ID", "").strip() or "0"
    if not text.isdigit() or int(text) > 232:
        raise InputError(f"ROS_DOMAIN_ID={text:.40}: expected a number from 0 to 232")
    return int(text)
