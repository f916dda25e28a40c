"""The observation level: line points without images, as perception would deliver them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from touchline.field import open_field
from touchline.geometry import FloatArray, Pose, wrap_angles
from touchline.simulation.crossings import circle_hits, hidden, ray_hits, round_table
from touchline.simulation.observation import ObservationNoise, ObservedLines, leaning_view, occluders
from touchline.simulation.run import Simulation
from touchline.simulation.scenario import open_scenario
from touchline.systems import open_system
from touchline.types import Status

SILENT = ObservationNoise(
    noise_px=0.0, wild_px=0.0, circle_noise_px=0.0, circle_wild_px=0.0, spread_px=0.0, frame_px=0.0,
    found_share=1.0, circle_share=1.0, thin_half_px=1e-3, thin_slope_px=1e-4, circle_half_px=1e-3, circle_slope_px=1e-4,
    coarse_half_m=9.0, coarse_slope_m=0.1, long_px=1e9, false_points=0.0, goal_points=0.0,
)  # fmt: skip
POSE = Pose(2.0, -1.5, 0.7)


def head() -> ObservedLines:
    """A virtual detector with a camera 0.8 m high and 0.3 degrees per pixel on the large field."""
    return ObservedLines(leaning_view(0.8, 190.0, 9.0), open_field("msl-18x12"), SILENT)


def line_distances(observer: ObservedLines, pose: Pose, positions: FloatArray) -> FloatArray:
    return observer.field.line_distances(pose.transform(positions))


class TestGeometry:
    def test_rays_meet_segments_where_a_plain_solution_says(self) -> None:
        rng = np.random.default_rng(1)
        segments, hits = rng.uniform(-5, 5, (40, 4)), np.empty((64, 3))
        none = np.zeros((0, 5)), np.zeros((0, 3))
        for bearing in rng.uniform(-math.pi, math.pi, 25):
            c, s = math.cos(bearing), math.sin(bearing)
            count = ray_hits(0.3, -0.2, c, s, segments, *none, hits)
            expected = []
            for x1, y1, x2, y2 in segments:
                along, share = np.linalg.solve([[c, x1 - x2], [s, y1 - y2]], [x1 - 0.3, y1 + 0.2])
                if along > 0 and 0 <= share <= 1:
                    expected.append(along)
            np.testing.assert_allclose(np.sort(hits[:count, 0]), np.sort(expected), atol=1e-9)

    def test_rays_and_circles_meet_round_lines_on_them(self) -> None:
        rounds = round_table(np.array([[1.0, 0.0, 2.0]]), np.array([[4.0, 3.0, 1.0, 0.0, math.pi]]))
        hits, none = np.empty((64, 3)), np.zeros((0, 4))
        for bearing in np.linspace(-3, 3, 50):
            count = ray_hits(0.0, 0.0, math.cos(bearing), math.sin(bearing), none, rounds, np.zeros((0, 3)), hits)
            points = hits[:count, :1] * [[math.cos(bearing), math.sin(bearing)]]
            on_circle = np.isclose(np.hypot(points[:, 0] - 1, points[:, 1]), 2.0)
            on_arc = np.isclose(np.hypot(points[:, 0] - 4, points[:, 1] - 3), 1.0) & (points[:, 1] >= 3.0 - 1e-9)
            assert np.all(on_circle | on_arc)
            assert on_circle.sum() == 1  # the robot stands inside the circle
        count = circle_hits(0.0, 0.0, 2.0, none, rounds, np.zeros((0, 3)), hits)
        assert count == 2
        directions = hits[:2, 0]
        np.testing.assert_allclose(np.hypot(2 * np.cos(directions) - 1, 2 * np.sin(directions)), 2.0)

    def test_a_body_hides_what_is_behind_it_as_far_as_its_height_says(self) -> None:
        high, low = occluders([(2.0, 0.0, 0.25, 0.8)], 0.8), occluders([(2.0, 0.0, 0.25, 0.4)], 0.8)
        for bodies, farthest in ((high, 50.0), (low, 2.25 * 0.8 / 0.4)):
            assert not hidden(0.0, 0.0, 1.7, 0.0, bodies)
            assert hidden(0.0, 0.0, 1.8, 0.0, bodies)
            assert hidden(0.0, 0.0, farthest - 0.01, 0.0, bodies)
            assert not hidden(0.0, 0.0, 3.0, 1.0, bodies)
        assert not hidden(0.0, 0.0, 4.6, 0.0, low)


class TestObservedLines:
    def test_without_noise_every_point_lies_on_a_line_or_a_mark(self) -> None:
        observer = head()
        points = observer.observe(POSE, np.random.default_rng(0))
        assert len(points) > 100
        placed = POSE.transform(points.positions_m)
        marks = np.min([np.hypot(*(placed - disc[:2]).T) for disc in observer.field.discs], axis=0)
        assert np.all((line_distances(observer, POSE, points.positions_m) < 1e-3) | (marks < 0.08))

    def test_points_fall_on_the_pixels_they_are_given(self) -> None:
        observer = head()
        points = observer.observe(POSE, np.random.default_rng(0))
        np.testing.assert_allclose(observer.camera.ground_from_image(points.pixels), points.positions_m, atol=1e-9)

    def test_covariances_are_those_of_the_detector(self) -> None:
        observer = head()
        points = observer.observe(POSE, np.random.default_rng(0))
        jacobians = observer.camera.ground_jacobian(points.pixels)
        settings = observer.detector
        expected = settings.noise_px**2 * jacobians @ jacobians.transpose(0, 2, 1) + settings.noise_m**2 * np.eye(2)
        np.testing.assert_allclose(points.covariances_m2, expected, rtol=0.01, atol=1e-6)

    def test_nothing_is_seen_behind_a_robot_or_in_a_black_sector(self) -> None:
        observer = head()
        bodies = np.array([(*POSE.transform(np.array([0.8, 1.26])), 0.3, 0.8)])
        free = observer.observe(POSE, np.random.default_rng(0))
        hiding = observer.observe(POSE, np.random.default_rng(0), bodies)
        assert len(hiding) < len(free)
        assert not any(hidden(*POSE[:2], x, y, occluders(bodies, 0.8)) for x, y in POSE.transform(hiding.positions_m))
        sector = np.radians([[-30.0, 60.0]])
        black = observer.observe(POSE, np.random.default_rng(0), None, sector)
        bearings = np.degrees(np.arctan2(black.positions_m[:, 1], black.positions_m[:, 0]))
        assert len(black) > 50
        assert not np.any((bearings > -30.0) & (bearings < 60.0))

    def test_the_view_of_a_forward_camera_ends_at_its_sides(self) -> None:
        observer = ObservedLines(leaning_view(1.1, 493.0, 6.5), open_field("indoor-9x6"), SILENT, view_rad=0.6)
        points = observer.observe(Pose(-2.0, 0.5, 0.0), np.random.default_rng(0))
        assert len(points) > 30
        assert np.abs(np.arctan2(points.positions_m[:, 1], points.positions_m[:, 0])).max() <= 0.6 + 1e-6

    def test_points_err_along_their_ray_by_the_documented_mixture(self) -> None:
        noise = SILENT.model_copy(
            update={"noise_px": 0.2, "wild_px": 0.8, "wild_share": 0.25, "circle_share": 0.0, "thin_px": 0.0,
                    "oblique_px": 1e6}
        )  # fmt: skip
        observer = ObservedLines(leaning_view(0.8, 190.0, 9.0), open_field("msl-18x12"), noise)
        truth = ObservedLines(observer.camera, observer.field, SILENT.model_copy(update={"circle_share": 0.0}))
        exact = truth.observe(POSE, np.random.default_rng(0)).pixels
        middle = np.array(observer.camera.center)
        errors = []
        for seed in range(60):
            pixels = observer.observe(POSE, np.random.default_rng(seed)).pixels
            assert len(pixels) == len(exact)
            errors.append(np.hypot(*(pixels - middle).T) - np.hypot(*(exact - middle).T))
        found = np.concatenate(errors)
        assert found.mean() == pytest.approx(0.0, abs=0.02)
        assert found.std() == pytest.approx(math.sqrt(0.75 * 0.2**2 + 0.25 * 0.8**2), rel=0.05)
        assert np.mean(np.abs(found) < 0.4) == pytest.approx(0.75 * 0.9545 + 0.25 * 0.3829, abs=0.02)

    def test_misses_and_false_points_come_as_often_as_documented(self) -> None:
        observer = head()
        every = len(observer.observe(POSE, np.random.default_rng(0)))
        fewer = ObservedLines(
            observer.camera, observer.field, SILENT.model_copy(update={"found_share": 0.6, "circle_share": 0.6})
        )
        counts = [len(fewer.observe(POSE, np.random.default_rng(s))) for s in range(100)]
        assert np.mean(counts) == pytest.approx(0.6 * every, rel=0.03)
        nothing = {"found_share": 0.0, "circle_share": 0.0}
        strays = ObservedLines(
            observer.camera, observer.field, SILENT.model_copy(update={**nothing, "false_points": 3.0})
        )
        assert np.mean([len(strays.observe(POSE, np.random.default_rng(s))) for s in range(300)]) == pytest.approx(
            3, rel=0.1
        )

    def test_the_same_generator_gives_the_same_points(self) -> None:
        observer = ObservedLines(leaning_view(0.8, 190.0, 9.0), open_field("msl-18x12"))
        one, same, other = (observer.observe(POSE, np.random.default_rng(s)).positions_m for s in (1, 1, 2))
        np.testing.assert_array_equal(one, same)
        assert one.shape != other.shape or not np.array_equal(one, other)


def tracking_errors(name: str, level: str, seed: int) -> FloatArray:
    """(N, 2) position error (m) and heading error (rad) of nubot-mti at two frames a second, tracked frames only."""
    scenario = open_scenario(name, seed, 45.0)
    scenario = scenario.model_copy(update={"camera": scenario.camera.model_copy(update={"rate_hz": 2.0})})
    simulation = Simulation(scenario, level)
    system = open_system("nubot-mti", simulation.field, simulation.camera if level == "images" else None)
    errors = []
    for index, frame in enumerate(simulation):
        estimate, truth = system.step(frame), simulation.truth[index]
        if index >= 3 and estimate.status is Status.TRACKING:
            heading = float(wrap_angles(estimate.pose.heading - truth.heading))
            errors.append((estimate.pose.distance_to(truth), abs(heading)))
    assert len(errors) >= 0.9 * (len(simulation) - 3)
    return np.array(errors)


def root_mean_square(errors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Of errors (N, 2) by columns, with its relative standard error."""
    squares = errors**2
    mean = squares.mean(axis=0)
    return np.sqrt(mean), squares.std(axis=0) / (2.0 * mean * math.sqrt(len(errors)))


@pytest.mark.parametrize("name", ["straight-tracks", "match", "tour-20"])
def test_both_levels_give_a_system_the_same_error_statistics(name: str) -> None:
    """Mean and root mean square of position and heading errors, of 87 images and 261 observations of each scenario.

    They agree within 20 %, widened by the standard error that samples of this size have.
    """
    rendered = tracking_errors(name, "images", seed=1)
    observed = np.concatenate([tracking_errors(name, "points", seed) for seed in (1, 2, 3)])
    (seen, seen_error), (wanted, wanted_error) = root_mean_square(observed), root_mean_square(rendered)
    assert np.all(np.abs(observed.mean(axis=0) / rendered.mean(axis=0) - 1.0) <= 0.2)
    assert np.all(np.abs(seen / wanted - 1.0) <= 0.2 + np.hypot(seen_error, wanted_error))
