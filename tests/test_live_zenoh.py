"""ROS 2 over Zenoh without ROS: what rmw_zenoh_cpp has on the wire, and a robot's messages there and back."""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytest.importorskip("zenoh", reason="pip install 'touchline[zenoh]'")

import zenoh
import zenoh.ext

from touchline.geometry import Pose
from touchline.live import ros_link, zenoh_link
from touchline.live.heard import Heard, Published, Reading
from touchline.live.ros_link import RosLink, RosOptions, RosRobot
from touchline.live.zenoh_link import Zenoh
from touchline.types import Estimate, Status

IMAGE_HASH = "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47"  # `ros2 topic info -v` shows it


@pytest.fixture(autouse=True)
def alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """A router of its own, and no long waits."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        monkeypatch.setattr(zenoh_link, "_PORT", server.getsockname()[1])
    monkeypatch.setattr(ros_link, "SETTLE_S", 0.1)
    monkeypatch.setenv("ROS_DOMAIN_ID", "5")


def until(done: Callable[[], Any]) -> Any:
    ends_s = time.monotonic() + 10.0
    while not (found := done()) and time.monotonic() < ends_s:
        time.sleep(0.01)
    return found


def test_types_have_the_versions_that_ros_computes() -> None:
    assert zenoh_link._hash("sensor_msgs/msg/Image") == IMAGE_HASH
    assert zenoh_link._hash("booster_interface/msg/Odometer") == "TypeHashNotSupported"


def test_a_recording_that_is_played_is_heard() -> None:
    link = RosLink(Zenoh())
    robot = RosRobot(Zenoh(name="touchline_play"))
    heard: list[Heard] = []
    assert until(lambda: heard.extend(link.hear(0.01)) or "odometry" in link.topics)
    until(lambda: robot._transport.wanted("/odom"))
    for k in range(1, 21):
        robot.send(Reading("odometry", k, (0.1 * k, 0.0, 0.5)))
    until(lambda: heard.extend(link.hear(0.05)) or len(heard) == 20)
    assert [each.stamp_ns for each in heard if isinstance(each, Reading)] == list(range(1, 21))
    robot.close()
    link.close()


def test_a_peer_of_zenoh_alone_sees_what_rmw_zenoh_would() -> None:
    """Keys, attachment and tokens, by the library and nothing of Touchline; the latched pose comes to who is late."""
    link = RosLink(Zenoh("/robot1"), RosOptions(namespace="/robot1"))
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["tcp/127.0.0.1:{zenoh_link._PORT}"]')
    link.publish(Published(Estimate(9, Pose(1.0, 2.0, 0.5), np.eye(3), Status.TRACKING), image=True))
    with zenoh.open(config) as peer:
        found: list[Any] = []
        key = "5/robot1/touchline/pose/geometry_msgs::msg::dds_::PoseWithCovarianceStamped_/*"
        history = zenoh.ext.HistoryConfig(detect_late_publishers=True)
        reader = zenoh.ext.declare_advanced_subscriber(peer, key, found.append, history=history)
        assert until(lambda: found)
        tokens = [str(reply.ok.key_expr) for reply in peer.liveliness().get("@ros2_lv/5/**") if reply.ok]
        said = b"\0\1\0\0" + struct.pack("<iI", 3, 7)
        name = "5/clock/rosgraph_msgs::msg::dds_::Clock_/TypeHashNotSupported"
        token = peer.liveliness().declare_token(
            f"@ros2_lv/5/{peer.zid()}/0/1/MP/%/%/sim/%clock/rosgraph_msgs::msg::dds_::Clock_/TypeHashNotSupported/::,10:,:,:,,"
        )
        until(lambda: link.hear(0.01) or "clock" in link.topics)
        time.sleep(0.2)
        peer.put(name, said)
        assert until(lambda: link.hear(0.02) or link._reader._clock_ns) == 3_000_000_007
        token.undeclare()
        reader.undeclare()
    sample = found[0]
    number, stamp_ns, length = struct.unpack_from("<qqB", sample.attachment.to_bytes())
    assert (number, length, len(sample.attachment.to_bytes())) == (1, 16, 33)
    assert abs(stamp_ns - time.time_ns()) < 60 * 10**9
    assert str(sample.key_expr).split("/")[-1].startswith("RIHS01_")
    assert any("/NN/%/%robot1/touchline" in token for token in tokens)
    of_pose = [token for token in tokens if "/MP/%/%robot1/touchline/%robot1%touchline%pose/" in token]
    assert [token.endswith(":1:,1:,:,:,,") for token in of_pose] == [True]
    link.close()
