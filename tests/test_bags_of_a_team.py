"""What a team's own bags hold: odometry as TF alone, planes of YUV, no CameraInfo, the clock of the day."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from foreign_bags import EPOCH_NS, Image, Message, Types, cloud, foreign_messages, raw, write_foreign
from small_recordings import borrow

from touchline.checks.check import check_recording
from touchline.cli import main
from touchline.cli.console import print_errors
from touchline.errors import InputError
from touchline.evaluation.metrics import error_table
from touchline.geometry import Pose3
from touchline.sources import BagOptions, Recording, open_source
from touchline.types import Samples

FIELD = BagOptions(field="spl-9x6")
BGR8 = raw("bgr8", lambda pixels: pixels)


@pytest.fixture(scope="session")
def robot(small_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    folder = tmp_path_factory.mktemp("team") / "team"
    return open_source(borrow(small_data / "humanoid_hsl_pan", folder, frames=3))


def bag_of(robot: Recording, path: Path, image: Image = BGR8, without: str = "", frame: str = "") -> Path:
    """frame: that of the base whose odometry goes out as TF instead of as a topic."""
    types = Types()

    def messages() -> Iterator[Message]:
        for time_ns, topic, kind, message in foreign_messages(robot, types, image, "/front/image_raw"):
            if topic == without:
                continue
            if topic == "/robot/odom" and frame:
                place, turn = message.pose.pose.position, message.pose.pose.orientation
                heading = 2.0 * np.arctan2(turn.z, turn.w)
                pose = Pose3.from_roll_pitch_yaw(0.0, 0.0, heading, (place.x, place.y, 0.0))
                placed = types.transforms(types.transform(time_ns, "odom", frame, pose))
                yield time_ns, "/tf", "tf2_msgs/msg/TFMessage", placed
            else:
                yield time_ns, topic, kind, message

    return write_foreign(path, messages(), types)


@pytest.mark.parametrize("name", ["robot.mcap", "bag"])
def test_odometry_that_only_tf_tells_is_an_odometry(name: str, robot: Recording, tmp_path: Path) -> None:
    bag = open_source(bag_of(robot, tmp_path / name, frame="base_footprint"), options=FIELD)
    found, expected = ([frame.odometry for frame in each] for each in (bag, robot))
    for one, other in zip(found[:-1], expected[:-1], strict=True):
        assert one is not None
        assert other is not None
        assert np.allclose(one.values, other.values, atol=1e-6)
        assert np.allclose(one.stamp_ns - EPOCH_NS, other.stamp_ns, atol=250)


def planes(pixels: Any, order: str) -> Any:
    """Brightness, and below it colours beside each other."""
    height, width = pixels.shape[:2]
    i420 = cv2.cvtColor(pixels, cv2.COLOR_BGR2YUV_I420)
    u, v = i420[height:].reshape(2, height // 2, width // 2)
    both = {"uv": (u, v), "vu": (v, u), "full": (u, v)}[order]
    if order == "full":
        both = tuple(cv2.resize(each, (width, height), interpolation=cv2.INTER_NEAREST) for each in both)
        return np.vstack((i420[:height], np.dstack(both).reshape(2 * height, width)))
    return np.vstack((i420[:height], np.dstack(both).reshape(height // 2, width)))


def in_planes(encoding: str, order: str) -> Image:
    def write(types: Types, header: Any, pixels: Any) -> tuple[str, Any]:
        data, kind = planes(pixels, order), "sensor_msgs/msg/Image"
        fields = {"height": pixels.shape[0], "width": pixels.shape[1], "encoding": encoding, "is_bigendian": 0}
        return kind, types.make(kind, header=header, data=data.ravel(), step=data.shape[1], **fields)

    return write


@pytest.mark.parametrize(("encoding", "order"), [("nv12", "uv"), ("nv21", "vu"), ("nv24", "full")])
def test_images_in_planes_are_read(encoding: str, order: str, robot: Recording, tmp_path: Path) -> None:
    bag = open_source(bag_of(robot, tmp_path / "robot.mcap", in_planes(encoding, order)), options=FIELD)
    for found, expected in zip(bag, robot, strict=True):
        assert found.image is not None
        assert expected.image is not None
        assert np.abs(found.image.astype(float) - expected.image).mean() < 8.0


def test_what_is_refused_names_topic_and_message(robot: Recording, tmp_path: Path) -> None:
    bag = open_source(bag_of(robot, tmp_path / "robot.mcap", raw("p010", lambda pixels: pixels)), options=FIELD)
    assert all(frame.image is None for frame in bag)
    first = str(bag.problems[0])
    assert first.startswith("/front/image_raw, message 1 (frame 0): has the encoding 'p010', which is not known")
    assert "nv12" in first


def test_times_are_the_bag_s_own_or_count_from_its_first_second(robot: Recording, tmp_path: Path) -> None:
    path = bag_of(robot, tmp_path / "robot.mcap")
    own, zero = (open_source(path, options=each) for each in (FIELD, BagOptions(field="spl-9x6", from_zero=True)))
    assert np.allclose(own.image_stamps - EPOCH_NS, robot.image_stamps, atol=250)
    assert np.array_equal(zero.image_stamps, robot.image_stamps + EPOCH_NS % 10**9)
    assert BagOptions.from_dict(zero.options.to_dict()) == zero.options


def test_a_bag_with_an_imu_gets_a_note_how_to_name_a_compass(robot: Recording, tmp_path: Path) -> None:
    bag = open_source(bag_of(robot, tmp_path / "robot.mcap"), options=FIELD)
    for _ in bag:
        pass
    assert [str(problem) for problem in bag.problems if "yaw" in str(problem)] == []
    (note,) = (each for each in check_recording(bag) if "yaw" in each.what and each.check == "compass")
    assert (note.severity, note.where) == ("note", "/imu/data")
    assert "--topic compass=/imu/data" in note.advice


def test_a_bag_without_camera_info_says_so(robot: Recording, tmp_path: Path) -> None:
    path = bag_of(robot, tmp_path / "robot.mcap", without="/front/camera_info")
    with pytest.raises(InputError) as refused:
        _ = open_source(path, options=FIELD).camera
    assert str(refused.value) == "robot.mcap: no CameraInfo beside /front/image_raw; --camera FILE gives one"


def test_a_bag_of_points_lacks_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    types = Types()
    rows = [(1.0, 0.2 * k, 0.0) for k in range(8)]
    clouds = (cloud(types, EPOCH_NS + k * 10**8, "base_footprint", rows) for k in range(6))
    path = write_foreign(tmp_path / "points.mcap", clouds, types)
    assert main(["check", str(path), "--field", "spl-9x6"]) in (0, 1)
    assert "sequence.yaml" not in "".join(
        line for line in capsys.readouterr().out.splitlines() if line.startswith(("warning", "error"))
    )
    assert open_source(path, options=FIELD).rate_hz == pytest.approx(10.0)


def test_errors_of_tracked_images_come_first_on_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    stamps, values = np.arange(4) * 10**8, np.zeros((4, 3))
    errors = error_table(Samples(stamps, values), Samples(stamps, values + 0.01), located=np.arange(4) < 3, black_ns=[])
    print_errors(errors)
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].startswith("x, tracked (cm)")
    assert lines[5].startswith("x (cm)")
