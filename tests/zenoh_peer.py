"""Our Zenoh and zenoh-ros2-sdk's, an independent client of rmw_zenoh_cpp, both ways. `make zenoh`."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from typing import Any

import pytest
from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber

from touchline.live import ros_link, zenoh_link
from touchline.live.heard import Heard, Reading
from touchline.live.ros_link import RosLink, RosRobot
from touchline.live.zenoh_link import Zenoh

COUNT = 30
STRING = {"msg_type": "std_msgs/msg/String", "msg_definition": "string data\n", "domain_id": 6}


@pytest.fixture
def port(monkeypatch: pytest.MonkeyPatch) -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        found = int(server.getsockname()[1])
    monkeypatch.setattr(zenoh_link, "_PORT", found)
    monkeypatch.setattr(ros_link, "SETTLE_S", 0.2)
    monkeypatch.setenv("ROS_DOMAIN_ID", "6")
    return found


def until(done: Callable[[], Any]) -> Any:
    ends_s = time.monotonic() + 20.0
    while not (found := done()) and time.monotonic() < ends_s:
        time.sleep(0.01)
    return found


def test_what_the_sdk_publishes_is_heard_and_what_is_played_it_hears(port: int) -> None:
    link = RosLink(Zenoh())
    talks: Any = ROS2Publisher("/touchline/wheels", router_port=port, **STRING)
    heard: list[Heard] = []
    until(lambda: heard.extend(link.hear(0.01)) or "said" in link.topics)
    time.sleep(0.5)
    for k in range(1, COUNT + 1):
        talks.publish(data=f'{{"kind": "wheels", "stamp_ns": {k}, "values": [1.0, 2.0]}}')
    until(lambda: heard.extend(link.hear(0.05)) or len(heard) == COUNT)
    assert [each.stamp_ns for each in heard if isinstance(each, Reading)] == list(range(1, COUNT + 1))
    talks.close()

    told: list[Any] = []
    listens: Any = ROS2Subscriber("/touchline/wheels", callback=told.append, router_port=port, **STRING)
    robot = RosRobot(Zenoh(name="touchline_play"))
    until(lambda: robot._transport.wanted("/touchline/wheels"))
    for k in range(1, COUNT + 1):
        robot.send(Reading("wheels", k, (1.0, 2.0)))
    until(lambda: len(told) == COUNT)
    stamps = [int(message.data.split('"stamp_ns":')[1].split(",")[0]) for message in told]
    assert stamps == list(range(1, COUNT + 1))
    listens.close()
    robot.close()
    link.close()
