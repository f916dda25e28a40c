"""A recording folder becomes frames: lazily, in the order of time, no sample lost or given twice."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from small_recordings import HEIGHT, WIDTH, arc_pose, delete_lines, edit_line, write_recording

from touchline.errors import InputError
from touchline.evaluation import read_tum
from touchline.geometry import Pose
from touchline.sources import ProblemKind, open_source
from touchline.types import Samples

PUBLIC = [
    "humanoid_9x6_walk",
    "omni_9x6_points",
    "omni_calibration",
    "omni_exposure",
    "omni_msl_kidnap",
    "omni_msl_match",
    "omni_msl_sun",
    "omni_msl_track",
]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_recording(tmp_path / "small")


def joined(samples: list[Samples | None]) -> Samples:
    given = [part for part in samples if part is not None]
    return Samples(np.concatenate([part.stamp_ns for part in given]), np.concatenate([part.values for part in given]))


def test_the_heading_of_the_truth_is_that_of_the_whole_quaternion(tmp_path: Path) -> None:
    """A robot that leans by 0.2 rad about its own forward axis keeps its heading."""
    folder = write_recording(tmp_path / "leaning", frames=1)
    yaw, lean = 0.7, 0.2
    cy, sy, cl, sl = math.cos(yaw / 2), math.sin(yaw / 2), math.cos(lean / 2), math.sin(lean / 2)
    (folder / "ground_truth.tum").write_text(f"0.1 1 2 0 {cy * sl:.9f} {sy * sl:.9f} {sy * cl:.9f} {cy * cl:.9f}\n")
    truth = open_source(folder).truth
    assert truth is not None
    assert truth[0] == pytest.approx((1.0, 2.0, yaw), abs=1e-8)
    np.testing.assert_allclose(read_tum(folder / "ground_truth.tum").values, truth.poses, atol=1e-12)


def test_a_frame_holds_its_image_settings_and_name(folder: Path) -> None:
    frames = list(open_source(folder))
    assert [frame.stamp_ns for frame in frames] == [100_000_000 * (index + 1) for index in range(8)]
    assert [frame.name for frame in frames] == [f"images/{index:06d}.jpg" for index in range(8)]
    assert all(frame.image is not None and frame.image.shape == (HEIGHT, WIDTH, 3) for frame in frames)
    assert all(frame.image.dtype == np.uint8 for frame in frames if frame.image is not None)
    assert {(frame.exposure_ms, frame.gain, frame.problem) for frame in frames} == {(12.0, 1.7, None)}


def test_each_frame_carries_the_samples_since_the_frame_before(folder: Path) -> None:
    edit_line(folder / "images.csv", 4, 0, "0.3100")  # between two samples
    frames = list(open_source(folder))
    before = -1
    for frame in frames:
        assert frame.odometry is not None
        assert frame.odometry.stamp_ns[0] > before
        assert frame.odometry.stamp_ns[-1] <= frame.stamp_ns
        before = frame.stamp_ns
    assert frames[0].odometry.stamp_ns[0] == 0  # type: ignore[union-attr]
    assert frames[2].odometry.stamp_ns[-1] == 300_000_000  # type: ignore[union-attr]
    table = np.loadtxt(folder / "odometry.csv", delimiter=",", skiprows=1)
    odometry = joined([frame.odometry for frame in frames])
    expected = table[table[:, 0] <= 0.8 + 1e-9]
    np.testing.assert_array_equal(odometry.stamp_ns, np.rint(expected[:, 0] * 1e9))
    np.testing.assert_array_equal(odometry.values, expected[:, 1:])


def test_imu_columns_become_gyro_compass_and_tilt(folder: Path) -> None:
    frame = next(iter(open_source(folder)))
    assert frame.gyro is not None
    assert frame.compass is not None
    assert frame.tilt is not None
    np.testing.assert_allclose(frame.gyro.values[-1], [0.01, 0.02, 0.5])
    np.testing.assert_allclose(frame.compass.values[-1], [0.05], atol=1e-6)
    np.testing.assert_allclose(frame.tilt.values[-1], [0.001, 0.002])


def test_columns_are_found_by_name_and_others_are_allowed(folder: Path) -> None:
    lines = (folder / "odometry.csv").read_text().splitlines()
    swapped = ["note," + ",".join(lines[0].split(",")[::-1])]
    swapped += ["driving," + ",".join(line.split(",")[::-1]) for line in lines[1:]]
    (folder / "odometry.csv").write_text("\r\n".join(swapped))
    source = open_source(folder)
    last = list(source)[-1]
    assert last.odometry is not None
    np.testing.assert_allclose(last.odometry.values[-1], arc_pose(0.8), atol=1e-6)
    assert source.problems.total == 0


def test_a_sensor_without_a_new_sample_is_none(folder: Path) -> None:
    (folder / "wheels.csv").unlink()
    delete_lines(folder / "imu.csv", 13, 22)  # 0.22 s to 0.40 s
    frames = list(open_source(folder))
    assert all(frame.wheels is None for frame in frames)
    assert [frame.compass is None for frame in frames[:5]] == [False, False, True, True, False]
    assert frames[2].gyro is None
    assert frames[2].tilt is None


def test_only_images_and_sequence_are_needed(folder: Path) -> None:
    for name in ("odometry.csv", "wheels.csv", "imu.csv", "ground_truth.tum"):
        (folder / name).unlink()
    source = open_source(folder)
    assert len(list(source)) == 8
    assert source.truth is None
    assert source.camera_file is None
    assert source.problems.total == 0
    with pytest.raises(InputError, match=r"camera\.yaml: is missing"):
        _ = source.camera


def test_a_single_image_can_be_asked_for(folder: Path) -> None:
    source = open_source(folder)
    frames = list(source)
    np.testing.assert_array_equal(source.image(5), frames[5].image)
    np.testing.assert_array_equal(source.image(-1), frames[7].image)
    with pytest.raises(IndexError):
        source.image(8)


def test_truth_is_found_by_index_and_by_time(folder: Path) -> None:
    truth = open_source(folder).truth
    assert truth is not None
    assert len(truth) == 8
    assert truth[0] == pytest.approx(Pose(*arc_pose(0.1)), abs=1e-5)
    assert truth.nearest(349_000_000) == truth[2]
    assert truth.nearest(351_000_000) == truth[3]
    assert truth.nearest(-5) == truth[0]
    assert truth.nearest(10**12) == truth[7]


def test_a_field_file_beside_the_recording_counts_more_than_the_name(folder: Path, small_data: Path) -> None:
    shutil.copyfile(small_data / "omni_9x6_points" / "field.yaml", folder / "field.yaml")
    assert open_source(folder).field.length == 9.0


def test_without_a_nominal_rate_the_median_one_is_taken_and_reported(tmp_path: Path) -> None:
    source = open_source(write_recording(tmp_path / "r", rate_hz=None))
    assert source.rate_hz == pytest.approx(10.0)
    assert source.problems.counts == {ProblemKind.SEQUENCE: 1}


@pytest.mark.slow
@pytest.mark.parametrize("name", PUBLIC)
def test_public_recordings_are_read_whole_and_without_problems(shared_data: Path, name: str) -> None:
    source = open_source(shared_data / name)
    frames = list(source)
    rows = (shared_data / name / "images.csv").read_text().splitlines()[1:]
    assert [frame.name for frame in frames] == [row.split(",")[1] for row in rows]
    assert source.truth is not None
    np.testing.assert_array_equal(source.truth.stamp_ns, source.image_stamps)
    compass = joined([frame.compass for frame in frames])
    table = np.loadtxt(shared_data / name / "imu.csv", delimiter=",", skiprows=1)
    until_last_image = table[np.rint(table[:, 0] * 1e9) <= source.image_stamps[-1]]
    np.testing.assert_array_equal(compass.values[:, 0], until_last_image[:, 3])
    if name == "omni_exposure":  # 16-bit linear images: said so, not shown
        assert source.linear
        assert source.problems.counts == {ProblemKind.LINEAR_IMAGE: len(frames)}
        assert all(frame.image is None and "16-bit" in (frame.problem or "") for frame in frames)
    else:
        assert source.problems.total == 0
        assert all(frame.image is not None for frame in frames)
