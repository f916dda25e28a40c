"""A mirror that is just as its camera.yaml says: two models of one filter, weighed by what the images tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drives import open_drive

from touchline.camera import OmniCamera
from touchline.geometry import FloatArray, Pose
from touchline.localization.camera_errors import CameraErrors, camera_errors
from touchline.localization.estimator.exact_camera import ExactCamera, as_exact
from touchline.localization.estimator.filter import Filter, InitialUncertainty
from touchline.localization.estimator.filter_kernels import ERRORS
from touchline.motion.driven import Scales


@pytest.fixture(scope="module")
def camera() -> OmniCamera:
    """Of a file that does not say how sure it is."""
    found = open_drive("tracks").setup.camera
    assert isinstance(found, OmniCamera)
    return replace(found, stated_uncertainty=None)


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


def test_one_model_follows_from_the_other_as_if_it_had_been_filtered_itself() -> None:
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


def test_a_mirror_that_shows_no_error_is_taken_for_exact_and_one_that_does_is_not(camera: OmniCamera) -> None:
    mirror = camera_errors(camera)
    exact = ExactCamera(mirror)
    small, large = learned(mirror, [0.0, 0.0, 0.08, 0.0, 0.0]), learned(mirror, [0.01, 0.0, 1.0, 0.0, 0.0])
    pose, covariance = exact.pose_of(small)
    assert pose.x < small.pose.x - 0.002  # as the centre is not displaced, nor is the pose
    assert covariance[0, 0] < 0.8 * small.covariance[0, 0]
    pose, covariance = exact.pose_of(large)
    np.testing.assert_allclose(pose, large.pose, atol=1e-6)
    np.testing.assert_allclose(covariance, large.covariance, atol=1e-9)


def test_who_states_how_sure_a_file_is_is_believed(camera: OmniCamera) -> None:
    mirror = camera_errors(replace(camera, stated_uncertainty=camera.uncertainty))
    one = learned(mirror, [0.0, 0.0, 0.08, 0.0, 0.0])
    assert ExactCamera(mirror).pose_of(one)[0] == one.pose
    assert ExactCamera(camera_errors(None)).pose_of(one)[0] == one.pose
