"""A node of ROS 2 by rclpy, over whatever middleware ROS speaks.

Messages pass as bytes (CDR), which the reader of bags decodes and makes: subscriptions are `raw`.
"""

import importlib
import os
import time
from collections import deque
from collections.abc import Iterator
from typing import Any

from touchline.sources.bags.result_messages import Outgoing
from touchline.sources.bags.with_rosbags import Codec

_LOOK_S = 0.5  # between two looks for new topics
_MAX_AT_ONCE, _DEPTH = 100, 100
_OPTIONAL = ("nav2_msgs",)  # packages that need not be installed


class RosNode:
    """Finds topics as publishers appear, reads them with the quality of service that is offered, and publishes."""

    def __init__(self, name: str = "touchline", namespace: str = "", node: Any = None) -> None:
        """node: an existing one, with its executor; it is spun here, and outlives this object."""
        self._rclpy: Any = importlib.import_module("rclpy")
        self._qos: Any = importlib.import_module("rclpy.qos")
        self._starts = node is None and not self._rclpy.ok()
        if self._starts:
            self._rclpy.init()
        self._own = node is None
        self._node = self._rclpy.create_node(name, namespace=namespace or None) if node is None else node
        self._executor: Any = None if node is None else node.executor
        if self._executor is None:
            self._executor = importlib.import_module("rclpy.executors").SingleThreadedExecutor()
            self._executor.add_node(self._node)
        self.codec = Codec()
        self.namespace: str = self._node.get_namespace().rstrip("/")
        self._came: deque[tuple[str, bytes]] = deque()
        self._subscriptions: list[Any] = []
        self._publishers: dict[str, Any] = {}
        self._looked_s = -_LOOK_S
        self._unknown: set[str] = set()

    @property
    def refused(self) -> dict[str, int]:
        """Topics that could not be read or published."""
        return {f"a topic of {kind}, whose definition is not installed": 1 for kind in sorted(self._unknown)}

    def around(self) -> str:
        """Where topics are looked for, in words."""
        return f"ROS_DOMAIN_ID is {os.environ.get('ROS_DOMAIN_ID', '').strip() or '0'}"

    def close(self) -> None:
        """Leave the graph."""
        for each in self._subscriptions:
            self._node.destroy_subscription(each)
        for each in self._publishers.values():
            self._node.destroy_publisher(each)
        if self._own:
            self._executor.remove_node(self._node)
            self._node.destroy_node()
        if self._starts:
            self._rclpy.shutdown()

    def offered(self) -> Iterator[tuple[str, str]]:
        """Names and types, as sensor_msgs/msg/Image, of what others publish."""
        if time.monotonic() < self._looked_s + _LOOK_S:
            return
        self._looked_s = time.monotonic()
        for name, kinds in self._node.get_topic_names_and_types():
            others = len(self._node.get_publishers_info_by_topic(name)) - (name in self._publishers)
            if len(kinds) == 1 and others > 0:
                yield name, kinds[0]

    def take(self, ends_s: float) -> list[tuple[str, bytes]]:
        """Topics and messages that have come. ends_s: until when they may be waited for."""
        self._executor.spin_once(timeout_sec=min(max(ends_s - time.monotonic(), 0.0), 0.01))
        for _ in range(_MAX_AT_ONCE):  # what else is there
            before = len(self._came)
            self._executor.spin_once(timeout_sec=0.0)
            if len(self._came) == before:
                break
        taken = list(self._came)
        self._came.clear()
        return taken

    def read(self, name: str, kind: str) -> None:
        """Read a topic from now on, as its publishers offer it."""
        message = self._message_class(kind)
        if message is None:
            return
        qos = self._qos
        offers = [end.qos_profile.reliability for end in self._node.get_publishers_info_by_topic(name)]
        reliable = all(offer == qos.ReliabilityPolicy.RELIABLE for offer in offers)

        def came(data: bytes) -> None:
            self._came.append((name, bytes(data)))

        profile = self._profile(_DEPTH, reliable, name.endswith("/tf_static"))
        self._subscriptions.append(self._node.create_subscription(message, name, came, profile, raw=True))

    def announce(self, name: str, kind: str, latched: bool = False) -> None:
        """Announce what will be published; `refused` says where its definition is not installed. latched: subscribers
        that come later receive the last message.
        """
        made = None if name in self._publishers else self._message_class(kind)
        if made is not None:
            profile = self._profile(1 if latched else 10, True, latched)
            self._publishers[name] = self._node.create_publisher(made, name, profile)

    def publish(self, out: Outgoing) -> None:
        """Publish a message."""
        self.announce(out.topic, out.kind, out.latched)
        if out.topic in self._publishers:
            self._publishers[out.topic].publish(self.codec.encode(out.kind, out.message))

    def wanted(self, name: str) -> bool:
        """Whether somebody reads what is published there."""
        return name in self._publishers and self._publishers[name].get_subscription_count() > 0

    def _profile(self, depth: int, reliable: bool, latched: bool) -> Any:
        of = self._qos
        return of.QoSProfile(
            depth=depth,
            reliability=of.ReliabilityPolicy.RELIABLE if reliable else of.ReliabilityPolicy.BEST_EFFORT,
            durability=of.DurabilityPolicy.TRANSIENT_LOCAL if latched else of.DurabilityPolicy.VOLATILE,
        )

    def _message_class(self, kind: str) -> Any:
        """A message's class, which rclpy needs, though only bytes pass; None where it is not installed."""
        try:
            package, _, name = kind.split("/")
            return getattr(importlib.import_module(f"{package}.msg"), name)
        except (ImportError, AttributeError, ValueError):
            self._unknown |= set() if kind.startswith(_OPTIONAL) else {kind}
            return None
