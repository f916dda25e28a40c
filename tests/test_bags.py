"""Bags: a recording goes through each kind and comes back as it was; what is cut off is read up to the cut."""

from __future__ import annotations

import contextlib
import filecmp
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader
from small_recordings import borrow

from touchline.api import prepare
from touchline.camera import FisheyeCamera
from touchline.cli import main
from touchline.errors import InputError
from touchline.evaluation import Run
from touchline.geometry import Pose
from touchline.sources import BagOptions, Recording, open_source
from touchline.sources.bags.with_rosbags import Codec
from touchline.sources.bags.writing import McapWriter, write_recording
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
def match(small_data: Path) -> Path:
    """Half a minute of a robot, as its detector saw it."""
    return small_data / "omni_9x6_points"


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["mcap", "rosbag2"])
def test_the_trajectory_is_the_same_bit_for_bit(kind: str, match: Path, tmp_path: Path) -> None:
    bag = convert(match, tmp_path / KINDS[kind], "--to", kind)
    assert poses(bag) == poses(convert(bag, tmp_path / "back"))


def test_a_cut_mcap_gives_the_frames_before_the_cut(walk: Path, tmp_path: Path) -> None:
    whole = convert(walk, tmp_path / "whole.mcap")
    data = whole.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    cut = open_source(tmp_path / "cut.mcap")
    assert 2 <= len(cut) <= 8
    assert str(cut.problems[0]).startswith(f"cut.mcap: ends early, at byte {len(data) // 2}: ")
    expected = [contents(frame) for frame in open_source(whole)][: len(cut)]
    assert [contents(frame) for frame in cut] == expected


def without_own_topics(source: Recording, bare: Path) -> Path:
    """A bag of what ROS has messages for, and of nothing else."""
    codec = Codec()
    writer = McapWriter(bare, codec)

    class Bare:
        def write(self, topic: str, kind: str, log_ns: int, data: bytes) -> None:
            if not topic.startswith("/touchline/"):
                writer.write(topic, kind, log_ns, data)

        def close(self) -> None:
            writer.close()

    write_recording(source, Bare(), codec)
    return bare


def test_a_fisheye_goes_through_camera_info_and_comes_back(walk: Path, tmp_path: Path) -> None:
    folder = tmp_path / "fisheye"
    shutil.copytree(walk, folder)
    about = yaml.safe_load((folder / "camera.yaml").read_text())
    kept = {key: about[key] for key in ("width", "height", "fx", "fy", "cx", "cy", "mount")}
    lens = {"model": "fisheye", "distortion": [-0.02, 0.003, -0.001, 0.0002], **kept}
    (folder / "camera.yaml").write_text(yaml.safe_dump(lens))
    sequence = (folder / "sequence.yaml").read_text()
    assert "camera: pinhole" in sequence
    (folder / "sequence.yaml").write_text(sequence.replace("camera: pinhole", "camera: fisheye"))
    (folder / "camera_pose.csv").unlink()
    source = open_source(folder)
    whole = convert(folder, tmp_path / "whole.mcap")
    with AnyReader([whole]) as reader:
        infos = [c for c in reader.connections if c.topic == "/camera/camera_info"]
        info = next(reader.deserialize(data, c.msgtype) for c, _, data in reader.messages(infos))
    assert (info.distortion_model, info.d.tolist()) == ("equidistant", lens["distortion"])
    assert_same_folder(convert(whole, tmp_path / "back"), folder)
    read = open_source(without_own_topics(source, tmp_path / "bare.mcap"), options=BagOptions(field="spl-9x6"))
    assert read.camera_kind == "fisheye"
    assert isinstance(read.camera, FisheyeCamera)
    assert isinstance(source.camera, FisheyeCamera)
    for name in ("width", "height", "fx", "fy", "cx", "cy"):
        assert getattr(read.camera, name) == getattr(source.camera, name)
    assert read.camera.distortion.tolist() == lens["distortion"]
    found, wanted = read.camera.base_from_camera, source.camera.base_from_camera
    assert np.allclose(found.rotation, wanted.rotation, atol=1e-9)
    assert np.allclose(found.translation_m, wanted.translation_m, atol=1e-9)


@pytest.mark.slow
def test_results_are_written_with_map_to_odom(match: Path, tmp_path: Path) -> None:
    bag = convert(match, tmp_path / "match.mcap")
    assert main(["run", str(bag), "--output", str(tmp_path / "run")]) == 0
    results = convert(tmp_path / "run", tmp_path / "results.mcap")
    estimates, found = Run(tmp_path / "run").estimates, 0
    with AnyReader([results]) as reader:
        messages = [(c.topic, reader.deserialize(data, c.msgtype)) for c, _, data in reader.messages()]
    poses_told = [message for topic, message in messages if topic == "/touchline/pose"]
    placed = [message.transforms[0] for topic, message in messages if topic == "/tf"]
    moves = [move for move in placed if move.header.frame_id == "map"]
    assert [move.child_frame_id for move in placed if move.header.frame_id == "odom"] == ["base_footprint"] * len(moves)
    assert len(poses_told) == len(moves) == len(estimates)
    for frame, pose, move in zip(open_source(match), poses_told, moves, strict=True):
        at = pose.pose.pose
        told = Pose(at.position.x, at.position.y, 2 * np.arctan2(at.orientation.z, at.orientation.w))
        assert (move.header.frame_id, move.child_frame_id) == ("map", "odom")
        place, turn = move.transform.translation, move.transform.rotation
        map_from_odom = Pose(place.x, place.y, 2 * np.arctan2(turn.z, turn.w))
        if frame.odometry is not None and frame.odometry.stamp_ns[-1] == frame.stamp_ns:
            assert told.distance_to(map_from_odom.compose(Pose(*frame.odometry.values[-1]))) < 1e-9
            found += 1
    assert found
    levels = {message.status[0].message for topic, message in messages if topic == "/diagnostics"}
    assert "tracking" in levels


@pytest.mark.parametrize("name", ["bag.mcap", "bag"])
def test_damage_is_told_or_refused_and_never_a_crash(name: str, walk: Path, tmp_path: Path) -> None:
    whole = convert(walk, tmp_path / name, *(["--to", "rosbag2"] if name == "bag" else []))
    file = whole if whole.is_file() else next(whole.glob("*.db3"))
    data, rng = file.read_bytes(), np.random.default_rng(3)
    for trial in range(6):
        broken = bytearray(data)
        for at in rng.integers(0, len(data), 1 + 20 * (trial % 3)):
            broken[at] = int(rng.integers(256))
        file.write_bytes(bytes(broken[: len(data) if trial % 2 else int(rng.integers(len(data)))]))
        with contextlib.suppress(InputError):
            for frame in open_source(whole):
                assert frame.image is None or frame.image.shape == (480, 752, 3)


def test_without_the_extra_it_is_named(walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = convert(walk, tmp_path / "bag.mcap")
    monkeypatch.setattr("touchline.sources.bags.kinds.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install 'touchline\[bags\]'"):
        open_source(bag)
