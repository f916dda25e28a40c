"""Monte Carlo localization: each step against a closed form or its plain NumPy twin, then the whole."""

from __future__ import annotations

import math

import numpy as np
import pytest
from line_scenes import view

from touchline.config import PAPER, load_settings
from touchline.field import FieldModel, open_field
from touchline.geometry import FloatArray, Pose, wrap_angle, wrap_angles
from touchline.motion.odometry import Motion
from touchline.published.nubot.matcher import Matcher
from touchline.published.nubot_mcl.particles import NubotParticlePaper, NubotParticles, NubotParticleSettings
from touchline.published.particles.motion_model import move
from touchline.published.particles.particle_set import mean_and_covariance, normalize
from touchline.published.particles.resampling import AdaptiveSettings, kld_number, low_variance, occupied_bins
from touchline.published.particles.sensor_models import SquaredErrors, log_likelihoods

FIELD = open_field("msl-18x12")
# Equations (1) to (3) as they stand, and nothing but the drawing to come near.
PAPER_FORM = load_settings(NubotParticleSettings, preset=PAPER)
MATCHER = Matcher(FIELD.distance_map())
STILL = Motion(Pose(0.0, 0.0, 0.0), np.zeros((3, 3)), 0.0)


def paper_form_but(**changed: float) -> NubotParticleSettings:
    """The paper's form with some of its switches changed."""
    return PAPER_FORM.model_copy(update={"paper": PAPER_FORM.paper.model_copy(update=changed)})


def monte_carlo(
    settings: NubotParticleSettings | None = None, seed: int = 0, field: FieldModel = FIELD
) -> NubotParticles:
    matcher = MATCHER if field is FIELD else Matcher(field.distance_map())
    return NubotParticles(matcher, field.length, field.width, np.random.default_rng(seed), settings, field.is_symmetric)


# --- sensor model -----------------------------------------------------------------------------------------------------


def seen_from(pose: Pose, seed: int = 0, count: int = 100) -> FloatArray:
    return view(FIELD, pose, np.random.default_rng(seed), count, 5.0, 0.01)


def test_the_sensor_model_is_equations_1_to_3() -> None:
    points = seen_from(Pose(2.0, 1.0, 0.3))
    mcl = monte_carlo(PAPER_FORM)
    poses = np.array([[2.0, 1.0, 0.3], [2.4, 0.8, 0.2], [-8.0, 5.0, 3.0], [9.9, -6.9, -1.0]])
    for pose, found in zip(poses, mcl.log_likelihoods(points, None, poses), strict=True):
        distances = FIELD.line_distances(Pose(*pose).transform(points))
        plain = -np.sum(np.minimum(distances, 3.0) ** 2) / (2 * PAPER_FORM.sigma_m**2)
        table_step_m = 0.036  # half the diagonal of a sample
        slack = np.sum(2 * distances * table_step_m + table_step_m**2) / (2 * PAPER_FORM.sigma_m**2)
        if np.all(np.abs(Pose(*pose).transform(points)) < (11.9, 8.9)):  # the table ends 3 m beyond the lines
            assert abs(found - plain) <= slack


def test_the_loop_agrees_with_its_numpy_twin() -> None:
    rng = np.random.default_rng(1)
    squares = rng.random((40, 60)).astype(np.float32)
    particles = np.column_stack((rng.uniform(-5, 5, (50, 2)), rng.uniform(-4, 4, 50)))
    points, shares = rng.uniform(-3, 3, (30, 2)), rng.random(30)
    found = log_likelihoods(particles, points, shares, SquaredErrors(squares, -3.0, -2.0, 0.1), 1.7)
    c, s = np.cos(particles[:, 2:]), np.sin(particles[:, 2:])
    x = particles[:, :1] + c * points[:, 0] - s * points[:, 1]
    y = particles[:, 1:2] + s * points[:, 0] + c * points[:, 1]
    ix = np.clip(np.floor((x + 3.0) / 0.1 + 0.5), 0, 59).astype(int)
    iy = np.clip(np.floor((y + 2.0) / 0.1 + 0.5), 0, 39).astype(int)
    assert found == pytest.approx(-1.7 * (squares[iy, ix] * shares).sum(axis=1), rel=1e-9)


def test_the_sensor_model_narrows_while_particles_agree() -> None:
    points, pose = seen_from(Pose(2.0, 1.0, 0.3)), np.array([[2.4, 0.8, 0.2]])
    mcl = monte_carlo(paper_form_but(converged_sigma_m=0.1))
    wide = mcl.log_likelihoods(points, None, pose)
    for spread_m, ratio in ((0.01, 9.0), (2.0, 1.0)):
        mcl.restart(0.3)
        noise = np.random.default_rng(0).standard_normal(mcl.particles.poses.shape)
        mcl.filter.start([2.0, 1.0, 0.3] + spread_m * noise)
        assert mcl.converged == (spread_m < 0.1)
        mcl.weigh(points, None)
        assert mcl.log_likelihoods(points, None, pose) == pytest.approx(ratio * wide, rel=1e-6)


def test_a_hundred_points_on_no_line_underflow_nothing() -> None:
    """The product of equation (3) would be e^-10000 here: 0 in any floating point number."""
    points = np.tile([[30.0, 30.0]], (100, 1)) + np.random.default_rng(0).normal(0, 0.1, (100, 2))
    mcl = monte_carlo(PAPER_FORM.model_copy(update={"sigma_m": 0.02}))
    mcl.restart(0.0)
    lone = mcl.log_likelihoods(points, None, mcl.particles.poses)
    assert lone.max() < -5000.0
    mcl.weigh(points, None)
    assert mcl.particles.weights.sum() == pytest.approx(1.0)
    assert np.isfinite(mcl.particles.weights).all()
    assert np.isfinite(mcl.estimate().covariance).all()
    assert mcl.filter.effective >= 1.0


@pytest.mark.parametrize("shift", [0.0, -1e5, 1e5])
def test_weights_are_the_exponentials_over_their_sum(shift: float) -> None:
    logs = np.array([0.0, -1.0, -2.5, -800.0])
    weights = np.empty(4)
    effective = normalize(logs + shift, weights)
    plain = np.exp(logs) / np.exp(logs).sum()
    assert weights == pytest.approx(plain, rel=1e-9)
    assert effective == pytest.approx(1.0 / np.sum(plain**2))


# --- resampling -------------------------------------------------------------------------------------------------------


def counts(weights: FloatArray, start: float, number: int) -> FloatArray:
    particles = np.repeat(np.arange(len(weights), dtype=float)[:, None], 3, axis=1)
    out = low_variance(particles, weights, start, number)
    return np.bincount(out[:, 0].astype(int), minlength=len(weights))


def test_particles_are_drawn_as_often_as_they_weigh() -> None:
    rng = np.random.default_rng(2)
    for number in (1, 7, 600):
        weights = rng.random(40) ** 4
        weights /= weights.sum()
        drawn = counts(weights, float(rng.random()), number)
        assert drawn.sum() == number
        assert np.all(np.abs(drawn - number * weights) < 1.0)


# --- mean -------------------------------------------------------------------------------------------------------------


def test_the_mean_heading_is_circular() -> None:
    particles = np.array([[0.0, 0.0, math.pi - 0.1], [2.0, 4.0, -math.pi + 0.3]])
    mean, covariance = mean_and_covariance(particles, np.array([0.5, 0.5]))
    assert mean[:2] == pytest.approx([1.0, 2.0])
    assert wrap_angle(mean[2] - (math.pi + 0.1)) == pytest.approx(0.0, abs=1e-12)
    assert covariance[2, 2] == pytest.approx(0.2**2)
    assert covariance[0, 1] == pytest.approx(2.0)


# --- motion -----------------------------------------------------------------------------------------------------------


def moved(motion: Pose, covariance: FloatArray | None = None) -> FloatArray:
    """Where 20 000 particles at the origin, facing y, get to, each minus the motion without noise."""
    mcl = monte_carlo(NubotParticleSettings(particles=20_000))
    mcl.restart(0.0)
    mcl.particles.poses[:] = (0.0, 0.0, math.pi / 2)
    mcl.predict(Motion(motion, np.zeros((3, 3)) if covariance is None else covariance, 0.0))
    return mcl.particles.poses - Pose(0.0, 0.0, math.pi / 2).compose(motion).as_array()


def test_noise_grows_in_proportion_to_the_motion() -> None:
    noise = NubotParticleSettings().motion
    away = moved(Pose(2.0, 1.0, 0.5))
    travel = math.hypot(2.0, 1.0)
    position = math.hypot(noise.translation_from_translation * travel, noise.translation_at_rest_m)
    by_motion = math.hypot(noise.rotation_from_rotation * 0.5, noise.rotation_from_translation_rad_per_m * travel)
    heading = math.hypot(by_motion, noise.rotation_at_rest_rad)
    assert away.mean(axis=0) == pytest.approx([0, 0, 0], abs=0.01)
    assert away.std(axis=0) == pytest.approx([position, position, heading], rel=0.03)


@pytest.mark.parametrize("heading", [0.0, 0.4, -2.0])
def test_every_particle_moves_by_the_motion(heading: float) -> None:
    poses, motion = np.array([[1.0, -2.0, heading], [0.0, 0.0, 1.0]]), Pose(0.5, 0.3, 0.2)
    expected = [Pose(*row).compose(motion) for row in poses]
    move(poses, motion.as_array(), np.zeros(3), np.zeros((2, 3)))
    np.testing.assert_allclose(poses, np.array(expected), atol=1e-12)


def test_the_odometrys_uncertainty_turns_with_the_robot() -> None:
    away = moved(Pose(0.0, 0.0, 0.0), np.diag([1.0, 0.0, 0.0]))
    assert away[:, 1].std() == pytest.approx(1.0, rel=0.03)  # along the robot's x, which is the field's y
    assert away[:, 0].std() == pytest.approx(NubotParticleSettings().motion.translation_at_rest_m, rel=0.03)


# --- start ------------------------------------------------------------------------------------------------------------


def test_particles_start_evenly_and_about_the_compass() -> None:
    mcl = monte_carlo(NubotParticleSettings(particles=50_000, compass_rad=0.1))
    mcl.restart(3.1)
    x, y, heading = mcl.particles.poses.T
    assert len(x) == 50_000
    for values, reach in ((x, 10.0), (y, 7.0)):
        assert np.abs(values).max() <= reach
        shares = np.histogram(values, bins=10, range=(-reach, reach))[0] / 50_000
        assert shares == pytest.approx(0.1, abs=0.006)
    turned = wrap_angles(heading - 3.1)
    assert turned.mean() == pytest.approx(0.0, abs=0.002)
    assert turned.std() == pytest.approx(0.1, rel=0.02)
    assert np.all(mcl.particles.weights == 1 / 50_000)


def test_without_a_compass_all_headings_are_searched() -> None:
    for symmetric, most in ((True, math.pi / 2), (False, math.pi)):
        mcl = NubotParticles(MATCHER, 18.0, 12.0, np.random.default_rng(0), symmetric=symmetric)
        mcl.restart(None)
        assert len(mcl.particles) == NubotParticleSettings().particles_all_headings
        assert np.abs(mcl.particles.poses[:, 2]).max() == pytest.approx(most, rel=0.01)


# --- numbers ----------------------------------------------------------------------------------------------------------


def test_bins_are_counted_once_each_and_wrap_with_the_heading() -> None:
    apart = np.array([[0.1, 0.1, 0.0], [0.2, 0.3, 0.05], [0.7, 0.1, 0.0], [0.1, 0.1, 1.0], [-0.1, 0.1, 0.0]])
    middle = Pose(0.25, 0.25, 0.0)
    assert occupied_bins(apart, middle, 0.5, 0.2618) == 4
    assert occupied_bins(np.array([[0.1, 0.1, 3.1], [0.1, 0.1, 3.1 - 2 * math.pi]]), middle, 0.5, 0.2618) == 1


def test_kld_numbers_are_those_of_the_chi_square_quantile() -> None:
    """Equation (7) approximates the quantile of chi² over 2 ε; at 99 %: 21.666 for 9, 135.81 for 100 degrees."""
    assert kld_number(10) == pytest.approx(21.666 / 0.1, abs=2)
    assert kld_number(101) == pytest.approx(135.807 / 0.1, abs=3)
    assert kld_number(1) == 1


def test_adaptive_numbers_fall_to_a_single_particle_when_certain() -> None:
    adaptive = AdaptiveSettings(enabled=True)
    settings = NubotParticleSettings(
        adaptive=adaptive, paper=NubotParticlePaper(resampling_threshold=1.0, independent_points=1.0)
    )
    pose = Pose(2.0, 1.0, 0.0)
    mcl = monte_carlo(settings)
    mcl.restart(0.05)
    numbers = []
    for seed in range(15):
        mcl.predict(STILL)
        mcl.update(seen_from(pose, seed), None)
        numbers.append(len(mcl.particles))
    assert numbers[0] == 600
    assert 1 < numbers[3] < 600
    assert numbers[-1] == 1
    assert mcl.estimate().pose.distance_to(pose) < 0.1
