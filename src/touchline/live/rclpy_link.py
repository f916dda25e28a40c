"""The topics of ROS 2 by rclpy, where Python has it: for whatever middleware ROS speaks there, Zenoh, too.

Messages go through it as the bytes that they are (`raw` subscriptions, bytes published), and are read and made as those
of the other links.
"""

import importlib
import time
from collections import deque
from collections.abc import Iterator
from importlib.util import find_spec
from typing import Any

from touchline.errors import InputError
from touchline.live.ros_link import NODE

_LOOK_S = 0.5  # for new topics
_MAX_AT_ONCE, _DEPTH = 100, 100
_OPTIONAL = ("nav2_msgs",)  # packages whose topics are left out without a word


def require_rclpy() -> None:
    """Raises InputError where rclpy cannot be imported."""
    missing = [name for name in ("rclpy", "rosbags") if find_spec(name) is None]
    if missing:
        raise InputError(
            f"--rclpy: {' and '.join(missing)} cannot be imported: source ROS's setup.bash, in an environment of ROS's "
            "own Python; or take --dds, or the bridge of ros/touchline_ros (--bridge)"
        )


class Rclpy:
    """A node of ROS: topics are found as they appear, and read with what their publishers offer."""

    pause_s = 0.0

    def __init__(self, namespace: str = "", node: Any = None, name: str = NODE) -> None:
        """node: one that is there already, with its executor; it is spun here, and outlives this."""
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
        self._came: deque[tuple[str, bytes]] = deque()
        self._subscriptions: list[Any] = []
        self._publishers: dict[str, Any] = {}
        self._looked_s = -_LOOK_S
        self._unknown: set[str] = set()

    @property
    def refused(self) -> dict[str, int]:
        """What could not be carried."""
        return {f"a topic of {kind}, whose definition is not installed": 1 for kind in sorted(self._unknown)}

    def around(self) -> str:
        """Nothing that ROS does not say itself."""
        return ""

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
        """Names and types of what others publish."""
        if time.monotonic() < self._looked_s + _LOOK_S:
            return
        self._looked_s = time.monotonic()
        for name, kinds in self._node.get_topic_names_and_types():
            others = len(self._node.get_publishers_info_by_topic(name)) - (name in self._publishers)
            if len(kinds) == 1 and others > 0:
                yield name, kinds[0]

    def take(self, ends_s: float) -> list[tuple[str, bytes]]:
        """What has come."""
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
        """Say that something will be published; where its definition is not installed, `refused` says so."""
        made = None if name in self._publishers else self._message_class(kind)
        if made is not None:
            profile = self._profile(1 if latched else 10, True, latched)
            self._publishers[name] = self._node.create_publisher(made, name, profile)

    def write(self, name: str, kind: str, data: bytes, latched: bool = False) -> None:
        """Publish a message."""
        self.announce(name, kind, latched)
        if name in self._publishers:
            self._publishers[name].publish(data)

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
        """rclpy needs a message's own class, though its bytes are read here; None where it is not installed."""
        try:
            package, _, name = kind.split("/")
            return getattr(importlib.import_module(f"{package}.msg"), name)
        except (ImportError, AttributeError, ValueError):
            self._unknown |= set() if kind.startswith(_OPTIONAL) else {kind}
            return None
