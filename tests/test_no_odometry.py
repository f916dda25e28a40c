"""A robot without any odometry: what it did since the last image is unknown, and no pose is sure because it is near."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_touchline_system import FIELD, errors, frame, seen

from touchline.evaluation.runner import robot_setup
from touchline.geometry import Pose
from touchline.sources import open_source
from touchline.systems import RobotSetup
from touchline.systems.touchline import Touchline, TouchlineSettings
from touchline.types import Estimate, Frame, Prior, Status, WeightedPose
from touchline_lab.experiments.drives import drive_of, estimates_of
from touchline_lab.experiments.schulz_runs import AS_BUILT, random_areas, start_about, walk

PANNING = AS_BUILT._replace(away_s=0.0, pan_deg=50.0)


def blind(one: Frame) -> Frame:
    return replace(one, odometry=None, wheels=None)


def off_m(estimate: Estimate, truth: list[float]) -> float:
    return math.hypot(estimate.pose.x - truth[0], estimate.pose.y - truth[1])


def test_who_saw_little_for_seconds_is_not_found_at_the_other_end() -> None:
    """Three seconds near a corner, turning: by then its place and heading are known to 0.6 m and 50 degrees, and its
    twin's images fit as well.
    """
    seed = 1001
    walked = walk("hsl-s-9x6", PANNING, seed, 12.0, random_areas("hsl-s-9x6", seed))
    walked = replace(walked, frames=tuple(map(blind, walked.frames)))
    estimates = estimates_of("touchline", walked, 0, prior=Prior(start_about(Pose(*walked.truth[0]), seed)))
    pairs = list(zip(estimates, walked.truth.tolist(), strict=True))
    tracked = [off_m(estimate, truth) for estimate, truth in pairs if estimate.status is Status.TRACKING]
    assert max(tracked) < 0.4
    assert len(tracked) > 0.6 * len(pairs)
    assert pairs[-1][0].status is Status.TRACKING


@pytest.mark.parametrize("unseen", [20, 54])
def test_a_pose_predicted_widely_is_found_again_at_its_end(unseen: int) -> None:
    """Unseen for 2 s it is followed, for 5 s it may stand anywhere about."""
    system = Touchline(RobotSetup(FIELD), TouchlineSettings(), np.random.default_rng(0))
    before, after = Pose(-3.0, 1.0, 0.4), Pose(-2.4, 1.6, 1.6)
    system.reset(Prior(before))
    for k in range(6):
        estimate = system.step(blind(frame(k, seen(before, k))))
    assert estimate.status is Status.TRACKING
    for k in range(6, 6 + unseen):
        estimate = system.step(blind(frame(k, seen(Pose(20.0, 0.0, 0.0), k))))
        assert estimate.pose.distance_to(before) < 0.1
    assert estimate.status is not Status.TRACKING
    found = [system.step(blind(frame(k, seen(after, k)))) for k in range(6 + unseen, 18 + unseen)]
    assert all(errors(one, after)[0] < 0.1 for one in found if one.status is Status.TRACKING)
    assert found[-1].status is Status.TRACKING
    assert (found[-1].end_probability or 0.0) > 0.9


def test_the_end_is_told_by_where_it_was_found_not_by_where_it_drove_since() -> None:
    """Started again, known to a few metres: both ends are likely, and the way from there tells nothing of them."""
    system = Touchline(RobotSetup(FIELD), TouchlineSettings(), np.random.default_rng(0))
    widely = np.diag(np.square([2.5, 2.5, math.pi]))
    system.reset(Prior(poses=(WeightedPose(Pose(2.0, 0.0, 0.0), widely, 0.9),)))
    for k in range(60):
        place = Pose(0.5 - 0.08 * k, 0.5, math.pi)
        estimate = system.step(blind(frame(k, seen(place, k))))
        assert min(errors(estimate, place)[0], errors(estimate, place.mirrored())[0]) < 0.1
        assert estimate.status is not Status.TRACKING
        assert 0.5 <= (estimate.end_probability or 0.0) < 0.7


def test_of_lines_that_are_alike_each_is_followed(shared_data: Path) -> None:
    """One line in sight, a net behind it, and the lines of two areas half a metre apart next to come."""
    source = open_source(shared_data / "humanoid_hsl_pan")
    recorded = drive_of(source, robot_setup(source), tuple(map(blind, source))[:100])
    recorded = replace(recorded, truth=recorded.truth[:100])
    estimates = estimates_of("touchline", recorded, 0, prior=Prior(own_half=True))
    for estimate, truth in zip(estimates, recorded.truth.tolist(), strict=True):
        if estimate.status is Status.TRACKING:
            assert off_m(estimate, truth) < min(0.5, estimate.protection_m or math.inf)
    assert sum(estimate.status is Status.TRACKING for estimate in estimates) > 0.8 * len(estimates)
