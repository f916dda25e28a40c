"""Bags: a recording goes through each kind and comes back as it was; what is cut off is read up to the cut."""

from __future__ import annotations

import filecmp
from pathlib import Path

import pytest
from small_recordings import borrow

from touchline.api import prepare
from touchline.cli import main
from touchline.sources import open_source
from touchline.types import Frame, Samples

KINDS = {"mcap": "bag.mcap", "rosbag2": "bag", "rosbag2-mcap": "bag"}


def convert(source: Path, target: Path, *options: str) -> Path:
    assert main(["convert", str(source), str(target), *options]) == 0
    return target


def values(samples: Samples | None) -> tuple[bytes, ...] | None:
    return None if samples is None else (samples.stamp_ns.tobytes(), samples.values.tobytes())


def contents(frame: Frame) -> tuple[object, ...]:
    """A frame as what can be compared with ==."""
    image = None if frame.image is None else frame.image.tobytes()
    pose = frame.base_from_camera
    placed = None if pose is None else (pose.rotation.tobytes(), pose.translation_m.tobytes())
    seen = None if frame.observation is None else frame.observation.points.positions_m.tobytes()
    sensors = (frame.odometry, frame.wheels, frame.gyro, frame.compass, frame.tilt)
    return frame.stamp_ns, frame.name, frame.exposure_ms, frame.gain, image, placed, seen, *map(values, sensors)


def all_files(folder: Path) -> list[str]:
    return sorted(str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file())


def assert_same_folder(left: Path, right: Path) -> None:
    assert all_files(left) == all_files(right)
    _, mismatch, errors = filecmp.cmpfiles(left, right, all_files(left), shallow=False)
    assert (mismatch, errors) == ([], [])


def poses(source: Path) -> list[tuple[object, ...]]:
    prepared = prepare(source)
    estimates = [prepared.system.step(frame) for frame in prepared.source]
    return [(e.stamp_ns, *e.pose, e.covariance.tobytes(), e.status) for e in estimates]


@pytest.fixture(scope="session")
def walk(small_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten frames of a robot whose head pans: every table there is but observations.csv."""
    folder = tmp_path_factory.mktemp("walk") / "walk"
    borrow(small_data / "humanoid_hsl_pan", folder, frames=10)
    (folder / "README.md").unlink(missing_ok=True)
    return folder


@pytest.mark.parametrize("kind", KINDS)
def test_a_folder_comes_back_byte_by_byte(kind: str, walk: Path, tmp_path: Path) -> None:
    bag = convert(walk, tmp_path / KINDS[kind], "--to", kind)
    frames = [contents(frame) for frame in open_source(bag)]
    assert frames == [contents(frame) for frame in open_source(walk)]
    assert_same_folder(convert(bag, tmp_path / "back"), walk)


@pytest.fixture(scope="session")
def match(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two seconds of a match, as a detector sees it."""
    folder = tmp_path_factory.mktemp("match") / "match"
    options = ["--level", "points", "--seconds", "2", "--output", str(folder)]
    assert main(["simulate", "match", *options]) == 0
    return folder


@pytest.mark.parametrize("kind", ["mcap", "rosbag2"])
def test_the_trajectory_is_the_same_bit_for_bit(kind: str, match: Path, tmp_path: Path) -> None:
    bag = convert(match, tmp_path / KINDS[kind], "--to", kind)
    assert poses(bag) == poses(match)
    back = convert(bag, tmp_path / "back")
    assert_same_folder(back, match)
    assert poses(back) == poses(match)


def test_a_cut_mcap_gives_the_frames_before_the_cut(walk: Path, tmp_path: Path) -> None:
    whole = convert(walk, tmp_path / "whole.mcap")
    data = whole.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    cut = open_source(tmp_path / "cut.mcap")
    assert 2 <= len(cut) <= 8
    assert str(cut.problems[0]).startswith(f"cut.mcap: ends early, at byte {len(data) // 2}: ")
    expected = [contents(frame) for frame in open_source(whole)][: len(cut)]
    assert [contents(frame) for frame in cut] == expected
