"""A perspective camera on a walking robot: sway, steps, and roll and pitch that are degrees off."""

from __future__ import annotations

import math

import numpy as np
import pytest

from touchline.field import open_field
from touchline.geometry import FloatArray, IntArray, Pose, Pose3, wrap_angle
from touchline.localization.camera_errors import camera_errors
from touchline.localization.camera_errors.base import placed_points
from touchline.localization.camera_errors.perspective import PerspectiveResponse, ahead
from touchline.localization.estimator.filter import Filter, InitialUncertainty
from touchline.localization.estimator.sway_delay import SwayDelay
from touchline.localization.registration.attitudes import attitude_offsets, fit_leaning
from touchline.localization.registration.joint import StatePrior
from touchline.localization.registration.registration import TRACKING, Registration
from touchline.localization.registration.seen import seen_points
from touchline.motion.driven import Scales
from touchline.motion.lean import LAG_S, LeanFilter
from touchline.types import Frame, LinePoints, Samples


@pytest.mark.parametrize("late_s", [0.0, 0.06, 0.1])
def test_the_sway_tells_how_late_images_are_stamped(late_s: float) -> None:
    """Roll and pitch at 1.5 Hz as a walking robot has them, lines that tell each to 0.3°."""
    rng, found = np.random.default_rng(1), SwayDelay()

    def lean_rad(time_s: float) -> FloatArray:
        return np.array([0.05 * math.sin(9.4 * time_s), 0.03 * math.cos(9.4 * time_s + 1.0)])

    class Swaying(LeanFilter):
        def turned_all(self, stamps_ns: IntArray) -> FloatArray:
            return np.array([lean_rad(1e-9 * stamp_ns) for stamp_ns in stamps_ns.tolist()])

    for time_s in (0.125 * np.arange(120.0) + 0.01 * rng.random(120)).tolist():
        more = lean_rad(time_s - late_s) - lean_rad(time_s) + 0.005 * rng.standard_normal(2)
        found.update(more, Swaying(), round(1e9 * time_s), 0.0)
    assert found.delay_s == pytest.approx(late_s, abs=2.0 * found.deviation_s)
    assert found.deviation_s < 0.008


def test_without_sway_nothing_is_told_of_the_stamps() -> None:
    class Standing(LeanFilter):
        def turned_all(self, stamps_ns: IntArray) -> FloatArray:
            return np.zeros((len(stamps_ns), 2))

    found = SwayDelay()
    for k in range(100):
        found.update(np.full(2, 0.001), Standing(), 125_000_000 * k, 0.0)
    assert math.isinf(found.deviation_s)


def walking_filter(pose: Pose, covariance: FloatArray) -> Filter:
    errors = camera_errors(None, 1.0)
    return Filter(pose, covariance, InitialUncertainty(Scales(0.05, 0.05, 0.0), errors.prior, errors.drift, 1.0, 0.003))


def test_a_mirrored_filter_keeps_what_it_knows_of_the_camera() -> None:
    one = walking_filter(Pose(1.0, 2.0, 0.3), np.diag([0.1, 0.2, 0.3]))
    one.mean[3:] = [0.0, 1.0, 2.0, 4.0, 0.1, *np.arange(5.0, 9.0)]
    twin = one.mirrored()
    assert twin.pose.distance_to(Pose(-1.0, -2.0, 0.0)) < 1e-12
    assert wrap_angle(twin.pose.heading - 0.3 - math.pi) == pytest.approx(0.0)
    np.testing.assert_array_equal(twin.mean[3:], one.mean[3:])
    np.testing.assert_array_equal(twin.covariance, one.covariance)
    np.testing.assert_array_equal(twin.error_covariance, one.error_covariance)
    assert twin.odometry == one.odometry


def test_a_pan_turns_the_axes_of_roll_and_pitch() -> None:
    """Errors of a camera that has turned its head to the left move what it sees as those of one that looks ahead."""
    eye, errors = np.array([0.0, 0.0, 0.6]), np.array([0.03, -0.05, 0.01, 0.02])
    points = np.array([[2.0, 0.5], [3.0, -1.0], [1.0, 0.2]])
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    here = PerspectiveResponse(eye, np.array([math.cos(0.3), 0.0, -math.sin(0.3)]), fisheye=False)
    aside = PerspectiveResponse(eye, np.array([0.0, math.cos(0.3), -math.sin(0.3)]), fisheye=False)
    np.testing.assert_allclose(
        placed_points(points @ turn.T, errors, aside), placed_points(points, errors, here) @ turn.T, atol=1e-12
    )
    assert ahead(np.zeros(3)) == (1.0, 0.0)


def test_rates_turn_the_pose_of_the_camera_on() -> None:
    """Kinematics hold the lean that the IMU has told late."""
    stamps = np.arange(0, 200_000_001, 20_000_000)
    gyro = Samples(stamps, np.tile([0.0, 0.5, 0.0], (len(stamps), 1)))
    frame = Frame(200_000_000, gyro=gyro, base_from_camera=Pose3.from_roll_pitch_yaw(0.0, 0.3, 0.0, (0.0, 0.0, 0.5)))
    turned = LeanFilter().at_image(frame).base_from_camera
    assert turned is not None
    assert turned.roll_pitch_yaw()[1] == pytest.approx(0.3 + 0.5 * LAG_S, abs=1e-6)


def test_a_grid_of_attitudes_begins_at_the_expected_one() -> None:
    offsets = attitude_offsets(np.array([0.05, 0.005]))
    assert not offsets[0].any()
    assert np.diff(np.unique(offsets[:, 0])).max() <= 0.025 + 1e-12
    assert offsets[:, 0].max() == pytest.approx(0.075)


@pytest.mark.parametrize("pitch_deg", [4.0, -4.0])
def test_a_poor_fit_begins_again_at_other_attitudes(pitch_deg: float) -> None:
    """Four degrees of pitch of a camera half a metre up: lines lie metres off."""
    field, truth = open_field("hsl-s-9x6"), Pose(0.5, 0.6, 0.4)
    response = PerspectiveResponse(np.array([0.0, 0.0, 0.5]), np.array([0.95, 0.0, -0.3]), fisheye=False)
    errors = np.array([0.0, math.radians(pitch_deg), 0.0, 0.0])
    steps = np.linspace(0.0, 1.0, 60)[:, np.newaxis]
    lines = np.concatenate([one[:2] + steps * (one[2:] - one[:2]) for one in np.asarray(field.segments)[:, :4]])
    points = truth.inverse().transform(lines)
    ahead_m = np.hypot(points[:, 0], points[:, 1])
    points = points[(np.abs(np.arctan2(points[:, 1], points[:, 0])) < 0.7) & (ahead_m < 4.5)]
    shown = placed_points(np.ascontiguousarray(points), -errors, response)
    spread = np.tile(0.02**2 * np.eye(2), (len(shown), 1, 1))
    seen = seen_points(LinePoints(shown, spread, np.ones(len(shown)), np.full_like(shown, np.nan)), 0.25)
    deviations = np.array([0.2, 0.2, 0.1, 0.05, 0.05, 0.005, 0.005])
    expected = StatePrior(np.array([*truth, 0.0, 0.0, 0.0, 0.0]), np.diag(deviations**-2.0))
    registration = Registration(field.distance_map())
    fit = fit_leaning(registration, seen, expected.mean, expected, TRACKING, response)
    assert registration.fit_state(seen, expected.mean, expected, TRACKING, response).explained < 0.85
    assert fit.explained > 0.95
    assert math.degrees(fit.state[4]) == pytest.approx(pitch_deg, abs=0.1)
    np.testing.assert_allclose(fit.state[:2], truth.as_array()[:2], atol=0.1)


@pytest.mark.parametrize(("sigma_rad", "tried"), [(0.014, 1), (0.05, 81)])
def test_no_other_attitude_is_tried_where_it_is_known(
    monkeypatch: pytest.MonkeyPatch, sigma_rad: float, tried: int
) -> None:
    """Of scatter, which no attitude explains."""
    places = np.random.default_rng(0).uniform(1.0, 4.0, (40, 2))
    points = LinePoints(places, np.tile(1e-4 * np.eye(2), (40, 1, 1)), np.ones(40), np.full((40, 2), np.nan))
    deviations = np.array([0.2, 0.2, 0.1, sigma_rad, sigma_rad, 0.005, 0.005])
    expected = StatePrior(np.zeros(7), np.diag(deviations**-2.0))
    response = PerspectiveResponse(np.array([0.0, 0.0, 0.5]), np.array([0.95, 0.0, -0.3]), fisheye=False)
    registration, starts, fit = Registration(open_field("hsl-s-9x6").distance_map()), [], Registration.fit_state
    monkeypatch.setattr(
        Registration,
        "fit_state",
        lambda self, seen, start, *rest: (starts.append(start), fit(self, seen, start, *rest))[1],
    )
    found = fit_leaning(registration, seen_points(points, 0.25), expected.mean, expected, TRACKING, response)
    assert found.explained < 0.85
    assert len(starts) == tried
