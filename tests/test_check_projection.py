"""Field lines projected at the true poses of a walking humanoid lie on the white ones, and a check tells if not."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from small_recordings import borrow

from touchline.checks.check import check_recording
from touchline.checks.findings import Finding, Severity
from touchline.checks.projection import fitted_turn, line_offsets, project_places
from touchline.geometry import Pose3
from touchline.motion.attitude import with_camera_poses
from touchline.sources import open_source


def change_mount(folder: Path, **changes: float) -> None:
    file = folder / "camera.yaml"
    tree = yaml.safe_load(file.read_text())
    tree["mount"] |= changes
    file.write_text(yaml.safe_dump(tree))


def findings_of(folder: Path, check: str) -> list[Finding]:
    return [finding for finding in check_recording(folder) if finding.check == check]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "raw_px", "turned_deg"),
    [
        ("humanoid_9x6_walk", 4.5, 0.6),  # an IMU's half a degree is 4 px
        ("humanoid_hsl_pan", 11.0, 2.0),  # a head's joints err, too
    ],
)
def test_field_lines_lie_on_the_white_ones_as_far_as_the_sensors_tell(
    shared_data: Path, name: str, raw_px: float, turned_deg: float
) -> None:
    recording = open_source(shared_data / name)
    camera, truth = recording.camera, recording.truth
    assert truth is not None
    step = max(1, len(recording) // 12)
    raw, fitted, turns = [], [], []
    for index, (frame, pose) in enumerate(with_camera_poses(recording, camera)):
        if index % step or frame.image is None:
            continue
        assert pose is not None
        at = truth.nearest(frame.stamp_ns)
        places = project_places(camera, recording.field, at, pose)
        off = line_offsets(frame.image, places)
        turn = fitted_turn(camera, places, off, pose)
        if turn is None:
            continue
        raw.append(np.abs(off[np.isfinite(off)]))
        turns.append(np.degrees(turn))
        righted = pose.compose(Pose3.from_roll_pitch_yaw(*turn))
        off = line_offsets(frame.image, project_places(camera, recording.field, at, righted))
        fitted.append(np.abs(off[np.isfinite(off)]))
    assert len(turns) >= 5
    assert np.median(np.concatenate(raw)) < raw_px
    assert np.median(np.concatenate(fitted)) < 0.5, "what is left without these errors"
    assert np.percentile(np.concatenate(fitted), 90) < 1.5
    assert np.abs(np.median(turns, axis=0)).max() < turned_deg


def test_a_camera_that_is_not_mounted_as_its_file_says_is_found(shared_data: Path, tmp_path: Path) -> None:
    folder = borrow(shared_data / "humanoid_9x6_walk", tmp_path / "walk", frames=12)
    (right,) = findings_of(folder, "projection")
    assert right.severity is Severity.OK
    assert "px from where the true poses put them" in right.what
    change_mount(folder, pitch=0.488692 + math.radians(2.0))
    (wrong,) = findings_of(folder, "projection")
    assert wrong.severity is Severity.WARNING
    assert "the camera is turned by roll" in wrong.what
    assert any(f"pitch {angle:+.1f}°" in wrong.what for angle in np.arange(-2.6, -1.4, 0.1))


def test_without_true_poses_the_mount_is_not_tested(shared_data: Path, tmp_path: Path) -> None:
    folder = borrow(shared_data / "humanoid_9x6_walk", tmp_path / "walk", frames=6)
    (folder / "ground_truth.tum").unlink()
    (finding,) = findings_of(folder, "projection")
    assert finding.severity is Severity.NOTE
    assert "the true poses are not known" in finding.what


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pitch", "z", "severity"),
    [(0.4887, 1.1, Severity.OK), (-0.6, 1.1, Severity.ERROR), (0.4887, 0.07, Severity.WARNING)],
)
def test_what_a_perspective_camera_sees_is_told(
    shared_data: Path, tmp_path: Path, pitch: float, z: float, severity: Severity
) -> None:
    folder = borrow(shared_data / "humanoid_9x6_walk", tmp_path / "walk", frames=4)
    change_mount(folder, pitch=pitch, z=z)
    told = [finding for finding in findings_of(folder, "camera") if finding.severity is severity]
    assert any(f"pinhole, 752×480 pixels, {z:.2f} m high, looking down by" in finding.what for finding in told)
