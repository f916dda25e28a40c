"""The particle filter put together from its parts, as augmented Monte Carlo localization has them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from line_scenes import view

from touchline.field import open_field
from touchline.geometry import Pose
from touchline.motion.odometry import Motion
from touchline.published.particles.motion_model import MotionModel
from touchline.published.particles.particle_filter import ParticleFilter
from touchline.published.particles.particle_set import ParticleEstimate, ParticleSet
from touchline.published.particles.random_particles import AugmentedInjection, RandomInjection, UniformPoses
from touchline.published.particles.resampling import EVERY_CYCLE, CertaintyNumber, Resampling
from touchline.published.particles.sensor_models import DistanceMapModel, LineView

FIELD = open_field("msl-18x12")
LINES = DistanceMapModel(FIELD.distance_map(), 0.3, farthest_sigmas=3.3, independent_points=5.0)
STILL = Motion(Pose(0.0, 0.0, 0.0), np.zeros((3, 3)), 0.0)
REACH_M = np.array([10.0, 7.0])


def lines(pose: Pose, seed: int) -> LineView:
    points = view(FIELD, pose, np.random.default_rng(seed), 60, 5.0, 0.02)
    return LineView(points, np.full(len(points), 1.0 / len(points)))


def about(pose: Pose) -> UniformPoses:
    return UniformPoses(REACH_M, heading_rad=(pose.heading, 0.1))


def augmented(seed: int, start: UniformPoses, injection: RandomInjection | None) -> ParticleFilter[LineView]:
    """As Schulz and Behnke 2012: drawn in every cycle, 250 to 1000 particles, random ones among them."""
    rng = np.random.default_rng(seed)
    particles = ParticleSet(start.draw(rng, 1000))
    return ParticleFilter(
        particles, MotionModel(), LINES, Resampling(EVERY_CYCLE, CertaintyNumber(250, 1000)), rng, injection
    )


def places(seed: int) -> tuple[Pose, Pose]:
    rng = np.random.default_rng([seed, 7])
    low, high = (-8.0, -5.0, -math.pi), (8.0, 5.0, math.pi)
    return Pose(*rng.uniform(low, high)), Pose(*rng.uniform(low, high))


# --- random particles -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(2))
def test_random_particles_find_a_kidnapped_robot(seed: int) -> None:
    here, there = places(seed)
    injection = AugmentedInjection(about(here))
    filters = augmented(seed, about(here), injection), augmented(seed, about(here), None)
    for k in range(40):
        for made in filters:
            made.predict(STILL)
            found = made.update(lines(here, k))
            if k >= 30:
                assert found.pose.distance_to(here) < 0.3
    assert injection.ratio(filters[0].estimate()) < 0.1
    injection.poses = about(there)
    for k in range(40):
        for made in filters:
            made.predict(STILL)
            made.update(lines(there, 100 + k))
        if k == 0:
            assert injection.ratio(filters[0].estimate()) > 0.2
    errors_m = [made.estimate().pose.distance_to(there) for made in filters]
    assert errors_m[0] < 0.3
    assert errors_m[1] > 1.0


def test_the_ratio_is_that_of_both_averages() -> None:
    rng = np.random.default_rng(0)
    injection = AugmentedInjection(UniformPoses(REACH_M), slow=0.1, fast=0.4, min_ratio=0.0, max_ratio=1.0)
    estimate = ParticleEstimate(Pose(0.0, 0.0, 0.0), np.eye(3))
    w_slow = w_fast = None
    ratios = []
    for k in range(30):
        weights = rng.random(50)
        weights /= weights.sum()
        logarithms = rng.normal(-5.0 if k < 15 else -8.0, 1.0, 50)
        mean = float(weights @ np.exp(logarithms))
        w_slow = mean if w_slow is None else w_slow + 0.1 * (mean - w_slow)
        w_fast = mean if w_fast is None else w_fast + 0.4 * (mean - w_fast)
        injection.observe(weights, logarithms)
        assert injection.ratio(estimate) == pytest.approx(max(0.0, 1.0 - w_fast / w_slow), abs=1e-12)
        ratios.append(injection.ratio(estimate))
    assert max(ratios[15:]) > 0.5


def test_likelihoods_that_no_number_can_hold_count_by_their_ratio() -> None:
    injection = AugmentedInjection(UniformPoses(REACH_M), slow=0.1, fast=0.5, max_ratio=1.0)
    estimate = ParticleEstimate(Pose(0.0, 0.0, 0.0), np.eye(3))
    for logarithm in (-2000.0, -5000.0):
        injection.observe(np.full(10, 0.1), np.full(10, logarithm))
    assert injection.ratio(estimate) == pytest.approx(1.0 - 0.5 / 0.9)


# --- numbers and drawing ----------------------------------------------------------------------------------------------


def test_certainty_decides_on_250_to_1000_particles() -> None:
    number = CertaintyNumber(250, 1000, uncertain_m=1.0)
    drawn = np.zeros((600, 3))
    for deviation_m, count in ((0.0, 250), (0.5, 625), (1.0, 1000), (4.0, 1000)):
        covariance = np.diag([deviation_m**2 / 2, deviation_m**2 / 2, 0.1])
        assert number(drawn, ParticleEstimate(Pose(0.0, 0.0, 0.0), covariance)) == pytest.approx(count, abs=1)
