"""touchline through a perspective camera: pose and lean together, every pose that a walking robot may have."""

from __future__ import annotations

import math

import numpy as np
import pytest

from touchline.geometry import FloatArray, IntArray, Pose, wrap_angle
from touchline.localization.camera_errors import camera_errors
from touchline.localization.estimator.filter import Filter, InitialUncertainty
from touchline.localization.estimator.statistics import CameraErrorStatistics
from touchline.localization.estimator.step_noise import StepNoise
from touchline.localization.estimator.sway_delay import SwayDelay
from touchline.localization.registration.joint import StateFit
from touchline.motion import LeanFilter
from touchline.motion.delayed import Delayed
from touchline.motion.driven import Scales
from touchline.motion.odometry import Motion


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


def test_a_robot_that_does_not_sway_tells_nothing_of_the_stamps() -> None:
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


def test_a_filter_keeps_what_it_knows_of_the_camera_at_another_place() -> None:
    one = walking_filter(Pose(1.0, 2.0, 0.3), np.diag([0.1, 0.2, 0.3]))
    one.mean[3:] = [0.0, 1.0, 2.0, 4.0, 0.1, *np.arange(5.0, 9.0)]
    twin = one.mirrored()
    assert twin.pose.distance_to(Pose(-1.0, -2.0, 0.0)) < 1e-12
    assert wrap_angle(twin.pose.heading - 0.3 - math.pi) == pytest.approx(0.0)
    np.testing.assert_array_equal(twin.mean[3:], one.mean[3:])
    np.testing.assert_array_equal(twin.covariance, one.covariance)
    np.testing.assert_array_equal(twin.error_covariance, one.error_covariance)
    assert twin.odometry == one.odometry


@pytest.mark.parametrize("noise", [0.3, 1.5])
def test_the_noise_of_steps_is_learned_and_the_covariance_honest(noise: float) -> None:
    rng, true, information = np.random.default_rng(2), np.zeros(7), np.diag([1e4, 1e4, 1e5, 1e4, 1e4, 1e4, 1e4])
    one, steps, squares = walking_filter(Pose(0.0, 0.0, 0.0), 1e-4 * np.eye(3)), StepNoise(walks=True), []
    per_image = CameraErrorStatistics(camera_errors(None, 1.0)).per_image
    motion = Motion(Pose(0.0, 0.0, 0.0), np.diag([0.005, 0.005, 0.003]) ** 2, 0.0)
    for _ in range(300):
        one.predict(Delayed(motion, 0.0, np.zeros(3), np.zeros(3)), 0.125, steps.of(motion))
        true[:3] += noise * np.array([0.01, 0.01, 0.004]) * rng.standard_normal(3)
        seen = true + rng.standard_normal(7) / np.sqrt(np.diag(information))
        expected = one.prior(per_image)
        state = expected.mean + np.linalg.solve(
            expected.information + information, information @ (seen - expected.mean)
        )
        fit = StateFit(state, information, information @ (seen - state), 1.0, 20.0, 1.0, 0.01, 0.0, 0.0)
        steps.learn(one, fit, per_image)
        one.correct(fit, per_image)
        off = one.pose.as_array()[:2] - true[:2]
        squares.append(off @ np.linalg.solve(one.covariance[:2, :2], off) / 2.0)
    assert 0.7 < np.mean(squares[50:]) < 1.4
    assert (steps.factors[0] < 0.5) == (noise < 1.0)
