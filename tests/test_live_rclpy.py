"""The link by rclpy against a stand-in with rclpy's interface; tests/ros_node.py (`make ros`) takes the real one."""

from __future__ import annotations

import sys
import time
from collections import deque
from collections.abc import Callable
from enum import Enum
from importlib.machinery import ModuleSpec
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from touchline.cli import main
from touchline.geometry import Pose
from touchline.live import rclpy_link, ros_link
from touchline.live.heard import Heard, Published, Reading, Sight
from touchline.live.rclpy_link import Rclpy
from touchline.live.ros_link import RosLink, RosOptions
from touchline.live.ros_writer import RosWriter
from touchline.sources.bags.messages import Topic
from touchline.sources.bags.with_rosbags import Codec
from touchline.types import Estimate, Status

Reliability = Enum("Reliability", ["RELIABLE", "BEST_EFFORT"])
Durability = Enum("Durability", ["VOLATILE", "TRANSIENT_LOCAL"])


class Graph:
    """Stands for ROS: who publishes what, who listens how, and what is on its way."""

    def __init__(self) -> None:
        self.offered: dict[str, tuple[str, Reliability]] = {}
        self.listening: dict[str, tuple[Callable[[bytes], None], Any]] = {}
        self.published: list[tuple[str, str, bytes]] = []
        self.waiting: deque[tuple[str, bytes]] = deque()
        self.own: dict[str, str] = {}
        self.latched: set[str] = set()
        self.running = False

    # of a node
    def get_topic_names_and_types(self) -> list[tuple[str, list[str]]]:
        offered = {name: kind for name, (kind, _) in self.offered.items()}
        return [(name, [kind]) for name, kind in {**self.own, **offered}.items()]

    def get_publishers_info_by_topic(self, name: str) -> list[Any]:
        own = [Reliability.RELIABLE] if name in self.own else []
        others = [self.offered[name][1]] if name in self.offered else []
        return [SimpleNamespace(qos_profile=SimpleNamespace(reliability=each)) for each in own + others]

    def create_subscription(self, kind: str, name: str, came: Callable[[bytes], None], qos: Any, *, raw: bool) -> None:
        assert raw
        assert kind == self.offered[name][0]
        self.listening[name] = (came, qos)

    def create_publisher(self, kind: str, name: str, qos: Any) -> Any:
        self.own[name] = kind
        self.latched |= {name} if qos.durability is Durability.TRANSIENT_LOCAL else set()
        return SimpleNamespace(
            publish=lambda data: self.published.append((name, kind, data)), get_subscription_count=lambda: 0
        )

    def destroy_node(self) -> None:
        self.listening.clear()

    def destroy_subscription(self, made: None) -> None:
        pass

    def destroy_publisher(self, made: Any) -> None:
        pass

    # of an executor
    def add_node(self, node: Any) -> None:
        pass

    def remove_node(self, node: Any) -> None:
        pass

    def spin_once(self, timeout_sec: float) -> None:
        if self.waiting:
            name, data = self.waiting.popleft()
            if name in self.listening:
                self.listening[name][0](data)
        else:
            time.sleep(min(timeout_sec, 0.001))


class Messages(ModuleType):
    """PKG.msg: a message's class is its name here."""

    def __getattr__(self, name: str) -> str:
        if name.startswith("__"):
            raise AttributeError(name)
        return f"{self.__name__.partition('.')[0]}/msg/{name}"


PACKAGES = (
    "booster_interface",
    "diagnostic_msgs",
    "geometry_msgs",
    "nav_msgs",
    "rosgraph_msgs",
    "sensor_msgs",
    "std_msgs",
    "tf2_msgs",
    "visualization_msgs",
)


@pytest.fixture
def graph(monkeypatch: pytest.MonkeyPatch) -> Graph:
    made = Graph()

    def init() -> None:
        made.running = True

    def shutdown() -> None:
        made.running = False

    contents: dict[str, dict[str, Any]] = {
        "rclpy": {
            "ok": lambda: made.running,
            "init": init,
            "shutdown": shutdown,
            "create_node": lambda name, namespace: made,
        },
        "rclpy.executors": {"SingleThreadedExecutor": lambda: made},
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
    monkeypatch.setattr(ros_link, "SETTLE_S", 0.02)
    monkeypatch.setattr(rclpy_link, "_LOOK_S", 0.01)
    return made


def listened(link: RosLink, until: Callable[[list[Heard]], bool]) -> list[Heard]:
    heard: list[Heard] = []
    ends_s = time.monotonic() + 5.0
    while not until(heard) and time.monotonic() < ends_s:
        heard += link.hear(0.01)
    return heard


def test_topics_are_found_read_as_their_publishers_offer_and_answered(graph: Graph) -> None:
    link, codec = RosLink(Rclpy()), Codec()
    graph.offered = {
        "/odom": ("nav_msgs/msg/Odometry", Reliability.RELIABLE),
        "/image/compressed": ("sensor_msgs/msg/CompressedImage", Reliability.BEST_EFFORT),
        "/tf_static": ("tf2_msgs/msg/TFMessage", Reliability.RELIABLE),
        "/tf": ("tf2_msgs/msg/TFMessage", Reliability.RELIABLE),
        "/imu": ("missing_msgs/msg/Imu", Reliability.RELIABLE),
    }
    listened(link, lambda heard: len(graph.listening) == 4)
    chosen = {name: (qos.reliability, qos.durability) for name, (_, qos) in graph.listening.items()}
    assert chosen == {
        "/odom": (Reliability.RELIABLE, Durability.VOLATILE),
        "/image/compressed": (Reliability.BEST_EFFORT, Durability.VOLATILE),
        "/tf_static": (Reliability.RELIABLE, Durability.TRANSIENT_LOCAL),
        "/tf": (Reliability.RELIABLE, Durability.VOLATILE),
    }
    for out in RosWriter(codec).played(Reading("odometry", 7, (1.0, 2.0, 0.5))):
        graph.waiting.append(("/odom", codec.encode(out.kind, out.message)))
    graph.waiting.append(("/odom", b"\0\1\0\0none"))
    heard = listened(link, lambda heard: bool(heard) and bool(link.refused))
    assert [each.stamp_ns for each in heard if isinstance(each, Reading)] == [7]
    assert any("/odom that can't be used" in what for what in link.refused)
    link.publish(Published(Estimate(9, Pose(1.0, 2.0, 0.5), np.eye(3), Status.TRACKING), image=True))
    told = {name: codec.decode(Topic(name, kind, "cdr", None, 1), data) for name, kind, data in graph.published}
    assert set(told) == {"/touchline/pose", "/tf", "/diagnostics"}
    assert told["/touchline/pose"].pose.pose.position.y == 2.0
    assert graph.latched == {"/touchline/pose", "/touchline/field_lines", "/touchline/map"}
    link.close()
    assert not graph.running


def test_of_several_robots_the_one_of_the_namespace_is_read(graph: Graph) -> None:
    link = RosLink(Rclpy("/robot2"), RosOptions(namespace="/robot2"))
    for name in ("/robot1/odom", "/robot2/odom", "/robot3/odom"):
        graph.offered[name] = ("nav_msgs/msg/Odometry", Reliability.RELIABLE)
    graph.offered["/robot2/initialpose"] = ("geometry_msgs/msg/PoseWithCovarianceStamped", Reliability.RELIABLE)
    listened(link, lambda heard: len(graph.listening) == 2)
    assert set(graph.listening) == {"/robot2/odom", "/robot2/initialpose"}
    assert "/robot2/touchline/pose" in graph.own
    link.close()


def test_without_stamps_the_time_is_that_of_clock_where_there_is_one(graph: Graph) -> None:
    link, codec = RosLink(Rclpy()), Codec()
    graph.offered = {
        "/clock": ("rosgraph_msgs/msg/Clock", Reliability.BEST_EFFORT),
        "/odometer_state": ("booster_interface/msg/Odometer", Reliability.RELIABLE),
    }
    listened(link, lambda heard: len(graph.listening) == 2)
    time_type = codec.make("builtin_interfaces/msg/Time", sec=12, nanosec=5)
    messages = {
        "/clock": codec.make("rosgraph_msgs/msg/Clock", clock=time_type),
        "/odometer_state": codec.make("booster_interface/msg/Odometer", x=1.0, y=0.0, theta=0.0),
    }
    for name in ("/odometer_state", "/clock"):
        graph.waiting.append((name, codec.encode(graph.offered[name][0], messages[name])))
    (reading,) = listened(link, bool)
    assert isinstance(reading, Reading | Sight)
    assert reading.stamp_ns == 12_000_000_005
    link.close()


def test_where_rclpy_is_not_what_to_do_is_told(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rclpy_link, "find_spec", lambda name: None)
    assert main(["live", "--field", "msl-18x12", "--rclpy", "--seconds", "0"]) == 2
    assert "setup.bash" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [(["--dds"], "--dds --rclpy"), (["--namespace", "robot 1"], "letters, digits"), (["--udp", "5000"], "--udp")],
)
def test_options_that_do_not_go_with_it_are_told(
    graph: Graph, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    assert main(["live", "--field", "msl-18x12", "--rclpy", "--seconds", "0", *arguments]) == 2
    assert words in capsys.readouterr().err


def test_the_command_runs_as_a_node(graph: Graph, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["live", "--field", "msl-18x12", "--rclpy", "--namespace", "robot1/", "--seconds", "0.1"]) == 0
    assert "/robot1/touchline/pose" in graph.own
    assert "0 of 0 images looked at" in capsys.readouterr().out


def test_without_tf2_msgs_the_pose_goes_out_and_it_is_said_once(graph: Graph, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "tf2_msgs.msg")
    monkeypatch.delitem(sys.modules, "tf2_msgs")
    link = RosLink(Rclpy())
    estimate = Estimate(7, Pose(1.0, 2.0, 0.5), np.eye(3), Status.TRACKING)
    for _ in range(3):
        link.publish(Published(estimate, Pose(0.0, 0.0, 0.0), image=True))
    assert {name for name, _, _ in graph.published} == {"/touchline/pose", "/diagnostics"}
    assert link.refused == {"a topic of tf2_msgs/msg/TFMessage, whose definition is not installed": 1}
    link.close()
