"""Photographs of a real field, where they are found: their lines are found, a white goal is none, poses are right."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from conftest import FULL_DATA

from touchline.camera import GroundView, PinholeCamera
from touchline.field import open_field
from touchline.geometry import FloatArray, Pose, Pose3
from touchline_lab.experiments import EXPERIMENTS
from touchline_lab.experiments.photographs import KNOWN_M, LABELS, aside, measured, pose_of_labels

PHOTOGRAPHS = FULL_DATA / "real" / "spl_photos"
GOAL_FRAMES = Path(__file__).parents[2] / "tests" / "data" / "spl_goal_frames.csv"


def goal_frames() -> dict[str, list[FloatArray]]:
    """Photograph -> its goal's posts and bars (5,): u0, v0, u1, v1 and width (px), outlined by hand."""
    frames: dict[str, list[FloatArray]] = {}
    with GOAL_FRAMES.open() as file:
        for row in csv.reader(list(file)[1:]):
            frames.setdefault(row[0], []).append(np.array(row[1:], dtype=np.float64))
    return frames


def share_on(line: FloatArray, frame: list[FloatArray]) -> float:
    """How much of a line (2, 2) in the image lies on a goal's posts and bars."""
    points = np.linspace(line[0], line[1], 51)
    on = np.zeros(len(points), dtype=np.bool_)
    for u0, v0, u1, v1, width in frame:
        along = np.array([u1 - u0, v1 - v0])
        share = np.clip((points - (u0, v0)) @ along / max(along @ along, 1.0), 0.0, 1.0)
        on |= np.hypot(*(points - (u0, v0) - share[:, np.newaxis] * along).T) <= 0.5 * width
    return float(on.mean())


def labelled_lines_are_found_and_a_white_goal_is_none() -> None:
    """Every sixth of them; `touchline experiment photographs` has the figures of all."""
    frames, angles_deg, gaps_m, goals = goal_frames(), [], [], 0
    seen = measured(PHOTOGRAPHS, every=6)
    for one in seen:
        lines, name = one.observation.lines, one.photograph.name
        goals += any(share_on(line, frames.get(name, [])) > 0.5 for line in lines.pixels)
        off = np.array([[aside(ends, line).max() for line in lines.pixels] for ends in one.photograph.lines])
        if (off.min(axis=1)[:2] > 8.0).any():
            continue
        border, box = (lines.ends_m[int(np.argmin(off[LABELS.index(label)]))] for label in LABELS[:2])
        (ax, ay), (bx, by) = border[1] - border[0], box[1] - box[0]
        angles_deg.append(np.degrees(np.arctan2(abs(ax * by - ay * bx), abs(ax * bx + ay * by))))
        gaps_m.append(float(aside(box.mean(axis=0, keepdims=True), border)[0]))
    assert sum(one.found for one in seen) >= 0.75 * sum(one.marked for one in seen)
    assert np.median(angles_deg) <= 3.0
    assert 0.5 <= np.median(gaps_m) <= 0.65
    assert goals <= 1
    said = [one.said for one in seen]
    assert "refused" not in said
    assert "wrong" not in said
    assert sum(one.off_m < 0.15 for one in seen) >= 5


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


if PHOTOGRAPHS.is_dir():  # they are GPL and none of the project's
    test_labelled_lines_are_found_and_a_white_goal_is_none = labelled_lines_are_found_and_a_white_goal_is_none
