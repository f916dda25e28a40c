"""Bags of other robots: topics found by type, frames and cameras from the messages, images of every encoding."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from foreign_bags import EPOCH_NS, Image, Types, compressed, foreign_messages, raw, write_foreign
from small_recordings import borrow

from touchline.cli import main
from touchline.errors import InputError
from touchline.sources import BagOptions, Recording, open_source
from touchline.types import Samples

FIELD = BagOptions(field="spl-9x6")
BGR8 = raw("bgr8", lambda pixels: pixels)


@pytest.fixture(scope="session")
def robot(small_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """What the robot saw and measured, as a folder."""
    folder = tmp_path_factory.mktemp("robot") / "robot"
    return open_source(borrow(small_data / "humanoid_hsl_pan", folder, frames=4))


def foreign(robot: Recording, path: Path, image: Image = BGR8, topic: str = "/front/image_raw") -> Path:
    types = Types(ros1=path.suffix == ".bag")
    return write_foreign(path, foreign_messages(robot, types, image, topic), types)


def assert_close(found: Samples | None, expected: Samples | None) -> None:
    assert found is not None
    assert expected is not None
    shift = EPOCH_NS % 10**9  # times count from the first whole second
    assert np.array_equal(found.stamp_ns, expected.stamp_ns + shift)
    assert np.allclose(found.values, expected.values, atol=1e-9)


@pytest.mark.parametrize("name", ["bag", "robot.mcap", "robot.bag"])
def test_a_foreign_bag_is_read_as_the_folder_of_the_same_robot(name: str, robot: Recording, tmp_path: Path) -> None:
    bag = open_source(foreign(robot, tmp_path / name), options=FIELD)
    assert [str(problem) for problem in bag.problems] == []
    frames = list(bag)
    assert len(frames) == len(robot)
    for found, expected in zip(frames, robot, strict=True):
        assert found.stamp_ns == expected.stamp_ns + EPOCH_NS % 10**9
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
    "bgra8": (raw("bgra8", lambda pixels: cv2.cvtColor(pixels, cv2.COLOR_BGR2BGRA)), 0.0),
    "bayer_rggb8": (raw("bayer_rggb8", rggb), 8.0),
    "yuv422_yuy2": (raw("yuv422_yuy2", lambda pixels: cv2.cvtColor(pixels, cv2.COLOR_BGR2YUV_YUYV)), 8.0),
    "jpeg": (compressed("bgr8; jpeg compressed bgr8", ".jpg"), 5.0),
    "png": (compressed("rgb8; png compressed bgr8", ".png"), 0.0),
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


def test_gray_images_are_gray(robot: Recording, tmp_path: Path) -> None:
    bag = open_source(foreign(robot, tmp_path / "robot.mcap", raw("mono8", GRAY)), options=FIELD)
    frame = next(iter(bag))
    assert frame.image is not None
    assert np.array_equal(frame.image[..., 1], GRAY(next(iter(robot)).image))


def test_a_foreign_bag_becomes_a_folder_with_the_same_pixels(robot: Recording, tmp_path: Path) -> None:
    bag, folder = foreign(robot, tmp_path / "bag"), tmp_path / "folder"
    assert main(["convert", str(bag), str(folder), "--field", "spl-9x6"]) == 0
    pairs = zip(open_source(folder), robot, strict=True)
    assert all(np.array_equal(found.image, expected.image) for found, expected in pairs)


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
