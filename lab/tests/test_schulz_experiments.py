"""The experiments of nimbro-lines: short runs of each, and how they count."""

from __future__ import annotations

import math

import numpy as np
import pytest

from touchline.geometry import Pose
from touchline_lab.experiments import (
    schulz_runs,
)
from touchline_lab.experiments.drives import Drive, Track
from touchline_lab.experiments.schulz_runs import IDEAL, right_of, walk


@pytest.fixture(scope="module")
def walked() -> Drive:
    return walk("humanoid-kid-9x6", IDEAL, 3, 8.0)


def test_false_crossings_are_added_in_the_asked_ratio(walked: Drive) -> None:
    true = sum(len(frame.observation.crossings) for frame in walked.frames if frame.observation is not None)
    frames = schulz_runs.with_false_crossings(0.5, walked, 0).frames
    found = sum(len(frame.observation.crossings) for frame in frames if frame.observation is not None)
    assert found == pytest.approx(2 * true, rel=0.25)


def test_a_start_is_near_the_truth_but_not_at_it() -> None:
    truth = Pose(1.0, 2.0, 3.0)
    starts = [schulz_runs.start_about(truth, seed) for seed in range(50)]
    assert 0.2 < max(start.distance_to(truth) for start in starts) <= 0.3
    assert max(abs(start.heading - 3.0) for start in starts) <= math.radians(10.0)


def test_the_time_until_right_asks_for_two_seconds() -> None:
    times = np.arange(0.0, 10.0, 0.5)
    poses = np.zeros((20, 3))
    poses[:6, 0], poses[8, 0] = 1.0, 1.0
    track = Track(times, poses, np.zeros((20, 3)), np.ones(20, dtype=np.bool_))
    assert schulz_runs.time_until_right(track) == pytest.approx(4.5)
    assert schulz_runs.time_until_right(track, 4.0) == pytest.approx(0.5)
    never = Track(times, poses, np.zeros((20, 3)), np.zeros(20, dtype=np.bool_))
    assert math.isinf(schulz_runs.time_until_right(never))
    twins = Track(times, poses * 0.0 + (-1.0, 0.0, math.pi), np.tile((1.0, 0.0, 0.0), (20, 1)), track.tracking)
    assert right_of(schulz_runs.either_end(twins)).all()
