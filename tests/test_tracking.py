"""Kalman fusion: vision decides where lines observe the pose, odometry where they don't; shoves are followed."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from line_scenes import view

from touchline.field import FieldModel, open_field
from touchline.geometry import Pose, wrap_angle
from touchline.localization.registration.learned_mirror import LearnedMirror
from touchline.localization.registration.weights import WeightSettings, range_weights
from touchline.motion.driven import Scales
from touchline.published.nubot.compass_correction import CompassCorrection, CompassSettings
from touchline.published.nubot.match_input import MatchInput
from touchline.published.nubot.matcher import Match, Matcher
from touchline.published.nubot.pose_filter import (
    BETTER_MARGIN,
    Fusion,
    PoseFilter,
    equal_error,
)
from touchline.published.nubot.tracker import Tracker
from touchline.types import points_at

FIELD = open_field("msl-18x12")
STEP = Pose(0.1, 0.0, 0.02)
STEP_NOISE = np.diag([0.01, 0.01, 0.005]) ** 2


def tight(position_m: float = 0.02, heading_rad: float = 0.01) -> np.ndarray:
    return np.diag([position_m, position_m, heading_rad]) ** 2


@settings(deadline=None)
@given(
    x=st.floats(-9, 9), y=st.floats(-6, 6), heading=st.floats(-3.1, 3.1),
    forward=st.floats(-1, 1), left=st.floats(-1, 1), turn=st.floats(-1, 1),
)  # fmt: skip
def test_the_prediction_moves_the_pose_and_carries_its_covariance_along(
    x: float, y: float, heading: float, forward: float, left: float, turn: float
) -> None:
    """The covariance is that of poses moved one by one (to first order)."""
    rng = np.random.default_rng(0)
    start, motion = Pose(x, y, heading), Pose(forward, left, turn)
    one = PoseFilter(start, tight())
    one.predict(motion, STEP_NOISE)
    assert one.pose == start.compose(motion)
    starts = rng.multivariate_normal(start, tight(), 20_000)
    motions = rng.multivariate_normal(motion, STEP_NOISE, 20_000)
    cosine, sine = np.cos(starts[:, 2]), np.sin(starts[:, 2])
    ends = np.column_stack((
        starts[:, 0] + cosine * motions[:, 0] - sine * motions[:, 1],
        starts[:, 1] + sine * motions[:, 0] + cosine * motions[:, 1],
        starts[:, 2] + motions[:, 2],
    ))  # fmt: skip
    np.testing.assert_allclose(one.covariance, np.cov(ends.T), atol=3e-5)


def test_two_equal_opinions_meet_in_the_middle() -> None:
    one = PoseFilter(Pose(1.0, 2.0, 0.1), tight())
    assert one.update(Pose(1.02, 2.0, 0.12), tight())
    assert one.pose == pytest.approx((1.01, 2.0, 0.11))
    np.testing.assert_allclose(one.covariance, tight() / 2)


def test_headings_are_fused_the_short_way_round() -> None:
    one = PoseFilter(Pose(0.0, 0.0, math.pi - 0.01), tight())
    one.update(Pose(0.0, 0.0, -math.pi + 0.01), tight())
    assert abs(wrap_angle(one.pose.heading - math.pi)) < 1e-9


def test_what_the_lines_do_not_observe_stays_with_the_odometry() -> None:
    one = PoseFilter(Pose(1.0, 2.0, 0.0), tight())
    one.update(Pose(4.0, 2.03, 0.0), np.diag([10.0, 0.01, 0.01]) ** 2)
    assert one.pose.x == pytest.approx(1.0, abs=0.001)
    assert one.pose.y == pytest.approx(2.024, abs=0.001)


def test_a_trusted_match_is_followed_at_once() -> None:
    one = PoseFilter(Pose(1.0, 2.0, 0.0), tight(0.01, 0.005))
    assert one.update(Pose(1.25, 1.9, 0.17), tight(0.01, 0.005))
    assert one.pose.distance_to(Pose(1.25, 1.9, 0.17)) < 0.01
    assert abs(one.pose.heading - 0.17) < 0.005


def test_an_untrusted_match_that_contradicts_the_prediction_changes_nothing() -> None:
    one = PoseFilter(Pose(1.0, 2.0, 0.0), tight(0.01, 0.005))
    before = one.covariance.copy()
    assert not one.update(Pose(1.25, 1.9, 0.17), tight(0.01, 0.005), trusted=False)
    assert one.pose == Pose(1.0, 2.0, 0.0)
    np.testing.assert_array_equal(one.covariance, before)


def followed(field: FieldModel, shoves: dict[int, Pose], frames: int, reach_m: float) -> np.ndarray:
    """Errors (frames, 3) along x, y (m) and heading (rad) of matching and fusion on a drive with shoves."""
    rng = np.random.default_rng(7)
    matcher = Matcher(field.distance_map())
    truth = Pose(-4.0, 1.0, 0.0)
    one = PoseFilter(truth, tight())
    errors = []
    for k in range(frames):
        motion = Pose(STEP.x, STEP.y, 0.0 if len(field.segments) == 1 else STEP.heading)
        truth = truth.compose(motion).compose(shoves.get(k, Pose(0, 0, 0)))
        felt = rng.multivariate_normal(motion, STEP_NOISE / 4)
        one.predict(Pose(*map(float, felt)), STEP_NOISE)
        points = view(field, truth, rng, reach_m=reach_m, clutter=0.05 if len(field.segments) > 1 else 0.0)
        match = matcher.match(points, range_weights(points, WeightSettings()), one.pose)
        one.update(match.pose, match.covariance)
        errors.append((one.pose.x - truth.x, one.pose.y - truth.y, wrap_angle(one.pose.heading - truth.heading)))
    return np.array(errors)


def test_the_odometrys_scale_errors_are_found_out() -> None:
    """What comes again in every step is no noise: after 20 m the prediction errs by its noise alone."""
    rng = np.random.default_rng(4)
    one = PoseFilter(Pose(0.0, 0.0, 0.0), tight(), scales=Scales(0.03, 0.03, 0.03))
    truth, told = Pose(0.0, 0.0, 0.0), Pose(0.2, 0.05, 0.1)
    for _ in range(100):
        truth = truth.compose(Pose(0.2 * 1.04, 0.05 * 0.96, 0.1 * 1.03))
        one.predict(told, np.diag([0.003, 0.003, 0.001]) ** 2)
        seen = Pose(*(truth.as_array() + rng.normal(0.0, (0.003, 0.003, 0.001))))
        assert one.update(Pose(seen.x, seen.y, wrap_angle(seen.heading)), tight(0.003, 0.001))
    np.testing.assert_allclose(one.scales, (0.04, -0.04, 0.03), atol=0.01)
    there = one.placed(Pose(3.0, 0.0, 0.0), tight())
    assert there.scales.tolist() == one.scales.tolist()


def on_a_lone_line(tracker: Tracker, pose: Pose, ahead_m: float | None = None) -> tuple[MatchInput, Match]:
    """What is seen of a touch line from a pose, with ten points of a line across it so far ahead, if any; matched."""
    points = np.column_stack((np.linspace(-2.0, 2.0, 40), np.full(40, -1.4375)))
    if ahead_m is not None:
        points = np.concatenate((points, np.column_stack((np.full(10, ahead_m), np.linspace(-0.9, 0.5, 10)))))
    points = points + np.random.default_rng(3).normal(0.0, 0.01, points.shape)
    return seen_from(tracker, pose.inverse().compose(Pose(pose.x, -4.5, 0.0)).transform(points), pose)


def seen_from(tracker: Tracker, points: np.ndarray, pose: Pose) -> tuple[MatchInput, Match]:
    """Points (N, 2) of one frame, all alike and of an upright mirror, and their match from a pose."""
    seen = points_at(points)
    tilt = LearnedMirror(FIELD, enabled=False)
    weights = np.full(len(points), 1.0 / len(points))
    view = MatchInput(seen, weights, True, None, tilt, CompassCorrection(CompassSettings()))
    return view, tracker.matcher.match(seen.positions_m, weights, pose)


def test_one_frames_points_across_a_line_are_no_shove() -> None:
    tracker = Tracker(Matcher(FIELD.distance_map()))
    tracker.start_at(Pose(-3.5, -4.5, 0.0), tight())
    view, match = on_a_lone_line(tracker, Pose(-3.0, -4.5, 0.0), ahead_m=3.0)  # the centre line, half a metre nearer
    shaken = replace(match, covariance=match.covariance + tight(0.1, 0.01))
    assert tracker.fuse(view, shaken) is Fusion.CONTRADICTS
    assert tracker.filter.pose.x == pytest.approx(-3.5, abs=0.05)
    assert tracker.fuse(view, shaken) is Fusion.SHOVED
    assert tracker.filter.pose.x == pytest.approx(-3.0, abs=0.05)


def test_a_lone_line_leaves_what_a_shove_may_have_moved() -> None:
    for frames, along_m in ((1, 0.02), (3, 0.3)):
        tracker = Tracker(Matcher(FIELD.distance_map()))
        tracker.start_at(Pose(-3.5, -4.5, 0.0), tight())
        for _ in range(frames):
            assert tracker.fuse(*on_a_lone_line(tracker, Pose(-3.5, -4.5, 0.5))) is Fusion.CONTRADICTS
        assert tracker.fuse(*on_a_lone_line(tracker, Pose(-3.5, -4.5, 0.0))) is Fusion.SUPPORTS
        deviations = np.sqrt(np.diag(tracker.filter.covariance))
        assert deviations[0] == pytest.approx(along_m, abs=0.01)
        assert deviations[1] < 0.05


def test_small_errors_are_equal_within_a_margin_large_ones_within_a_factor() -> None:
    assert equal_error(0.0) == BETTER_MARGIN > 0.0
    assert equal_error(0.001) == pytest.approx(0.001 + BETTER_MARGIN)
    assert equal_error(0.1) == pytest.approx(0.2)
