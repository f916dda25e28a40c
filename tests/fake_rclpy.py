"""A stand-in with rclpy's interface; tests/ros_node.py (`make ros`) takes the real one."""

from __future__ import annotations

import sys
import time
from collections import deque
from collections.abc import Callable
from enum import Enum
from importlib.machinery import ModuleSpec
from types import ModuleType, SimpleNamespace
from typing import Any, NamedTuple

import pytest

Reliability = Enum("Reliability", ["RELIABLE", "BEST_EFFORT"])
Durability = Enum("Durability", ["VOLATILE", "TRANSIENT_LOCAL"])
PACKAGES = (
    "booster_interface",
    "diagnostic_msgs",
    "geometry_msgs",
    "nav_msgs",
    "rosgraph_msgs",
    "sensor_msgs",
    "std_msgs",
    "tf2_msgs",
    "vision_interface",
    "visualization_msgs",
)


class Ros:
    """The graph: all nodes, and whether rclpy was started."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self.running = False

    def create_node(self, name: str, namespace: str | None = None) -> Node:
        self.nodes.append(Node(self, name, namespace or "/"))
        return self.nodes[-1]

    def node(self, name: str) -> Node:
        """The newest one of this name."""
        return [node for node in self.nodes if node.name == name][-1]


class Subscription(NamedTuple):
    """qos: as it was asked for."""

    topic: str
    came: Callable[[bytes], None]
    qos: Any


class Publisher:
    """Delivers to every subscription whose quality of service matches; keeps the last message if it is latched."""

    def __init__(self, ros: Ros, kind: str, topic: str, qos: Any) -> None:
        self.ros, self.kind, self.topic, self.qos_profile = ros, kind, topic, qos
        self.last: bytes | None = None

    def publish(self, data: bytes) -> None:
        self.last = data
        for node in self.ros.nodes:
            for subscription in node.subscriptions:
                self.deliver(node, subscription, data)

    def matches(self, subscription: Subscription) -> bool:
        asked, offered = subscription.qos, self.qos_profile
        unreliable = asked.reliability is Reliability.RELIABLE is not offered.reliability
        volatile = asked.durability is Durability.TRANSIENT_LOCAL is not offered.durability
        return subscription.topic == self.topic and not unreliable and not volatile

    def deliver(self, node: Node, subscription: Subscription, data: bytes) -> None:
        if self.matches(subscription):
            node.waiting.append((subscription, data))

    def get_subscription_count(self) -> int:
        return sum(self.matches(each) for node in self.ros.nodes for each in node.subscriptions)


class Node:
    """What `touchline` uses of a node; `offer` and `listen` are for the other ends of its topics."""

    executor = None

    def __init__(self, ros: Ros, name: str, namespace: str) -> None:
        self.ros, self.name, self.namespace = ros, name, namespace
        self.publishers: list[Publisher] = []
        self.subscriptions: list[Subscription] = []
        self.waiting: deque[tuple[Subscription, bytes]] = deque()
        self.received: list[tuple[str, bytes]] = []

    def get_namespace(self) -> str:
        return self.namespace

    def get_topic_names_and_types(self) -> list[tuple[str, list[str]]]:
        found = {each.topic: [each.kind] for node in self.ros.nodes for each in node.publishers}
        return sorted(found.items())

    def get_publishers_info_by_topic(self, topic: str) -> list[Publisher]:
        return [each for node in self.ros.nodes for each in node.publishers if each.topic == topic]

    def create_subscription(self, kind: str, topic: str, came: Callable[[bytes], None], qos: Any, *, raw: bool) -> Any:
        assert raw
        assert {each.kind for each in self.get_publishers_info_by_topic(topic)} <= {kind}
        self.subscriptions.append(Subscription(topic, came, qos))
        for publisher in self.get_publishers_info_by_topic(topic):
            if publisher.last is not None and qos.durability is Durability.TRANSIENT_LOCAL:
                publisher.deliver(self, self.subscriptions[-1], publisher.last)
        return self.subscriptions[-1]

    def create_publisher(self, kind: str, topic: str, qos: Any) -> Publisher:
        self.publishers.append(Publisher(self.ros, kind, topic, qos))
        return self.publishers[-1]

    def destroy_subscription(self, made: Subscription) -> None:
        self.subscriptions.remove(made)

    def destroy_publisher(self, made: Publisher) -> None:
        self.publishers.remove(made)

    def destroy_node(self) -> None:
        self.ros.nodes.remove(self)

    def offer(self, topic: str, kind: str, reliable: bool = True, latched: bool = False) -> Publisher:
        reliability = Reliability.RELIABLE if reliable else Reliability.BEST_EFFORT
        durability = Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE
        return self.create_publisher(kind, topic, SimpleNamespace(reliability=reliability, durability=durability))

    def listen(self, topic: str, kind: str, latched: bool = False) -> None:
        """From now on its messages are in `received` after `spin`."""
        durability = Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE
        qos = SimpleNamespace(reliability=Reliability.RELIABLE, durability=durability)
        self.create_subscription(kind, topic, lambda data: self.received.append((topic, data)), qos, raw=True)

    def spin(self) -> dict[str, bytes]:
        """The last message of each topic."""
        while self.waiting:
            subscription, data = self.waiting.popleft()
            subscription.came(data)
        return dict(self.received)


class Executor:
    """Of one node."""

    node: Node | None = None

    def add_node(self, node: Node) -> None:
        self.node = node

    def remove_node(self, node: Node) -> None:
        self.node = None

    def spin_once(self, timeout_sec: float) -> None:
        assert self.node is not None
        if self.node.waiting:
            subscription, data = self.node.waiting.popleft()
            subscription.came(data)
        else:
            time.sleep(min(timeout_sec, 0.001))


class Messages(ModuleType):
    """PKG.msg: a message's class is its name here."""

    def __getattr__(self, name: str) -> str:
        if name.startswith("__"):
            raise AttributeError(name)
        return f"{self.__name__.partition('.')[0]}/msg/{name}"


def install(monkeypatch: pytest.MonkeyPatch) -> Ros:
    """Have `import rclpy` find the stand-in."""
    ros = Ros()

    def run(running: bool) -> Callable[[], None]:
        return lambda: setattr(ros, "running", running)

    contents: dict[str, dict[str, Any]] = {
        "rclpy": {
            "ok": lambda: ros.running,
            "init": run(True),
            "shutdown": run(False),
            "create_node": ros.create_node,
        },
        "rclpy.executors": {"SingleThreadedExecutor": Executor},
        "rclpy.qos": {"QoSProfile": SimpleNamespace, "ReliabilityPolicy": Reliability, "DurabilityPolicy": Durability},
    }
    for name, attributes in contents.items():
        module = ModuleType(name)
        module.__spec__ = ModuleSpec(name, None)
        module.__dict__.update(attributes)
        monkeypatch.setitem(sys.modules, name, module)
    for package in PACKAGES:
        monkeypatch.setitem(sys.modules, package, ModuleType(package))
        monkeypatch.setitem(sys.modules, f"{package}.msg", Messages(f"{package}.msg"))
    return ros
