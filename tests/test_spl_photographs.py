"""Photographs of a real field, where they are found: their lines are found, a white goal is none, poses are right."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from conftest import FULL_DATA

from touchline.experiments import EXPERIMENTS
from touchline.experiments.photographs import LABELS, aside, measured
from touchline.geometry import FloatArray

PHOTOGRAPHS = FULL_DATA / "real" / "spl_photos"
GOAL_FRAMES = Path(__file__).parent / "data" / "spl_goal_frames.csv"


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


def test_without_photographs_it_is_said_what_is_missing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("TOUCHLINE_DATA", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    result = EXPERIMENTS["photographs"].run(1)
    assert not result.rows
    assert "omni, mirror_pixels, humanoid_photos, spl_photos not found; TOUCHLINE_DATA" in result.notes[-1]


if PHOTOGRAPHS.is_dir():  # they are GPL and none of the project's
    test_labelled_lines_are_found_and_a_white_goal_is_none = labelled_lines_are_found_and_a_white_goal_is_none
