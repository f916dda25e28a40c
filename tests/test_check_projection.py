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


def change_mount(folder: Path, **changes: float) -> None:
    file = folder / "camera.yaml"
    tree = yaml.safe_load(file.read_text())
    tree["mount"] |= changes
    file.write_text(yaml.safe_dump(tree))


def findings_of(folder: Path, check: str) -> list[Finding]:
    return [finding for finding in check_recording(folder) if finding.check == check]


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
