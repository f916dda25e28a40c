"""Bags of other robots: topics found by type, frames and cameras from the messages, images of every encoding."""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from foreign_bags import EPOCH_NS, Image, Message, Types, cloud, compressed, foreign_messages, raw, write_foreign
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from small_recordings import borrow

from touchline.errors import InputError
from touchline.geometry import Pose3
from touchline.sources import BagOptions, Recording, open_source
from touchline.sources.bags.messages import Topic
from touchline.sources.bags.with_rosbags import BadMessageError, Codec, RosbagsBag
from touchline.sources.problems import ProblemLog
from touchline.types import Samples

FIELD = BagOptions(field="spl-9x6")
SAME_NS = 250  # of an epoch's stamps read as seconds
BGR8 = raw("bgr8", lambda pixels: pixels)


@pytest.fixture(scope="session")
def robot(small_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """What the robot saw and measured, as a folder."""
    folder = tmp_path_factory.mktemp("robot") / "robot"
    return open_source(borrow(small_data / "humanoid_hsl_pan", folder, frames=3))


def foreign(robot: Recording, path: Path, image: Image = BGR8, topic: str = "/front/image_raw") -> Path:
    types = Types(ros1=path.suffix == ".bag")
    return write_foreign(path, foreign_messages(robot, types, image, topic), types)


def assert_close(found: Samples | None, expected: Samples | None) -> None:
    assert found is not None
    assert expected is not None
    assert np.allclose(found.stamp_ns - EPOCH_NS, expected.stamp_ns, atol=SAME_NS)
    assert np.allclose(found.values, expected.values, atol=1e-9)


@pytest.mark.parametrize("name", ["bag", "robot.mcap", "robot.bag"])
def test_a_foreign_bag_is_read_as_the_folder_of_the_same_robot(name: str, robot: Recording, tmp_path: Path) -> None:
    bag = open_source(foreign(robot, tmp_path / name), options=FIELD)
    assert [str(problem) for problem in bag.problems] == []
    frames = list(bag)
    assert len(frames) == len(robot)
    for found, expected in zip(frames, robot, strict=True):
        assert abs(found.stamp_ns - EPOCH_NS - expected.stamp_ns) <= SAME_NS
        assert np.array_equal(found.image, expected.image)
        assert_close(found.odometry, expected.odometry)
        assert_close(found.gyro, expected.gyro)
        assert_close(found.tilt, expected.tilt)
        assert found.compass is None
        assert found.base_from_camera is not None
        assert expected.base_from_camera is not None
        assert np.allclose(found.base_from_camera.rotation, expected.base_from_camera.rotation, atol=1e-9)
        assert np.allclose(found.base_from_camera.translation_m, expected.base_from_camera.translation_m, atol=1e-9)
    assert bag.camera.fx == pytest.approx(robot.camera.fx)
    assert bag.image(2) is not None
    assert bag.sequence["topics"]["odometry"] == "/robot/odom"


def rggb(pixels: Any) -> Any:
    mosaic = pixels[..., 1].copy()
    mosaic[::2, ::2], mosaic[1::2, 1::2] = pixels[::2, ::2, 2], pixels[1::2, 1::2, 0]
    return mosaic


GRAY: Callable[[Any], Any] = lambda pixels: cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY)  # noqa: E731
ENCODINGS: dict[str, tuple[Image, float]] = {
    "rgb8": (raw("rgb8", lambda pixels: pixels[..., ::-1]), 0.0),
    "bayer_rggb8": (raw("bayer_rggb8", rggb), 8.0),
    "yuv422_yuy2": (raw("yuv422_yuy2", lambda pixels: cv2.cvtColor(pixels, cv2.COLOR_BGR2YUV_YUYV)), 8.0),
    "bayer png": (compressed("bayer_rggb8; png compressed bayer_rggb8", ".png", rggb), 8.0),
}


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_images_of_every_encoding_are_read(encoding: str, robot: Recording, tmp_path: Path) -> None:
    image, tolerance = ENCODINGS[encoding]
    bag = open_source(foreign(robot, tmp_path / "robot.mcap", image), options=FIELD)
    for found, expected in zip(bag, robot, strict=True):
        assert found.image is not None
        assert expected.image is not None
        assert found.image.shape == expected.image.shape
        assert np.abs(found.image.astype(float) - expected.image).mean() <= tolerance


def test_what_no_bag_says_is_asked_for(robot: Recording, tmp_path: Path) -> None:
    bag = foreign(robot, tmp_path / "robot.mcap")
    with pytest.raises(InputError, match="does not say which field it is from: --field NAME"):
        open_source(bag)
    with pytest.raises(InputError, match=r"image=/font/image_raw: is not in the bag; did you mean '/front/image_raw'"):
        open_source(bag, options=BagOptions({"image": "/font/image_raw"}, "spl-9x6"))
    with pytest.raises(InputError, match="is a nav_msgs/msg/Odometry, expected sensor_msgs/msg/Imu"):
        open_source(bag, options=BagOptions({"compass": "/robot/odom"}, "spl-9x6"))


def test_a_compass_has_to_be_named(robot: Recording, tmp_path: Path) -> None:
    bag = foreign(robot, tmp_path / "robot.mcap")
    frame = next(iter(open_source(bag, options=BagOptions({"compass": "/imu/data"}, "spl-9x6"))))
    assert frame.compass is not None
    assert np.allclose(frame.compass.values, 1.0)


def test_line_points_are_brought_into_the_base_frame(tmp_path: Path) -> None:
    types = Types()
    mount = Pose3.from_roll_pitch_yaw(0.0, 0.0, np.pi / 2, (0.1, 0.0, 0.0))

    def messages() -> Iterator[Message]:
        placed = types.transforms(types.transform(EPOCH_NS, "base_link", "eye", mount))
        yield EPOCH_NS, "/tf_static", "tf2_msgs/msg/TFMessage", placed
        yield cloud(types, EPOCH_NS, "eye", [(1.0, 0.0, 0.0), (0.0, 2.0, 0.0), (np.nan, 0.0, 0.0)])
        yield cloud(types, EPOCH_NS + 10**8, "eye", [])

    first, second = open_source(write_foreign(tmp_path / "lines.mcap", messages(), types), options=FIELD)
    assert first.observation is not None
    assert np.allclose(first.observation.points.positions_m, [(0.1, 1.0), (-1.9, 0.0)], atol=1e-6)
    assert second.observation is not None
    assert len(second.observation.points) == 0


def test_several_files_and_no_metadata_are_one_bag(robot: Recording, tmp_path: Path) -> None:
    """`ros2 bag record` splits long bags, and writes metadata.yaml when it is stopped."""
    (tmp_path / "walk").mkdir()
    whole = list(foreign_messages(robot, Types(), BGR8, "/front/image_raw"))
    for number, part in enumerate(np.array_split(np.arange(len(whole)), 11)):
        write_foreign(tmp_path / "walk" / f"walk_{number}.mcap", iter(whole[i] for i in part), Types())
    frames = list(open_source(tmp_path / "walk", options=FIELD))
    assert np.allclose([frame.stamp_ns - EPOCH_NS for frame in frames], robot.image_stamps, atol=SAME_NS)
    assert all(frame.image is not None for frame in frames)


def test_of_two_cameras_one_is_read_and_the_other_named(robot: Recording, tmp_path: Path) -> None:
    def both() -> Iterator[Message]:
        for message in foreign_messages(robot, Types(), BGR8, "/front/image_raw"):
            yield message
            if message[1] == "/front/image_raw":
                yield (message[0], "/rear/image_raw", *message[2:])

    path = write_foreign(tmp_path / "two.mcap", both(), Types())
    (problem,) = open_source(path, options=FIELD).problems
    assert str(problem).startswith("/front/image_raw: is read as image; there is also /rear/image_raw")
    named = BagOptions({"image": "/rear/image_raw"}, "spl-9x6")
    assert open_source(path, options=named).sequence["topics"]["image"] == "/rear/image_raw"


@pytest.mark.parametrize("change", ["data = 12", "data = 'text'", "timestamp = 1e300", "timestamp = -1"])
def test_a_row_that_is_no_message_ends_what_is_read(change: str, robot: Recording, tmp_path: Path) -> None:
    bag = foreign(robot, tmp_path / "robot")
    with contextlib.closing(sqlite3.connect(next(bag.glob("*.db3")))) as database:
        database.executescript(f"UPDATE messages SET {change} WHERE id > 10")
    problems = ProblemLog()
    messages = list(RosbagsBag([bag], False, problems).messages(["/robot/odom", "/imu/data"]))
    assert all(isinstance(message.data, bytes) for message in messages)
    assert "is damaged" in str(problems[0])


STRING = Codec().encode("std_msgs/msg/String", Codec().make("std_msgs/msg/String", data="here"))


def test_a_definition_runs_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """rosbags writes a type's name into code that it runs, and its grammar has to refuse all but names."""
    monkeypatch.chdir(tmp_path)
    name = "a/msg/B:\n    x = open('trace', 'w')\nclass C"
    with pytest.raises(BadMessageError):
        Codec().decode(
            Topic("/name", name, "cdr", MessageDefinition(MessageDefinitionFormat.MSG, "string data"), 1), STRING
        )
    assert list(tmp_path.iterdir()) == []
