"""The particle filter of Ismail et al. 2021, figure 8: each equation against plain NumPy, then the whole."""

from __future__ import annotations

import math

import numpy as np
import pytest
from line_scenes import view

from touchline.field import open_field
from touchline.field.error_map import error_map
from touchline.field.region import OWN_HALF
from touchline.geometry import FloatArray, Pose, wrap_angles
from touchline.localization.search.resampling import tempering
from touchline.motion.odometry import Motion
from touchline.published.iris_fusion.particles import (
    MAP_M,
    MAX_M,
    IrisParticlePaper,
    IrisParticles,
    IrisParticleSettings,
)
from touchline.published.particles.sensor_models import LineView

FIELD = open_field("indoor-9x6")
STILL = Motion(Pose(0.0, 0.0, 0.0), np.zeros((3, 3)), 0.0)
PAPER = IrisParticleSettings(
    paper=IrisParticlePaper(max_units=255, tempering_threshold=0.0, roughening=0.0, nearby_ratio=0.0)
)
PLACE = Pose(1.3, -0.8, 2.9)


def particle_filter(settings: IrisParticleSettings | None = None, seed: int = 0) -> IrisParticles:
    return IrisParticles(FIELD, np.random.default_rng(seed), settings)


def seen_from(pose: Pose, seed: int = 0, count: int = 80) -> FloatArray:
    return view(FIELD, pose, np.random.default_rng(seed), count, 4.0, 0.01, clutter=0.05)


def log_likelihoods(made: IrisParticles, points: FloatArray, poses: FloatArray) -> FloatArray:
    return made.sensor_model.log_likelihoods(LineView(points, np.ones(len(points))), poses)


# --- equations (7) to (9) -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("worst", [255.0, 100.0])
def test_the_logarithm_of_equation_9_is_the_plain_sum(worst: float) -> None:
    settings = PAPER.model_copy(
        update={"paper": PAPER.paper.model_copy(update={"max_units": worst}), "sigma_units": 40.0}
    )
    particles = np.random.default_rng(1).uniform([-5, -4, -4], [5, 4, 4], (50, 3))
    points = seen_from(PLACE)
    found = log_likelihoods(particle_filter(settings), points, particles)
    field_map = error_map(FIELD, MAP_M, MAX_M)
    for (x, y, heading), logarithm in zip(particles, found, strict=True):
        rotation = np.array([[math.cos(heading), -math.sin(heading)], [math.sin(heading), math.cos(heading)]])
        global_points = np.array([x, y]) + points @ rotation.T  # (7)
        errors = np.minimum(field_map.look_up(global_points).astype(float), worst)
        likelihoods = -(errors**2) / (2 * 40.0**2)  # (8), logarithm
        # a point on the border between two samples may fall to either side: allow for one
        assert logarithm == pytest.approx(likelihoods.sum(), abs=0.5)
    assert np.ptp(found) > 50.0


# --- tempering ------------------------------------------------------------------------------------------------------


def effective(logarithms: FloatArray, exponent: float) -> float:
    weights = np.exp(exponent * (logarithms - logarithms.max()))
    return float(weights.sum() ** 2 / (weights**2).sum())


@pytest.mark.parametrize("scale", [3.0, 300.0, 1e5])
def test_tempering_leaves_the_effective_particles_asked_for(scale: float) -> None:
    logarithms = -scale * np.random.default_rng(2).random(600) ** 2
    exponent = tempering(logarithms, 60.0)
    assert 60.0 <= effective(logarithms, exponent) <= (600 if exponent == 1.0 else 64.0)
    assert exponent <= 1.0


# --- start and motion -----------------------------------------------------------------------------------------------


def test_a_hardly_known_heading_is_searched_in_its_half() -> None:
    """On a symmetric field the other half looks the same; where a region was told, it does not."""
    for region, farthest_rad in ((None, math.pi / 2), (OWN_HALF, math.pi)):
        made = particle_filter()
        made.restart(2.0, region, deviation_rad=5.0)
        assert len(made.particles) == 6000
        turned = np.abs(wrap_angles(made.particles.poses[:, 2] - 2.0))
        assert turned.max() == pytest.approx(farthest_rad, rel=0.01)


def test_particles_outside_a_region_are_replaced() -> None:
    made, moved = particle_filter(), Pose(1.5, 0.4, 2.0)
    made.restart(None)
    began = np.array([Pose(*p).compose(moved.inverse()).x for p in made.particles.poses.tolist()])
    before = made.particles.poses.copy()
    made.keep_within(OWN_HALF, moved)
    assert 0.3 < np.mean(began > 0.0) < 0.7
    assert np.array_equal(made.particles.poses[began <= 0.0], before[began <= 0.0])
    after = np.array([Pose(*p).compose(moved.inverse()).x for p in made.particles.poses.tolist()])
    assert after.max() <= 1e-9
    made.start_at(Pose(4.0, 0.0, 0.0), np.eye(3) * 1e-6)
    before = made.particles.poses.copy()
    made.keep_within(OWN_HALF, Pose(0.0, 0.0, 0.0))  # all of them are: nobody to follow
    assert np.array_equal(made.particles.poses, before)


def test_without_a_compass_ten_times_the_particles_search() -> None:
    made = particle_filter()
    made.restart(None)
    assert len(made.particles) == 6000
    assert np.abs(made.particles.poses[:, 2]).max() == pytest.approx(math.pi / 2, rel=0.01)
    made.update(seen_from(PLACE))
    assert len(made.particles) == 600
    made.restart(None, OWN_HALF)
    assert made.particles.poses[:, 0].max() <= 0.0
    assert np.abs(made.particles.poses[:, 2]).max() > 3.0


def test_roughening_alone_parts_the_copies() -> None:
    moved = {}
    for name, settings in (
        ("paper", PAPER),
        ("rough", PAPER.model_copy(update={"paper": PAPER.paper.model_copy(update={"roughening": 0.3})})),
    ):
        made = particle_filter(settings)
        made.restart(PLACE.heading)
        made.update(seen_from(PLACE))
        before, spread_m = made.particles.poses.copy(), made.estimate().deviation_m
        made.predict(STILL)
        moved[name] = (made.particles.poses - before)[:, :2].std(), spread_m
    assert moved["paper"][0] == pytest.approx(PAPER.motion.translation_at_rest_m, rel=0.1)
    share = 4 * 0.3 * 600 ** (-1 / 3) * math.sqrt(0.5)
    rough_m = math.hypot(share * moved["rough"][1], PAPER.motion.translation_at_rest_m)
    assert moved["rough"][0] == pytest.approx(rough_m, rel=0.1)
