"""The covariance of a match: honest where lines fix the pose, huge where they don't."""

from __future__ import annotations

import numpy as np
import pytest
from line_scenes import lone_line, view

from touchline.field import FieldModel, open_field
from touchline.geometry import FloatArray, Pose
from touchline.localization.registration.covariance import moments
from touchline.localization.registration.weights import WeightSettings, range_weights
from touchline.published.nubot.matcher import Match, Matcher, MatchingSettings

FIELD = open_field("msl-18x12")


def matched(field: FieldModel, points: FloatArray, start: Pose, settings: MatchingSettings | None = None) -> Match:
    return Matcher(field.distance_map(), settings).match(points, range_weights(points, WeightSettings()), start)


def test_along_a_lone_line_nothing_is_known() -> None:
    pose = Pose(1.0, 0.7, 0.0)
    points = view(lone_line(), pose, np.random.default_rng(1), reach_m=4.0)
    match = matched(lone_line(), points, pose)
    sigma = np.sqrt(np.diag(match.covariance))
    assert sigma[0] > 3.0
    assert sigma[1] < 0.03
    assert sigma[2] < 0.02


@pytest.mark.parametrize("turn", [0.3, 1.2, -2.0])
def test_the_unknown_direction_is_that_of_the_line_in_the_field_whatever_the_heading(turn: float) -> None:
    pose = Pose(1.0, 0.7, turn)
    points = view(lone_line(), pose, np.random.default_rng(1), reach_m=4.0)
    sigma = np.sqrt(np.diag(matched(lone_line(), points, pose).covariance))
    assert sigma[0] > 3.0
    assert sigma[1] < 0.03


def test_stray_points_do_not_fix_what_no_line_observes() -> None:
    """On the full field, seeing only a touch line and 5 % clutter: wherever the clutter pulls, the sum is not sure."""
    rng = np.random.default_rng(6)
    errors, sigmas = [], []
    for _ in range(60):
        pose = Pose(rng.uniform(2.5, 5.0), -4.5, 0.0)
        reach = np.column_stack((rng.uniform(-2.0, 2.0, 60), np.full(60, -1.4375)))  # of the touch line only
        points = reach + rng.normal(0, 0.02, reach.shape)
        stray = rng.random(60) < 0.05
        points[stray] = rng.uniform(-3, 3, (stray.sum(), 2))
        match = matched(FIELD, points, Pose(pose.x + 0.1, pose.y + 0.05, 0.02))
        errors.append(abs(match.pose.x - pose.x))
        sigmas.append(np.sqrt(match.covariance[0, 0]))
    normalized = np.array(errors) / np.array(sigmas)
    assert np.median(sigmas) > 1.0
    assert np.max(normalized) < 3.0


def test_stray_points_do_not_tie_the_heading_to_the_place_along_a_lone_line() -> None:
    """A match may slide along the line by metres: what a pose is moved by to either side then is noise alone."""
    rng = np.random.default_rng(6)
    pose = Pose(3.5, -4.5, 0.0)
    for _ in range(20):
        line = np.column_stack((rng.uniform(-2.0, 2.0, 40), np.full(40, -1.4375)))
        stray = np.column_stack((np.full(3, 5.4375), rng.uniform(1.0, 4.0, 3)))  # of the goal line
        points = np.concatenate((line, stray)) + rng.normal(0, 0.02, (43, 2))
        covariance = matched(FIELD, points, pose).covariance
        assert covariance[0, 0] > 3.0
        assert np.abs(covariance[0, 1:] / covariance[0, 0]).max() < 0.001  # m and rad per metre along the line


def test_on_the_centre_circle_alone_the_heading_is_unknown() -> None:
    field = FieldModel(name="circle", length=18.0, width=12.0, line_width=0.125, circles=np.array([[0.0, 0.0, 2.0]]))
    pose = Pose(0.0, 0.0, 0.3)
    points = view(field, pose, np.random.default_rng(2))
    sigma = np.sqrt(np.diag(matched(field, points, pose).covariance))
    assert sigma[2] > 1.0
    assert max(sigma[:2]) < 0.03


def test_more_points_and_less_noise_make_it_surer() -> None:
    rng = np.random.default_rng(3)
    pose, settings = Pose(3.0, 1.0, 0.2), MatchingSettings()
    sizes = {}
    for name, count, noise in (("plain", 50, 0.02), ("many", 200, 0.02), ("noisy", 50, 0.06)):
        traces = [
            np.trace(matched(FIELD, view(FIELD, pose, rng, count, noise=noise), pose, settings).covariance[:2, :2])
            for _ in range(20)
        ]
        sizes[name] = float(np.mean(traces))
    assert sizes["many"] < sizes["plain"] < sizes["noisy"]


def test_it_is_symmetric_and_positive_definite() -> None:
    rng = np.random.default_rng(4)
    for _ in range(50):
        points = rng.normal(0, 3, (rng.integers(1, 40), 2))
        covariance = matched(FIELD, points, Pose(rng.uniform(-9, 9), rng.uniform(-6, 6), 0.0)).covariance
        np.testing.assert_allclose(covariance, covariance.T)
        assert np.all(np.linalg.eigvalsh(covariance) > 0)


def test_three_points_fix_nothing() -> None:
    covariance = matched(FIELD, np.array([[1.0, 0.0], [0.0, 1.0], [2.0, 2.0]]), Pose(0, 0, 0)).covariance
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), [10.0, 10.0, 3.0])


def test_the_curvature_is_the_second_derivative_of_the_error_where_it_is_positive() -> None:
    """e(t) = 1 - c^2 / (c^2 + t^2), taken off a fine grid of its values."""
    c_m, step_m = 0.25, 1e-4
    distances_m = np.array([0.0, 0.05, 0.1, 0.14, 0.2, 0.6])
    points = np.column_stack((9.0 - distances_m, np.full(6, 4.0)))  # inside of the goal line, far from all others
    weights = np.array([0.1, 0.2, 0.3, 0.2, 0.1, 0.1])
    table = FIELD.distance_map().table
    _, curvature, slope_power, mean_m = moments(points, weights, table, np.zeros(3), c_m)
    seen_m = FIELD.line_distances(points)
    error, derivative, second = ([] for _ in range(3))
    for t in seen_m:
        e = [1.0 - c_m**2 / (c_m**2 + (t + k * step_m) ** 2) for k in (-1, 0, 1)]
        error.append(e[1])
        derivative.append((e[2] - e[0]) / (2.0 * step_m))
        second.append((e[2] - 2.0 * e[1] + e[0]) / step_m**2)
    np.testing.assert_allclose(curvature, weights * np.maximum(second, 0.0), atol=0.05)
    assert slope_power == pytest.approx(float(np.sum((weights * derivative) ** 2)), rel=0.02)
    assert mean_m == pytest.approx(float(weights @ seen_m), abs=0.002)
