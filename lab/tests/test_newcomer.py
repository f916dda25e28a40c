"""A newcomer's humanoid: its MCAP of images, CameraInfo, TF and Imu becomes poses in two commands."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from foreign_bags import Types, compressed, foreign_messages, write_foreign
from rosbags.highlevel import AnyReader
from small_recordings import borrow

from touchline.cli import main
from touchline.sources import open_source


def test_two_commands_from_a_humanoid_s_mcap_to_poses(
    small_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """No topic of odometry, no camera.yaml: what moves the robot is unknown, what its head does stands in TF."""
    robot = open_source(borrow(small_data / "humanoid_hsl_pan", tmp_path / "robot", frames=12))
    types = Types()
    messages = foreign_messages(robot, types, compressed("jpeg", ".jpg"), "/front/image_raw/compressed")
    bag = write_foreign(tmp_path / "game.mcap", (each for each in messages if each[1] != "/robot/odom"), types)
    monkeypatch.chdir(tmp_path)
    assert main(["check", str(bag), "--field", "hsl-s-9x6"]) in (0, 1)
    assert main(["run", str(bag), "--field", "hsl-s-9x6", "--own-half", "--output", "run"]) == 0
    said = capsys.readouterr()
    assert "Traceback" not in said.err
    assert said.out.count("ms median") == 1  # one figure of speed, named
    assert not any(unit in said.out for unit in ("frames/s", "images/s"))
    poses = [line.split() for line in Path("run/trajectory.tum").read_text().splitlines() if not line.startswith("#")]
    assert len(poses) == len(robot)
    assert float(poses[0][0]) > 1e9  # the bag's own clock
    assert json.loads(Path("run/summary.json").read_text())["frames"] == len(robot)
    truth = robot.truth
    assert truth is not None
    for pose, (x, y, _) in list(zip(poses, truth.poses, strict=False))[6:]:
        assert abs(float(pose[1]) - x) + abs(float(pose[2]) - y) < 0.3
    on_its_clock = [f"{pose[0]} {x} {y} 0 0 0 0 1" for pose, (x, y, _) in zip(poses, truth.poses, strict=True)]
    Path("truth.tum").write_text("\n".join(on_its_clock))
    capsys.readouterr()
    assert main(["evaluate", "run", "--truth", "truth.tum"]) == 0
    assert f"{len(robot)} frames counted" in capsys.readouterr().out
    assert main(["convert", "run", "results.mcap"]) == 0
    with AnyReader([Path("results.mcap")]) as reader:
        topics = {connection.topic for connection in reader.connections}
        wanted = [connection for connection in reader.connections if connection.topic == "/touchline/look"]
        heads = [reader.deserialize(data, one.msgtype) for one, _, data in reader.messages(wanted)]
    shown = {"pose", "path", "hypotheses", "particles", "field_lines", "map", "lines_seen", "overlay/compressed"}
    assert {"/tf", "/diagnostics", "/touchline/look", *(f"/touchline/{name}" for name in shown)} <= topics
    assert len(heads) == len(robot)
    bearings = [2.0 * math.atan2(head.pose.orientation.z, head.pose.orientation.w) for head in heads]
    assert all(abs(bearing) < math.radians(91.0) for bearing in bearings)
    assert {head.header.frame_id for head in heads} == {"base_footprint"}
