"""The filter of pose, odometry, delay and camera errors: its update, and a mirror that may be exact."""

from __future__ import annotations

import numpy as np
import pytest
from drives import open_drive

from touchline.field import open_field
from touchline.geometry import FloatArray, Pose
from touchline.localization.camera_errors import CameraErrors, camera_errors
from touchline.localization.camera_errors.base import placed_points
from touchline.localization.estimator.exact_camera import as_exact
from touchline.localization.estimator.filter import (
    DELAY_DRIFT_S,
    SCALE_DRIFT,
    YAW_RATE_DRIFT,
    Filter,
    InitialUncertainty,
)
from touchline.localization.estimator.filter_kernels import ERRORS
from touchline.localization.estimator.statistics import CameraErrorStatistics
from touchline.localization.registration.joint import Seen, StateFit
from touchline.localization.registration.registration import SETTLED, Registration
from touchline.localization.registration.seen import repeated, seen_points
from touchline.motion.delayed import Delayed
from touchline.motion.driven import Scales
from touchline.motion.odometry import Motion
from touchline.types import LinePoints

FIELD = open_field("msl-18x12")
TRUTH = Pose(3.0, -1.0, 0.4)
ASKEW = np.array([0.006, -0.004, 0.6, -0.3, 0.008])
DEVIATIONS = np.array([0.02, 0.02, 3.0, 3.0, 0.02])
UNKNOWN = InitialUncertainty(Scales(0.03, 0.03, 0.03), np.diag(DEVIATIONS**2), 0.01 * DEVIATIONS, 1.0)


@pytest.fixture(scope="module")
def mirror() -> CameraErrors:
    return camera_errors(open_drive("tracks").setup.camera)


def askew(mirror: CameraErrors, errors: np.ndarray) -> LinePoints:
    """Points of lines about the true pose as a mirror with these errors sees them, without noise."""
    exact = TRUTH.inverse().transform(np.vstack(FIELD.polylines(0.2)))
    found = as_seen(exact[np.hypot(*exact.T) < 5.0], errors, mirror)
    n = len(found)
    return LinePoints(found, np.tile(1e-4 * np.eye(2), (n, 1, 1)), np.ones(n), np.full((n, 2), np.nan))


def as_seen(exact: np.ndarray, errors: np.ndarray, mirror: CameraErrors) -> np.ndarray:
    """The inverse of `placed_points`."""
    found = exact.copy()
    for _ in range(60):
        found += 0.7 * (exact - placed_points(found, errors, mirror.response()))
    return found


def counted(points: LinePoints) -> Seen:
    """As many points of an image count."""
    return seen_points(points, 1.0 / repeated(len(points)))


def test_the_update_is_the_fit_and_its_inverse_information(mirror: CameraErrors) -> None:
    seen, per_image = counted(askew(mirror, np.zeros(5))), CameraErrorStatistics(mirror).per_image
    one = Filter(Pose(3.01, -1.0, 0.4), np.diag([0.1, 0.1, 0.1]) ** 2, UNKNOWN)
    prior = one.prior(per_image)
    fit = Registration(FIELD.distance_map()).fit_state(seen, prior.mean, prior, SETTLED, mirror.response())
    one.correct(fit, per_image)
    assert one.pose.distance_to(Pose(*fit.state[:3].tolist())) < 1e-3
    expected = np.linalg.inv(fit.information + prior.information)[:3, :3]
    np.testing.assert_allclose(one.covariance, expected, rtol=1e-3, atol=1e-9)


# --- against a dense Kalman filter in plain NumPy ---------------------------------------------------------------------

STATES, MEASURED = 13, [0, 1, 2, 8, 9, 10, 11, 12]  # pose, scales, yaw rate, delay, errors; those that a fit measures


def covariance_of(rng: np.random.Generator, count: int, deviations: np.ndarray) -> np.ndarray:
    """Of correlated states."""
    mixed = np.diag(deviations) @ (np.eye(count) + 0.3 * rng.standard_normal((count, count)))
    return mixed @ mixed.T


def unsure(learned: float) -> Filter:
    """A filter all of whose states are correlated."""
    rng = np.random.default_rng(4)
    one = Filter(TRUTH, np.eye(3), UNKNOWN._replace(learned=learned, yaw_rate_rad_s=0.003, delay_s=0.05))
    deviations = np.array([0.05, 0.04, 0.02, 0.03, 0.03, 0.03, 0.003, 0.05, *DEVIATIONS])
    one.joint = covariance_of(rng, STATES, deviations)
    one.mean[3:] = [0.02, -0.01, 0.015, 0.002, 0.08, *0.3 * ASKEW]
    return one


def state_of(one: Filter) -> np.ndarray:
    return one.mean.copy()


def test_the_prediction_is_that_of_a_dense_kalman_filter() -> None:
    """Derivatives by finite differences of the motion of all states."""
    moved = Delayed(Motion(Pose(0.2, -0.05, 0.1), np.diag([1e-4, 2e-4, 3e-5]), 0.0), 0.08, np.array([1.0, 0.3, -0.4]),
                    np.zeros(3))  # fmt: skip
    one, seconds = unsure(1.0), 0.1

    def after(state: np.ndarray) -> np.ndarray:
        x, y, turn = np.array(moved.motion.pose) * (1.0 + state[3:6]) + (state[7] - moved.late_s) * moved.by_delay
        cosine, sine = np.cos(state[2]), np.sin(state[2])
        step = np.array([cosine * x - sine * y, sine * x + cosine * y, turn + seconds * state[6]])
        return np.concatenate((state[:3] + step, state[3:]))

    state, joint = state_of(one), one.joint.copy()
    by_state = np.array([(after(state + e) - after(state - e)) / 2e-6 for e in 1e-6 * np.eye(STATES)]).T
    turned = np.array(
        [[np.cos(state[2]), -np.sin(state[2]), 0.0], [np.sin(state[2]), np.cos(state[2]), 0.0], [0, 0, 1]]
    )
    expected = by_state @ joint @ by_state.T
    expected[:3, :3] += turned @ moved.motion.covariance @ turned.T
    expected[np.diag_indices(STATES)] += seconds * np.square(
        [0.0, 0.0, 0.0, SCALE_DRIFT, SCALE_DRIFT, SCALE_DRIFT, YAW_RATE_DRIFT, DELAY_DRIFT_S, *UNKNOWN.error_drift]
    )
    one.predict(moved, seconds)
    np.testing.assert_allclose(state_of(one), after(state), atol=1e-9)
    np.testing.assert_allclose(one.joint, expected, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("learned", [1.0, 0.3, 0.0])
def test_the_correction_is_that_of_a_dense_kalman_filter(learned: float) -> None:
    """The fit as a measurement of pose and errors, those of each image's own; errors take a share of their step."""
    rng = np.random.default_rng(7)
    one, per_image = unsure(learned), np.diag([1e-5, 1e-5, 0.0, 0.0, 0.0])
    noise = covariance_of(rng, 8, np.array([0.02, 0.03, 0.01, 0.01, 0.02, 2.0, 1.0, 0.02]))
    state, joint = state_of(one), one.joint.copy()
    fitted = state[MEASURED] + 0.02 * rng.standard_normal(8)
    gradient = 10.0 * rng.standard_normal(8)
    fit = StateFit(fitted, np.linalg.inv(noise), gradient, 1.0, 50.0, 1.0, 0.0, 0.0, 0.0)
    shown = fitted + noise @ gradient  # the measurement: where the image alone would have its pose and errors
    by_state = np.eye(STATES)[MEASURED]
    spread = noise.copy()
    spread[3:, 3:] += per_image
    share = np.array([*np.ones(8), *np.full(5, learned)])[:, np.newaxis]
    gain = share * (joint @ by_state.T @ np.linalg.inv(by_state @ joint @ by_state.T + spread))
    left = np.eye(STATES) - gain @ by_state
    one.correct(fit, per_image)
    np.testing.assert_allclose(state_of(one), state + gain @ (shown - state[MEASURED]), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(one.joint, left @ joint @ left.T + gain @ spread @ gain.T, rtol=1e-5, atol=1e-9)


def test_an_image_is_expected_as_its_covariance_says() -> None:
    one, per_image = unsure(1.0), np.diag([1e-5, 1e-5, 0.0, 0.0, 0.0])
    shift = np.array([0.01, -0.02, 0.003])
    expected = one.joint[np.ix_(MEASURED, MEASURED)].copy()
    expected[3:, 3:] += per_image
    expected[:3, :3] += np.outer(shift, shift)
    prior = one.prior(per_image, shift)
    np.testing.assert_allclose(prior.mean, state_of(one)[MEASURED])
    np.testing.assert_allclose(prior.information @ expected, np.eye(8), atol=1e-6)


# --- in play ----------------------------------------------------------------------------------------------------------


def normal_log(value: FloatArray, covariance: FloatArray) -> float:
    return float(
        -0.5 * value @ np.linalg.solve(covariance, value) - 0.5 * np.linalg.slogdet(2.0 * np.pi * covariance)[1]
    )


def measured(prior: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray, float]:
    """State and covariance after ten measurements, and the logarithm of what is expected of them."""
    state, joint, evidence = np.zeros(8), prior.copy(), 0.0
    for _ in range(10):
        seen, noise, value = rng.standard_normal((4, 8)), 0.3 * np.eye(4), rng.standard_normal(4)
        spread = seen @ joint @ seen.T + noise
        away = value - seen @ state
        evidence += normal_log(away, spread)
        gain = joint @ seen.T @ np.linalg.inv(spread)
        state, joint = state + gain @ away, joint - gain @ seen @ joint
    return state, joint, evidence


def test_an_exact_camera_follows_from_the_filter_of_another() -> None:
    wide, narrow = np.eye(8), np.eye(8)
    narrow[3:, 3:] *= 0.05
    state, joint, evidence = measured(wide, np.random.default_rng(1))
    other, other_joint, other_evidence = measured(narrow, np.random.default_rng(1))
    more = np.linalg.inv(narrow[3:, 3:]) - np.linalg.inv(wide[3:, 3:])
    shift, covariance, fits = as_exact(joint[:3, :3], joint[:3, 3:], joint[3:, 3:], state[3:], more)
    normalisation = 0.5 * (np.linalg.slogdet(wide)[1] - np.linalg.slogdet(narrow)[1])
    np.testing.assert_allclose(state[:3] + shift, other[:3], atol=1e-9)
    np.testing.assert_allclose(covariance, other_joint[:3, :3], atol=1e-9)
    assert fits + normalisation == pytest.approx(other_evidence - evidence, abs=1e-9)


def learned(mirror: CameraErrors, errors: list[float]) -> Filter:
    """A filter that has seen these errors, each known to a twentieth of what it was, and a pose that goes with them."""
    unknown = InitialUncertainty(Scales(0, 0, 0), mirror.prior, mirror.drift, mirror.learned)
    one = Filter(Pose(1.0, 2.0, 3.0), np.diag([1e-4, 1e-4, 1e-6]), unknown)
    one.mean[ERRORS:] = errors
    deviations = 0.05 * np.sqrt(np.diag(mirror.prior))
    one.error_covariance[:] = np.diag(deviations**2)
    one.error_crossed[0, 2] = 0.8 * 0.01 * deviations[2]
    return one
