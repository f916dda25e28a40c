"""ros/touchline_ros without ROS: the bridge's grammar and its protocol, the node's parameters and their page."""

from __future__ import annotations

import ast
import importlib.util
import socket
import struct
import time
from contextlib import suppress
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from touchline.errors import InputError
from touchline.geometry import Pose
from touchline.live import ros_link
from touchline.live.bridge import Bridge, frame, frames
from touchline.live.heard import Heard, Published, Reading
from touchline.live.ros_link import RosLink
from touchline.live.ros_writer import RosWriter
from touchline.sources.bags.with_rosbags import Codec
from touchline.types import Estimate, Status

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "ros" / "touchline_ros"


def test_the_bridge_keeps_to_python_3_10_and_knows_nothing_of_touchline() -> None:
    text = (PACKAGE / "touchline_ros" / "bridge.py").read_text()
    tree = ast.parse(text, feature_version=(3, 10))
    names = [alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names]
    names += [str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    beside = {"argparse", "contextlib", "importlib", "queue", "socket", "struct", "sys", "threading"}
    assert {name.split(".")[0] for name in names} == beside | {"rclpy"}
    with pytest.raises(SyntaxError):
        ast.parse("try:\n    x\nexcept* ValueError:\n    pass\n", feature_version=(3, 10))


def test_the_page_has_every_parameter_and_the_package_its_programs() -> None:
    file = PACKAGE / "touchline_ros" / "parameters.py"
    spec = importlib.util.spec_from_file_location("touchline_ros_parameters", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    page = (ROOT / "docs" / "how-to-ros.md").read_text()
    missing = [
        each.name for each in module.PARAMETERS if f"| `{each.name}` |" not in page or each.description not in page
    ]
    assert missing == []
    node = (PACKAGE / "touchline_ros" / "node.py").read_text()
    assert [each.name for each in module.PARAMETERS if f'"{each.name}"' not in node] == []
    package = ElementTree.parse(PACKAGE / "package.xml").getroot()
    assert package.findtext("name") == "touchline_ros"
    assert package.findtext("export/build_type") == "ament_python"
    for name in ("node.py", "bridge.py"):
        assert "def main(" in (PACKAGE / "touchline_ros" / name).read_text()


class Ros:
    """The bridge's end of the connection."""

    def __init__(self, link: Bridge) -> None:
        self.socket = socket.create_connection(link.address)
        self.socket.setblocking(False)
        self.received = bytearray()
        self.asked: list[tuple[bytes, str, str, bytes]] = []

    def say(self, *each: bytes) -> None:
        for whole in each:
            self.socket.sendall(whole)

    def listen(self) -> list[tuple[bytes, str, str, bytes]]:
        with suppress(BlockingIOError):
            self.received += self.socket.recv(10_000_000)
        self.asked += list(frames(self.received))
        return self.asked


def test_topics_come_by_the_bridge_and_the_pose_goes_by_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ros_link, "SETTLE_S", 0.02)
    bridge, codec = Bridge(("127.0.0.1", 0)), Codec()
    link = RosLink(bridge)
    (odometry,) = RosWriter(codec).played(Reading("odometry", 7, (1.0, 2.0, 0.5)))
    data = codec.encode(odometry.kind, odometry.message)
    estimate = Estimate(9, Pose(1.0, 2.0, 0.5), np.eye(3), Status.TRACKING)
    for turn in range(2):  # it may be started again
        ros, heard, ends_s = Ros(bridge), list[Heard](), time.monotonic() + 10.0
        ros.say(frame(b"G", "/odom", odometry.kind, b""))
        while not any(ask[:2] == (b"R", "/odom") for ask in ros.listen()) and time.monotonic() < ends_s:
            heard += link.hear(0.01)
        ros.say(frame(b"M", "/odom", odometry.kind, data), frame(b"W", "/touchline/hypotheses", "", b"\1"))
        while not (heard and bridge.wanted("/touchline/hypotheses")) and time.monotonic() < ends_s:
            heard += link.hear(0.01)
        assert [each.stamp_ns for each in heard if isinstance(each, Reading)] == [7], turn
        link.publish(Published(estimate, image=True))
        time.sleep(0.05)
        asked = ros.listen()
        latched = {name for what, name, _, flag in asked if (what, flag) == (b"A", b"\1")}
        assert latched == {"/touchline/pose", "/touchline/field_lines", "/touchline/map"}
        told = {name for what, name, _, _ in asked if what == b"M"}
        assert {"/touchline/pose", "/touchline/hypotheses", "/tf", "/diagnostics"} <= told
        assert "/touchline/particles" not in told  # nobody looks at it
        ros.socket.close()
    link.close()


@pytest.mark.parametrize(
    "bad", [b"GET / HTTP/1.1\r\n\r\n", struct.pack("<IcHH", 4_000_000_000, b"M", 1, 1), frame(b"?", "/x", "y", b"")]
)
def test_what_is_no_bridge_is_let_go(bad: bytes) -> None:
    link = Bridge(("127.0.0.1", 0))
    ros = Ros(link)
    ros.say(bad)
    ends_s = time.monotonic() + 5.0
    while not link.refused and time.monotonic() < ends_s:
        assert list(link.take(time.monotonic() + 0.01)) == []
    assert sum(link.refused.values()) == 1
    assert "no bridge has connected" in link.around()
    link.close()


def test_an_address_that_is_taken_is_told() -> None:
    link = Bridge(("127.0.0.1", 0))
    with pytest.raises(InputError, match="--bridge 127"):
        Bridge(link.address)
    link.close()
