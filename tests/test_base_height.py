"""How high a camera is over the ground, whichever frames a robot's transforms and odometry speak of."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foreign_bags import BASE_FROM_BODY, EPOCH_NS, Message, Types, compressed, foreign_messages, write_foreign
from small_recordings import borrow

from touchline.geometry import Pose3
from touchline.sources import BagOptions, Recording, open_source

IMAGE = "/front/image_raw/compressed"
UP = Pose3(np.eye(3), np.array([0.0, 0.0, BASE_FROM_BODY]))
TF = "tf2_msgs/msg/TFMessage"


@pytest.fixture(scope="module")
def robot(small_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    folder = tmp_path_factory.mktemp("robot") / "robot"
    return open_source(borrow(small_data / "humanoid_hsl_pan", folder, frames=4))


def messages(robot: Recording, types: Types, kind: str) -> Iterator[Message]:
    """A robot whose base_link is its hip; the transforms of its head begin there. No IMU: it leans as its head says."""
    for time_ns, topic, of, message in foreign_messages(robot, types, compressed("jpeg", ".jpg"), IMAGE):
        if topic == "/imu/data":
            continue
        if topic == "/tf_static":
            placed = message.transforms[1:]
            if kind == "footprint above":
                placed = [types.transform(EPOCH_NS, "base_footprint", "base_link", UP), *placed]
            if kind == "footprint below":
                placed = [types.transform(EPOCH_NS, "base_link", "base_footprint", UP.inverse()), *placed]
            yield time_ns, topic, of, types.transforms(*placed)
        elif topic == "/robot/odom" and kind != "odometry by topic":
            if kind in ("footprint below", "hip by transforms", "soles"):
                height_m = 0.0 if kind == "soles" else BASE_FROM_BODY
                hip = types.transform(time_ns, "odom", "base_link", Pose3(np.eye(3), np.array([0.1, 0.0, height_m])))
                yield time_ns, "/tf", TF, types.transforms(hip)
            if kind == "soles":
                yield time_ns, "/tf", TF, types.transforms(*soles(types, time_ns))
            if kind == "footprint above":
                yield time_ns, topic, of, message
        elif topic == "/robot/odom":
            message.child_frame_id = "base_link"
            message.pose.pose.position.z = BASE_FROM_BODY
            yield time_ns, topic, of, message
        else:
            yield time_ns, topic, of, message


def soles(types: Types, time_ns: int) -> Iterator[Any]:
    """One foot stands, the other swings; REP 120 names them."""
    for name, over_m in (("l_sole", 0.0), ("r_sole", 0.05)):
        place = np.array([0.0, 0.1, over_m - BASE_FROM_BODY])
        yield types.transform(time_ns, "base_link", name, Pose3(np.eye(3), place))


KINDS = ("footprint above", "footprint below", "hip by transforms", "odometry by topic", "soles")


@pytest.mark.parametrize("kind", KINDS)
def test_the_camera_of_a_bag_is_over_the_ground(kind: str, robot: Recording, tmp_path: Path) -> None:
    types = Types()
    bag = write_foreign(tmp_path / "walk.mcap", messages(robot, types, kind), types)
    read = open_source(bag, options=BagOptions(field="hsl-s-9x6"))
    frames = list(zip(read, robot, strict=True))
    assert len(frames) == 4
    for found, expected in frames:
        assert found.base_from_camera is not None
        assert expected.base_from_camera is not None
        assert_same(found.base_from_camera, expected.base_from_camera)
    assert 0.8 < read.camera.base_from_camera.translation_m[2] < 1.0


def test_a_base_that_is_named_is_on_the_ground(robot: Recording, tmp_path: Path) -> None:
    types = Types()
    bag = write_foreign(tmp_path / "walk.mcap", messages(robot, types, "hip by transforms"), types)
    named = BagOptions(field="hsl-s-9x6", base="base_link")
    for found, expected in zip(open_source(bag, options=named), robot, strict=True):
        assert found.base_from_camera is not None
        assert expected.base_from_camera is not None
        lower_m = expected.base_from_camera.translation_m[2] - found.base_from_camera.translation_m[2]
        assert abs(lower_m - BASE_FROM_BODY) < 1e-3


def assert_same(found: Pose3, expected: Pose3) -> None:
    np.testing.assert_allclose(found.rotation, expected.rotation, atol=1e-3)
    np.testing.assert_allclose(found.translation_m, expected.translation_m, atol=1e-3)
