"""The link of ROS 2 without ROS: DDS by Cyclone, with ROS 2's names of topics and types, and a node that is seen.

Topics are found by their types as publishers appear (or named), and read with what their publishers offer. Bound to
this machine alone unless told otherwise.
"""

import os
import re
import uuid
from collections.abc import Iterator
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
from touchline.live.dds_types import ros_name, sample, sample_type
from touchline.live.ros_link import NODE, domain_id
from touchline.sources.bags.with_rosbags import Codec

_MAX_AT_ONCE = 100
_DISCOVERY, _DISCOVERY_KIND = "ros_discovery_info", "rmw_dds_common/msg/ParticipantEntitiesInfo"
_LOOPBACK = """<CycloneDDS><Domain id="any"><General><Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>
<MaxAutoParticipantIndex>60</MaxAutoParticipantIndex><SPDPInterval>1s</SPDPInterval>
<InitialLocatorPruneDelay>inf</InitialLocatorPruneDelay><Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""
_PEERS = "<CycloneDDS><Domain id='any'><Discovery><Peers>{}</Peers></Discovery></Domain></CycloneDDS>"
_PLAIN = Policy.DataRepresentation(use_cdrv0_representation=True)
_RELIABLE = Policy.Reliability.Reliable(100_000_000)
_KEPT = Qos(_RELIABLE, Policy.Durability.TransientLocal, Policy.History.KeepLast(1), _PLAIN)


class DdsNode:
    """A participant that ROS 2 sees as a node: readers and writers by ROS's names."""

    def __init__(self, name: str, namespace: str = "", network: bool = False) -> None:
        """network: beyond this machine, as CYCLONEDDS_URI or ROS_STATIC_PEERS say, or everywhere. Raises InputError."""
        self.codec = Codec()
        self._name, self._namespace = name, namespace
        domain = domain_id()
        try:
            if not network:
                _set_up(domain, _LOOPBACK)
            elif peers := _peers():
                _set_up(domain, _PEERS.format("".join(f'<Peer address="{peer}"/>' for peer in peers)))
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

    def announce(self, topic: str, kind: str, latched: bool = False) -> None:
        """Say that something will be published. latched: those that come later receive the last one."""
        if topic not in self._writers:
            qos = Qos(_RELIABLE, Policy.Durability.Volatile, Policy.History.KeepLast(10), _PLAIN)
            self._writers[topic] = DataWriter(
                self.participant, self._topic(f"rt{topic}", kind), qos=_KEPT if latched else qos
            )
            self._tell_graph()

    def write(self, topic: str, kind: str, data: bytes, latched: bool = False) -> None:
        """Publish a message."""
        self.announce(topic, kind, latched)
        self._writers[topic].write(sample(kind, data))

    def wanted(self, topic: str) -> bool:
        """Whether somebody reads what is published there."""
        return topic in self._writers and bool(self._writers[topic].get_matched_subscriptions())

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


class Dds:
    """The robot's topics by DDS, found as they appear."""

    pause_s = 0.0005

    def __init__(self, namespace: str = "", network: bool = False, name: str = NODE) -> None:
        """network: beyond this machine. Raises InputError."""
        self._network = network
        self.node = DdsNode(name, namespace, network)
        self.announce, self.write, self.wanted = self.node.announce, self.node.write, self.node.wanted
        self.refused: dict[str, int] = {}
        self._publishers = BuiltinDataReader(self.node.participant, BuiltinTopicDcpsPublication)
        self._qos: dict[str, Qos] = {}
        self._readers: dict[str, Any] = {}

    def around(self) -> str:
        """Where it looks for topics, in words."""
        where = "every interface" if self._network else "this machine alone (127.0.0.1): --network goes beyond it"
        return f"domain {domain_id()} (ROS_DOMAIN_ID), {where}"

    def close(self) -> None:
        """Leave the network."""
        self._readers.clear()
        del self._publishers
        self.node.close()

    def offered(self) -> Iterator[tuple[str, str]]:
        """Names and types of what others publish."""
        own = self.node.participant.guid
        for end in self._publishers.take(_MAX_AT_ONCE):
            if isinstance(end, InvalidSample) or not (end.type_name and end.topic_name.startswith("rt/")):
                continue
            if end.participant_key == own:
                continue
            kind, name = ros_name(end.type_name), end.topic_name[2:]
            if kind is not None:
                self._qos.setdefault(name, end.qos)
                yield name, kind

    def read(self, name: str, kind: str) -> None:
        """Read a topic from now on, as its publisher offers it."""
        offered = self._qos[name]
        reliable = (
            _RELIABLE if offered[Policy.Reliability].__class__ is type(_RELIABLE) else Policy.Reliability.BestEffort
        )
        durable = Policy.Durability.TransientLocal if name.endswith("/tf_static") else Policy.Durability.Volatile
        qos = Qos(reliable, durable, Policy.History.KeepLast(100), _PLAIN)
        self._readers[name] = self.node.reader(name, kind, qos)

    def take(self, ends_s: float) -> Iterator[tuple[str, bytes]]:
        """What has come."""
        for name, reader in self._readers.items():
            for each in reader.take(_MAX_AT_ONCE):
                if not isinstance(each, InvalidSample):
                    yield name, each


@cache
def _set_up(domain: int, how: str) -> Any:
    """The domain: a process can set one up only once."""
    return Domain(domain, how)


def _peers() -> list[str]:
    """ROS_STATIC_PEERS, unless CYCLONEDDS_URI says all. Raises InputError where ROS is to stay on this machine."""
    reach = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").strip().upper()
    if os.environ.get("ROS_LOCALHOST_ONLY", "").strip() == "1" or reach in ("LOCALHOST", "OFF"):
        setting = f"ROS_AUTOMATIC_DISCOVERY_RANGE={reach}" if reach in ("LOCALHOST", "OFF") else "ROS_LOCALHOST_ONLY=1"
        raise InputError(f"--network: {setting} says that ROS stays on this machine; unset it, or leave out --network")
    if os.environ.get("CYCLONEDDS_URI"):
        return []
    return [
        peer for peer in re.split(r"[;\s]+", os.environ.get("ROS_STATIC_PEERS", "")) if re.fullmatch(r"[\w.:-]+", peer)
    ]
