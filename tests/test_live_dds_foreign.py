"""`live --dds` beside a humanoid of Cyclone DDS alone: CameraInfo and TF on the wire, no odometry topic."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("cyclonedds", reason="no wheel of Cyclone DDS for this machine")

from small_recordings import borrow

from touchline.cli import live, main
from touchline.live import ros_link

LOOPBACK = (
    '<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces></General>'
    '<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers></Discovery>'
    "</Domain></CycloneDDS>"
)


@pytest.fixture
def robot(small_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("ROS_DOMAIN_ID", "96")
    monkeypatch.setattr(ros_link, "SETTLE_S", 0.3)
    return borrow(small_data / "humanoid_hsl_pan", tmp_path / "robot", frames=10)


@contextmanager
def publishing(robot: Path, without: str = "") -> Iterator[None]:
    environment = {**os.environ, "CYCLONEDDS_URI": LOOPBACK, "DOMAIN": "96"}
    program = str(Path(__file__).with_name("dds_humanoid.py"))
    process = subprocess.Popen([sys.executable, program, str(robot), without], env=environment)
    try:
        yield
    finally:
        process.kill()
        process.wait()


def counts_of(said: str) -> dict[str, int]:
    """How many images had which status, by what is told at the end."""
    line = next(line for line in said.splitlines() if "looked at" in line)
    parts = line.partition("looked at: ")[2].partition(";")[0].split(", ")
    return {status: int(count) for status, count in (part.split() for part in parts)}


def test_a_humanoid_on_the_wire_needs_no_camera_yaml(robot: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its CameraInfo and TF are the camera and the odometry."""
    with publishing(robot):
        assert main(["live", "--dds", "--field", "hsl-s-9x6", "--own-half", "--seconds", "12"]) == 0
    said = capsys.readouterr()
    counts = counts_of(said.out)
    assert counts["tracking"] >= 6, said
    assert sum(counts.values()) >= 9


def test_without_camera_info_it_is_said_once_and_the_command_fails(
    robot: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with publishing(robot, without="/front/camera_info"):
        assert main(["live", "--dds", "--field", "hsl-s-9x6", "--own-half", "--seconds", "8"]) == 1
    said = capsys.readouterr()
    assert counts_of(said.out)["tracking"] == 0
    problem = "image: no camera model was given, nor came as CameraInfo and transforms"
    assert said.out.splitlines().count(problem) == 1, said
    assert f" × {problem}" in said.out
    assert "no camera is known" in said.err


def test_a_robot_in_another_domain_is_not_heard_and_it_is_said_where_it_was_listened(
    robot: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live, "_SILENT_S", 0.5)
    monkeypatch.setenv("ROS_DOMAIN_ID", "95")
    with publishing(robot):
        assert main(["live", "--dds", "--field", "hsl-s-9x6", "--seconds", "2"]) == 1
    said = capsys.readouterr().err
    assert "domain 95" in said
    assert "--network" in said
