"""The particle filter of Ismail et al. 2021, figure 8: each equation against plain NumPy, then the whole."""

from __future__ import annotations

import math

import numpy as np
import pytest
from line_scenes import view

from touchline.field import open_field
from touchline.field.error_map import error_map
from touchline.field.region import OWN_HALF
from touchline.geometry import FloatArray, Pose, wrap_angle, wrap_angles
from touchline.motion.odometry import Motion
from touchline.published.iris_fusion.particles import (
    MAP_M,
    MAX_M,
    IrisParticlePaper,
    IrisParticles,
    IrisParticleSettings,
)
from touchline.published.particles.particle_set import mean_and_covariance
from touchline.published.particles.resampling import low_variance, tempering
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


def eq_13(y: float, x: float) -> float:
    """f of equation (13), as it is printed."""
    if x > 0.0:
        return math.atan(y / x)
    if x < 0.0:
        return math.atan(y / x) + (math.pi if y >= 0.0 else -math.pi)
    if y == 0.0:
        raise ValueError("undefined")
    return math.copysign(math.pi / 2.0, y)


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


def test_a_product_that_no_number_can_hold_is_normalised_all_the_same() -> None:
    """Equation (9) would be e^-2000 for every particle here."""
    settings = PAPER.model_copy(update={"sigma_units": 10.0, "particles": 200})
    made = particle_filter(settings)
    made.restart(PLACE.heading)
    points = seen_from(PLACE) + 0.7
    assert log_likelihoods(made, points, made.particles.poses).max() < -800.0
    made.update(points)
    assert np.isfinite(made.particles.poses).all()
    assert len(made.particles) == 200


def test_the_paper_s_form_neither_tempers_nor_caps() -> None:
    made = particle_filter(PAPER)
    made.restart(PLACE.heading)
    made.update(seen_from(PLACE))
    assert made.filter.exponent == 1.0


# --- tempering ------------------------------------------------------------------------------------------------------


def effective(logarithms: FloatArray, exponent: float) -> float:
    weights = np.exp(exponent * (logarithms - logarithms.max()))
    return float(weights.sum() ** 2 / (weights**2).sum())


@pytest.mark.parametrize("scale", [3.0, 300.0, 1e5])
def test_tempering_leaves_just_as_many_effective_particles_as_are_asked_for(scale: float) -> None:
    logarithms = -scale * np.random.default_rng(2).random(600) ** 2
    exponent = tempering(logarithms, 60.0)
    assert 60.0 <= effective(logarithms, exponent) <= (600 if exponent == 1.0 else 64.0)
    assert exponent <= 1.0


def test_weights_that_leave_enough_are_not_tempered() -> None:
    assert tempering(-np.random.default_rng(3).random(600), 60.0) == 1.0


# --- equation (10) --------------------------------------------------------------------------------------------------


def test_low_variance_resampling_draws_every_particle_its_share_rounded_down_or_up() -> None:
    """u = r + (n - 1) / N with r in [0, 1/N); as it is printed, with n / N, the last u would lie beyond all weights."""
    rng = np.random.default_rng(4)
    weights = rng.random(50) ** 3
    weights /= weights.sum()
    particles = np.repeat(np.arange(50.0)[:, None], 3, axis=1)
    number = 600
    counts = []
    for start in (np.arange(200) + 0.5) / 200:
        drawn = low_variance(particles, weights, start, number)
        u = start / number + np.arange(number) / number
        plain = np.searchsorted(np.cumsum(weights), u, side="right")
        assert np.array_equal(drawn[:, 0].astype(int), np.minimum(plain, 49))
        counts.append(np.bincount(drawn[:, 0].astype(int), minlength=50))
    assert np.all(np.abs(np.array(counts) - number * weights) < 1.0)
    assert np.mean(counts, axis=0) == pytest.approx(number * weights, abs=0.02)


# --- equations (11) to (14) -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("middle", [0.0, math.pi, -math.pi, 3.1, -2.0, math.pi / 2])
def test_the_mean_heading_is_equation_14_also_across_the_half_turn(middle: float) -> None:
    headings = wrap_angles(middle + np.random.default_rng(5).normal(0.0, 0.4, 300))
    particles = np.column_stack((np.full(300, 1.0), np.full(300, -2.0), headings))
    mean, _ = mean_and_covariance(particles, np.full(300, 1 / 300))
    assert wrap_angle(mean[2] - eq_13(float(np.sin(headings).mean()), float(np.cos(headings).mean()))) == pytest.approx(
        0.0, abs=1e-12
    )
    assert abs(wrap_angle(mean[2] - middle)) < 0.1
    assert mean[:2] == pytest.approx([1.0, -2.0])


@pytest.mark.parametrize(("y", "x"), [(1, 2), (1, -2), (-1, -2), (-1, 2), (0, -1), (1, 0), (-1, 0)])
def test_f_of_equation_13_is_the_arc_tangent_of_both_arguments(y: float, x: float) -> None:
    assert eq_13(y, x) == pytest.approx(math.atan2(y, x))


def test_the_pose_is_the_mean_of_the_particles_that_were_drawn() -> None:
    made = particle_filter()
    made.restart(PLACE.heading)
    for seed in range(4):
        made.predict(STILL)
        made.update(seen_from(PLACE, seed))
    assert made.estimate().pose[:2] == pytest.approx(made.particles.poses[:, :2].mean(axis=0))
    turned = wrap_angles(made.particles.poses[:, 2] - made.estimate().pose.heading)
    assert turned.mean() == pytest.approx(0.0, abs=1e-3)
    assert made.estimate().deviation_m == pytest.approx(float(np.sqrt(made.particles.poses[:, :2].var(axis=0).sum())))


# --- start and motion -----------------------------------------------------------------------------------------------


def test_the_wider_the_first_headings_the_more_particles_there_are() -> None:
    made = particle_filter(IrisParticleSettings(particles=20_000, particles_all_headings=100_000))
    for deviation_rad, count in ((None, 20_000), (0.45, 60_000)):
        made.restart(3.1, deviation_rad=deviation_rad)
        turned = wrap_angles(made.particles.poses[:, 2] - 3.1)
        assert turned.std() == pytest.approx(deviation_rad or IrisParticleSettings().compass_rad, rel=0.03)
        assert len(made.particles) == count
    assert np.abs(made.particles.poses[:, 0]).max() == pytest.approx(5.5, abs=0.01)


def test_a_heading_that_is_hardly_known_is_searched_in_its_half_of_the_circle() -> None:
    """On a symmetric field the other half looks the same; where a region was told, it does not."""
    for region, farthest_rad in ((None, math.pi / 2), (OWN_HALF, math.pi)):
        made = particle_filter()
        made.restart(2.0, region, deviation_rad=5.0)
        assert len(made.particles) == 6000
        turned = np.abs(wrap_angles(made.particles.poses[:, 2] - 2.0))
        assert turned.max() == pytest.approx(farthest_rad, rel=0.01)


def test_particles_that_began_outside_of_a_region_take_the_places_of_others() -> None:
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


def test_without_a_compass_half_the_circle_is_searched_with_ten_times_the_particles_until_the_first_drawing() -> None:
    made = particle_filter()
    made.restart(None)
    assert len(made.particles) == 6000
    assert np.abs(made.particles.poses[:, 2]).max() == pytest.approx(math.pi / 2, rel=0.01)
    made.update(seen_from(PLACE))
    assert len(made.particles) == 600
    made.restart(None, OWN_HALF)
    assert made.particles.poses[:, 0].max() <= 0.0
    assert np.abs(made.particles.poses[:, 2]).max() > 3.0


def test_particles_move_by_the_odometry_in_their_own_direction() -> None:
    made = particle_filter(PAPER)
    made.start_at(Pose(1.0, 2.0, math.pi / 2), np.eye(3) * 1e-12)
    made.predict(Motion(Pose(0.5, 0.1, 0.2), np.zeros((3, 3)), 0.0))
    assert made.estimate().pose == pytest.approx((0.9, 2.5, math.pi / 2 + 0.2), abs=1e-6)
    assert made.particles.poses.mean(axis=0) == pytest.approx([0.9, 2.5, math.pi / 2 + 0.2], abs=3e-3)


def test_roughening_parts_the_copies_and_nothing_else_does_in_the_paper_s_form() -> None:
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


def test_a_share_of_the_particles_is_put_about_the_fused_pose() -> None:
    made = particle_filter()
    made.start_at(Pose(0.0, 0.0, 0.0), np.eye(3) * 1e-6)
    made.put_nearby(Pose(3.0, 2.0, 1.0))
    moved = np.hypot(made.particles.poses[:, 0], made.particles.poses[:, 1]) > 1.0
    assert moved.sum() == 60
    assert made.particles.poses[moved, 2].mean() == pytest.approx(1.0, abs=0.05)


# --- the whole ------------------------------------------------------------------------------------------------------


def found_within(settings: IrisParticleSettings, cycles: int, compass_error_rad: float) -> float:
    """Share of 40 random places found."""
    right = 0
    for k in range(40):
        rng = np.random.default_rng([k, 6])
        pose = Pose(rng.uniform(-4.2, 4.2), rng.uniform(-2.7, 2.7), rng.uniform(-math.pi, math.pi))
        made = particle_filter(settings, k)
        made.restart(pose.heading + compass_error_rad)
        for seed in range(cycles):
            made.predict(STILL)
            made.update(seen_from(pose, 100 * k + seed))
        found = made.estimate()
        turned = abs(wrap_angle(found.pose.heading - pose.heading))
        right += found.pose.distance_to(pose) < 0.1 and turned < math.radians(3.0) and found.deviation_m < 0.15
    return right / 40


def test_robots_are_found_anywhere_within_8_cycles_with_a_compass_5_degrees_off() -> None:
    assert found_within(IrisParticleSettings(), 8, math.radians(5.0)) >= 0.95


def test_in_the_paper_s_form_one_particle_takes_all_weight_before_it_is_near() -> None:
    """Why tempering and roughening are there."""
    assert found_within(PAPER, 8, math.radians(5.0)) < 0.8


def test_a_robot_that_was_shoved_by_30_cm_is_found_again_within_3_cycles() -> None:
    made = particle_filter()
    made.start_at(PLACE, np.diag([0.02, 0.02, 0.01]) ** 2)
    for seed in range(3):
        made.predict(STILL)
        made.update(seen_from(PLACE, seed))
        made.put_nearby(made.estimate().pose)
    shoved = Pose(PLACE.x + 0.2, PLACE.y - 0.22, PLACE.heading)
    for seed in range(3):
        made.predict(STILL)
        made.put_nearby(PLACE)
        made.update(seen_from(shoved, 10 + seed))
    assert made.estimate().pose.distance_to(shoved) < 0.05


def test_the_same_seed_gives_the_same_particles() -> None:
    def run(seed: int) -> FloatArray:
        made = particle_filter(seed=seed)
        made.restart(PLACE.heading)
        for k in range(3):
            made.predict(STILL)
            made.update(seen_from(PLACE, k))
        return made.particles.poses

    assert np.array_equal(run(1), run(1))
    assert not np.array_equal(run(1), run(2))
