"""Monte Carlo localization: one whole cycle, its parts beside their NumPy twin, and the curve to 10⁶ particles."""

from __future__ import annotations

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from touchline.field import open_field
from touchline.geometry import FloatArray, Pose
from touchline.motion.odometry import Motion
from touchline.published.nubot.matcher import Matcher
from touchline.published.nubot_mcl.particles import NubotParticlePaper, NubotParticles, NubotParticleSettings

FIELD = open_field("msl-18x12")
MATCHER = Matcher(FIELD.distance_map())
POSE = Pose(2.0, 1.0, 0.3)
MOTION = Motion(Pose(0.1, 0.0, 0.02), np.diag([1e-4, 1e-4, 1e-5]), 0.0)


def line_points(count: int) -> FloatArray:
    """So many points (count, 2) on the lines within 6 m of the robot, with 2 cm of noise."""
    rng = np.random.default_rng(0)
    seen = POSE.inverse().transform(np.vstack(list(FIELD.polylines(0.01))))
    seen = seen[np.hypot(*seen.T) < 6.0]
    return np.ascontiguousarray(seen[rng.permutation(len(seen))[:count]] + rng.normal(0.0, 0.02, (count, 2)))


def spread(particles: int, refined: int = 0) -> NubotParticles:
    """Particles that are drawn anew in every cycle, the dearest case."""
    settings = NubotParticleSettings(
        particles=particles, paper=NubotParticlePaper(refined_clusters=refined, resampling_threshold=1.0)
    )
    mcl = NubotParticles(MATCHER, FIELD.length, FIELD.width, np.random.default_rng(0), settings)
    mcl.restart(POSE.heading)
    return mcl


def cycle(mcl: NubotParticles, points: FloatArray) -> None:
    mcl.predict(MOTION)
    mcl.update(points, None)


@pytest.mark.parametrize("particles", [1, 100, 600, 2000, 6000, 20_000, 100_000, 1_000_000])
def test_one_whole_cycle(benchmark: BenchmarkFixture, particles: int) -> None:
    """Motion, weights, resampling, estimate with 100 points: 600 particles in 350 µs, 10⁶ in 350 ms, or less."""
    mcl, points = spread(particles), line_points(100)
    benchmark(cycle, mcl, points)


@pytest.mark.parametrize("points", [10, 30, 300, 1000])
def test_one_whole_cycle_of_600_particles_by_points(benchmark: BenchmarkFixture, points: int) -> None:
    mcl = spread(600)
    benchmark(cycle, mcl, line_points(points))


def test_one_whole_cycle_with_five_refined_clusters(benchmark: BenchmarkFixture) -> None:
    mcl = spread(600, refined=5)
    benchmark(cycle, mcl, line_points(100))


def test_weights_of_600_particles(benchmark: BenchmarkFixture) -> None:
    mcl = spread(600)
    benchmark(mcl.log_likelihoods, line_points(100), None, mcl.particles.poses)


def test_weights_of_600_particles_numpy_twin(benchmark: BenchmarkFixture) -> None:
    particles, points = spread(600).particles.poses, line_points(100)
    table = MATCHER.distance_map
    squares = table.values[::2, ::2, 0] ** 2

    def weigh() -> FloatArray:
        c, s = np.cos(particles[:, 2:]), np.sin(particles[:, 2:])
        x = particles[:, :1] + c * points[:, 0] - s * points[:, 1]
        y = particles[:, 1:2] + s * points[:, 0] + c * points[:, 1]
        ix = np.clip((x - table.origin_m[0]) / 0.05 + 0.5, 0, squares.shape[1] - 1).astype(int)
        iy = np.clip((y - table.origin_m[1]) / 0.05 + 0.5, 0, squares.shape[0] - 1).astype(int)
        return np.asarray(-squares[iy, ix].sum(axis=1) / (2 * 0.3**2))

    benchmark(weigh)
