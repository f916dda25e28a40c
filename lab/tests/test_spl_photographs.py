"""The experiment photographs: what labels tell of a pose, and what it says without photographs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from touchline.camera import GroundView, PinholeCamera
from touchline.field import open_field
from touchline.geometry import Pose, Pose3
from touchline_lab.experiments import EXPERIMENTS
from touchline_lab.experiments.photographs import KNOWN_M, pose_of_labels


def test_labels_of_a_goal_box_far_away_leave_the_pose_open() -> None:
    """Exact labels give it back; how far labels as people set them would move it grows with the distance."""
    mount = Pose3.from_roll_pitch_yaw(0.0, 0.35, 0.0, (0.0, 0.0, 0.5))
    camera = PinholeCamera(640, 480, 550.0, 550.0, 320.0, 240.0, np.zeros(5), mount)
    ends = np.array([[4.5, 0.9], [4.5, -0.5], [3.9, 0.9], [3.9, -0.4], [3.95, 1.1], [4.45, 1.1]])
    errors_m = []
    for x in (2.4, 0.5):
        pose = Pose(x, 0.4, 0.0)
        labels = GroundView(camera).image_from_ground(pose.inverse().transform(ends))
        found = pose_of_labels(camera, open_field("spl-9x6"), labels)
        assert found is not None
        assert min(found[0].distance_to(end) for end in (pose, pose.mirrored())) < 0.01
        errors_m.append(found[1])
    assert errors_m[0] < KNOWN_M < errors_m[1]


def test_without_photographs_it_is_said_what_is_missing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("TOUCHLINE_DATA", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    result = EXPERIMENTS["photographs"].run(1)
    assert not result.rows
    assert "omni, mirror_pixels, humanoid_photos, spl_photos not found; TOUCHLINE_DATA" in result.notes[-1]
