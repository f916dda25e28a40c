"""A tilted mirror shows itself in the bend of the lines."""

from __future__ import annotations

import math

import numpy as np
import pytest

from touchline.field import open_field
from touchline.geometry import FloatArray, Pose
from touchline.localization.registration import learned_mirror
from touchline.localization.registration.learned_mirror import LearnedMirror
from touchline.published.nubot.compass_correction import CompassCorrection
from touchline.published.nubot.match_input import MatchInput, refine_with_tilt
from touchline.published.nubot.matcher import Matcher
from touchline.types import LinePoints

FIELD = open_field("msl-18x12")
HEIGHT_M = 0.75


def seen(pose: Pose, reach_m: float = 6.0) -> FloatArray:
    """Points (N, 2) of the lines within reach, robot frame."""
    points = np.concatenate([line[::4] for line in FIELD.polylines()])
    robot = pose.inverse().transform(points)
    return robot[np.hypot(*robot.T) < reach_m]


def tilted(positions_m: FloatArray, axis: float, angle_rad: float) -> FloatArray:
    """What a camera reports whose rays, from HEIGHT_M above the robot, are turned by an angle about a ground axis."""
    rays = np.column_stack((positions_m, np.full(len(positions_m), -HEIGHT_M)))
    k = np.array([math.cos(axis), math.sin(axis), 0.0])
    turned = (
        rays * math.cos(angle_rad)
        + np.cross(k, rays) * math.sin(angle_rad)
        + np.outer(rays @ k, k) * (1.0 - math.cos(angle_rad))
    )
    return turned[:, :2] * (HEIGHT_M / -turned[:, 2:])


def line_points(positions_m: FloatArray, noise_m: float = 0.0) -> LinePoints:
    n = len(positions_m)
    noise = np.random.default_rng(3).normal(0.0, noise_m, (n, 2)) if noise_m else 0.0
    ranges = np.hypot(*positions_m.T)
    covariances = (0.01 + 0.003 * ranges**2)[:, None, None] ** 2 * np.eye(2)
    return LinePoints(positions_m + noise, covariances, np.ones(n), np.full((n, 2), np.nan))


def errors_of(tilt: LearnedMirror, points: LinePoints, pose: Pose) -> FloatArray:
    """The errors (5,) of a frame, learned as well."""
    fit = tilt.update(points, pose)
    assert fit is not None
    return fit.errors


@pytest.mark.parametrize("axis", [0.0, 1.1, -2.5])
def test_a_tilt_is_found_and_taken_out(axis: float) -> None:
    pose = Pose(2.0, 1.5, 0.7)
    true = seen(pose)
    tilt = LearnedMirror(FIELD)
    wrong = line_points(tilted(true, axis, math.radians(0.5)), noise_m=0.005)
    bend = errors_of(tilt, wrong, Pose(2.05, 1.45, 0.72))
    before = np.abs(wrong.positions_m - true).max()
    after = np.abs(tilt.corrected(wrong.positions_m, bend) - true)
    assert before > 0.3
    assert np.median(after) < 0.01
    assert after.max() < 0.06


def test_the_mean_tilt_is_learned_and_vibration_is_followed() -> None:
    pose = Pose(-3.0, 0.5, 0.2)
    rng = np.random.default_rng(5)
    tilt = LearnedMirror(FIELD)
    true = seen(pose)
    bends = []
    for _ in range(60):
        shake = math.radians(0.1) * rng.normal()
        wrong = line_points(tilted(true, 0.4, math.radians(0.4) + shake), noise_m=0.005)
        bend = errors_of(tilt, wrong, pose)
        bends.append(bend[:2])
        assert np.median(np.abs(tilt.corrected(wrong.positions_m, bend) - true)) < 0.01
    np.testing.assert_allclose(tilt.mean[:2], np.mean(bends, axis=0), atol=0.0008)
    assert np.trace(tilt.covariance[:2, :2]) < 1e-5


def test_an_upright_mirror_stays_upright() -> None:
    pose = Pose(4.0, -2.0, 2.0)
    bend = errors_of(LearnedMirror(FIELD), line_points(seen(pose), noise_m=0.01), pose)
    assert np.abs(bend).max() < 0.001


def test_one_straight_line_alone_moves_the_tilt_little() -> None:
    y = np.linspace(-2.0, 2.0, 40)
    ahead = np.column_stack((np.full(40, 2.0), y))
    pose = Pose(6.9375, 0.0, 0.0)  # 2 m before the goal line
    tilt = LearnedMirror(FIELD)
    bend = errors_of(tilt, line_points(ahead, noise_m=0.01), pose)
    assert np.hypot(*bend[:2]) < 0.01


def test_reset_forgets() -> None:
    tilt = LearnedMirror(FIELD)
    pose = Pose(2.0, 1.5, 0.7)
    tilt.update(line_points(tilted(seen(pose), 0.0, 0.01)), pose)
    assert np.any(tilt.mean[:2] != 0.0)
    tilt.reset()
    np.testing.assert_array_equal(tilt.mean[:2], [0.0, 0.0])


def test_a_frame_among_whose_points_many_lie_on_no_line_has_its_tilt_taken_out_all_the_same() -> None:
    """The lines of a field beside and nets made up so much of the error that a shaking frame was fused as it came."""
    pose, rng = Pose(4.0, 5.0, 0.0), np.random.default_rng(2)
    true = seen(pose)
    beside = np.column_stack((rng.uniform(-4.0, 4.0, len(true) // 5), rng.uniform(4.0, 5.0, len(true) // 5)))
    points = line_points(np.concatenate((tilted(true, 0.3, math.radians(0.4)), beside)), noise_m=0.005)
    weights = np.full(len(points), 1.0 / len(points))
    matcher, tilt = Matcher(FIELD.distance_map()), LearnedMirror(FIELD)
    for _ in range(5):
        tilt.update(line_points(true, noise_m=0.005), pose)
    view = MatchInput(points, weights, True, None, tilt, CompassCorrection())
    start, error, _ = matcher.descend(points.positions_m, weights, pose.as_array())
    assert error > 0.1
    assert Pose(*start.tolist()).distance_to(pose) > 0.03
    assert refine_with_tilt(matcher, view, start, error).pose.distance_to(pose) < 0.01


def test_a_swing_far_beyond_the_mean_is_followed_in_one_frame() -> None:
    pose, tilt = Pose(-3.0, 0.5, 0.2), LearnedMirror(FIELD)
    true = seen(pose, 7.0)
    for _ in range(30):
        tilt.update(line_points(true, noise_m=0.005), pose)
    swung = tilted(true, 0.4, math.radians(0.9))
    bend = errors_of(tilt, line_points(swung, noise_m=0.005), Pose(-3.1, 0.55, 0.2))
    assert np.median(np.abs(tilt.corrected(swung, bend) - true)) < 0.012


def test_a_mount_that_loosens_keeps_the_mean_tilt_open(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(learned_mirror, "DRIFT", 0.4)
    pose, tilt = Pose(1.0, 0.5, 0.2), LearnedMirror(FIELD)
    points = line_points(seen(pose), noise_m=0.005)
    for _ in range(10):
        tilt.update(points, pose)
    assert np.all(np.diag(tilt.covariance)[:2] >= 0.002**2)


def test_rays_from_one_focus_that_turn_move_the_point_below_it_too() -> None:
    angle = math.radians(0.5)
    positions = np.array([[0.0, 0.0], [2.0, -1.0], [0.5, 3.0]])
    seen_askew = tilted(positions, 0.3, -angle)
    bend = angle / HEIGHT_M * np.array([math.sin(0.3), -math.cos(0.3), 0.0, 0.0, 0.0])
    mirror = LearnedMirror(FIELD)
    back = [np.abs(mirror.corrected(seen_askew, sign * bend) - positions).max() for sign in (1.0, -1.0)]
    assert min(back) < 0.001
    assert np.hypot(*mirror.corrected(positions[:1], bend)[0]) == pytest.approx(HEIGHT_M * angle)
