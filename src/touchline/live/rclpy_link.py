"""The link of ROS 2 by rclpy, where Python has it: for whatever middleware ROS speaks there, Zenoh, too.

Messages go through it as the bytes that they are (`raw` subscriptions, bytes published), and are read and made as those
of the other links.
"""

from __future__ import annotations

import importlib
import time
from collections import deque
from collections.abc import Iterator
from importlib.util import find_spec
from typing import Any

from touchline.errors import InputError
from touchline.live.ros_end import RosEnd
from touchline.live.ros_topics import DIAGNOSTICS, DIAGNOSTICS_TYPE, POSE, POSE_TYPE, TF_TYPE, Outgoing
from touchline.sources.bags.messages import Topic

_LOOK_S = 0.5  # for new topics
_MAX_AT_ONCE, _DEPTH = 100, 100
_NODE = "touchline"


def require_rclpy() -> None:
    """Raises InputError where rclpy cannot be imported."""
    missing = [name for name in ("rclpy", "rosbags") if find_spec(name) is None]
    if missing:
        raise InputError(
            f"--rclpy: {' and '.join(missing)} cannot be imported: source ROS's setup.bash, in an environment of ROS's "
            "own Python; or take --dds, or examples/ros_bridge.py"
        )


class RclpyLink(RosEnd):
    """A node of ROS: topics are found as they appear, and read with what their publishers offer."""

    def __init__(self, *options: Any, **named: Any) -> None:
        """As `RosEnd` has them. Raises InputError."""
        super().__init__(*options, **named)
        self._rclpy: Any = importlib.import_module("rclpy")
        self._qos: Any = importlib.import_module("rclpy.qos")
        self._starts = not self._rclpy.ok()
        if self._starts:
            self._rclpy.init()
        self._node = self._rclpy.create_node(_NODE, namespace=self._namespace or None)
        self._came: deque[tuple[str, bytes]] = deque()
        self._publishers: dict[str, Any] = {}
        self._looked_s = -_LOOK_S
        self._unknown: set[str] = set()
        for name, kind in ((self._namespace + POSE, POSE_TYPE), ("/tf", TF_TYPE), (DIAGNOSTICS, DIAGNOSTICS_TYPE)):
            self._announce(name, kind)

    @property
    def refused(self) -> dict[str, int]:
        """What was left out so far, and how often."""
        unknown = {f"a topic of {kind}, whose definition is not installed": 1 for kind in sorted(self._unknown)}
        return {**super().refused, **unknown}

    def close(self) -> None:
        """Leave the graph."""
        self._node.destroy_node()
        if self._starts:
            self._rclpy.shutdown()

    def _offered(self) -> Iterator[tuple[str, str]]:
        if time.monotonic() < self._looked_s + _LOOK_S:
            return
        self._looked_s = time.monotonic()
        for name, kinds in self._node.get_topic_names_and_types():
            others = len(self._node.get_publishers_info_by_topic(name)) - (name in self._publishers)
            if len(kinds) == 1 and others > 0:
                yield name, kinds[0]

    def _take(self, ends_s: float) -> list[tuple[str, bytes]]:
        self._rclpy.spin_once(self._node, timeout_sec=min(max(ends_s - time.monotonic(), 0.0), 0.01))
        for _ in range(_MAX_AT_ONCE):  # what else is there
            before = len(self._came)
            self._rclpy.spin_once(self._node, timeout_sec=0.0)
            if len(self._came) == before:
                break
        order = {name: number for number, name in enumerate(self._in_order())}
        taken = sorted(self._came, key=lambda each: order.get(each[0], len(order)))
        self._came.clear()
        return taken

    def _write(self, out: Outgoing) -> None:
        self._announce(out.topic, out.kind)
        if out.topic in self._publishers:  # else its definition is not installed, which `refused` says
            self._publishers[out.topic].publish(self._codec.encode(out.kind, out.message))

    def _read(self, topic: Topic) -> None:
        kind = self._message_class(topic.type)
        if kind is None:
            return
        qos = self._qos
        offers = [end.qos_profile.reliability for end in self._node.get_publishers_info_by_topic(topic.name)]
        all_reliable = all(offer == qos.ReliabilityPolicy.RELIABLE for offer in offers)
        latched = topic.name.endswith("/tf_static")
        profile = qos.QoSProfile(
            depth=_DEPTH,
            reliability=qos.ReliabilityPolicy.RELIABLE if all_reliable else qos.ReliabilityPolicy.BEST_EFFORT,
            durability=qos.DurabilityPolicy.TRANSIENT_LOCAL if latched else qos.DurabilityPolicy.VOLATILE,
        )

        def came(data: bytes) -> None:
            self._came.append((topic.name, bytes(data)))

        self._node.create_subscription(kind, topic.name, came, profile, raw=True)

    def _announce(self, name: str, kind: str) -> None:
        made = None if name in self._publishers else self._message_class(kind)
        if made is not None:
            self._publishers[name] = self._node.create_publisher(made, name, 10)

    def _message_class(self, kind: str) -> Any:
        """rclpy needs a message's own class, though its bytes are read here; None where it is not installed."""
        try:
            package, _, name = kind.split("/")
            return getattr(importlib.import_module(f"{package}.msg"), name)
        except (ImportError, AttributeError, ValueError):
            self._unknown.add(kind)
            return None
