"""A robot without any odometry: what it did since the last image is unknown, and no pose is sure because it is near."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from test_touchline_system import FIELD, errors, frame, seen

from touchline.geometry import Pose
from touchline.systems import RobotSetup
from touchline.systems.touchline import Touchline, TouchlineSettings
from touchline.types import Frame, Prior, Status, WeightedPose


def blind(one: Frame) -> Frame:
    return replace(one, odometry=None, wheels=None)


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
