"""The observation level: line points without images, as perception would deliver them."""

from __future__ import annotations

import math

import numpy as np

from touchline.field import open_field
from touchline.geometry import FloatArray, Pose
from touchline_lab.simulation.observation.crossings import PLAIN, hidden
from touchline_lab.simulation.observation.goal_clutter import GoalClutter
from touchline_lab.simulation.observation.observed_lines import ObservedLines, leaning_view, occluders
from touchline_lab.simulation.observation.point_errors import ObservationNoise
from touchline_lab.simulation.observation.runs import BAR, circle_runs, ray_runs, round_table, segment_table

NO_CLUTTER = GoalClutter(net_points=0.0, side_points=0.0)
SILENT = ObservationNoise(
    noise_px=0.0, frame_px=0.0, blur_px=0.0, found_ratio=1.0, circle_ratio=1.0, mixed_ratio=1.0, thin_half_px=-9.0,
    flat_half=-9.0, coarse_half_m=9.0, long_slope_px=1e-3, bar_ratio=0.0, mark_ratio=1.0, false_points=0.0,
    white_goals=NO_CLUTTER, coloured_goals=NO_CLUTTER, covered_goals=NO_CLUTTER,
)  # fmt: skip
POSE = Pose(2.0, -1.5, 0.7)


def head() -> ObservedLines:
    """A virtual detector with a camera 0.8 m high and 0.3 degrees per pixel on the large field."""
    return ObservedLines(leaning_view(0.8, 190.0, 9.0), open_field("msl-18x12"), SILENT)


def line_distances(observer: ObservedLines, pose: Pose, positions: FloatArray) -> FloatArray:
    return observer.field.line_distances(pose.transform(positions))


NO_ROUNDS, NO_DISCS = np.zeros((0, 5)), np.zeros((0, 3))
WIDTH_M = 0.1


def inside_paint(points: FloatArray, segments: FloatArray, circles: FloatArray) -> np.ndarray:
    """(N,) whether points lie on segments (with half a width beyond their ends) or circles, by plain distances."""
    inside = np.zeros(len(points), dtype=bool)
    for x1, y1, x2, y2 in segments:
        length = math.hypot(x2 - x1, y2 - y1)
        along = ((points[:, 0] - x1) * (x2 - x1) + (points[:, 1] - y1) * (y2 - y1)) / length
        across = ((points[:, 1] - y1) * (x2 - x1) - (points[:, 0] - x1) * (y2 - y1)) / length
        inside |= (np.abs(across) <= 0.5 * WIDTH_M) & (np.abs(along - 0.5 * length) <= 0.5 * (length + WIDTH_M))
    for cx, cy, radius in circles:
        inside |= np.abs(np.hypot(points[:, 0] - cx, points[:, 1] - cy) - radius) <= 0.5 * WIDTH_M
    return inside


class TestGeometry:
    def test_rays_run_on_paint_where_plain_distances_say(self) -> None:
        rng = np.random.default_rng(1)
        segments, circles, runs = rng.uniform(-5, 5, (12, 4)), np.array([[1.0, 0.0, 2.0]]), np.empty((64, 4))
        paint = segment_table(segments, WIDTH_M), round_table(circles, np.zeros((0, 5))), NO_DISCS
        along = np.arange(0.0005, 6.0, 0.001)
        for bearing in rng.uniform(-math.pi, math.pi, 25):
            c, s = math.cos(bearing), math.sin(bearing)
            count = ray_runs(0.3, -0.2, c, s, paint, WIDTH_M, 9.0, runs)
            painted = np.any((along[:, None] > runs[:count, 0]) & (along[:, None] < runs[:count, 1]), axis=1)
            expected = inside_paint(np.column_stack((0.3 + along * c, -0.2 + along * s)), segments, circles)
            assert np.count_nonzero(painted != expected) <= 2 * count  # half a step at every end

    def test_circles_run_on_paint_where_plain_distances_say(self) -> None:
        rng = np.random.default_rng(2)
        middles, leans = rng.uniform(-4, 4, (12, 2)), rng.uniform(0, math.pi, 12)
        steps = 20.0 * np.column_stack((np.cos(leans), np.sin(leans)))
        segments, circles, runs = (
            np.hstack((middles - steps, middles + steps)),
            np.array([[1.0, 0.0, 2.0]]),
            np.empty((64, 4)),
        )
        paint = segment_table(segments, WIDTH_M), round_table(circles, np.zeros((0, 5))), NO_DISCS
        angles = np.arange(0.00025, 2.0 * math.pi, 0.0005)
        for reach in (0.7, 1.6, 2.4, 3.3, 4.1):
            count = circle_runs(0.3, -0.2, reach, paint, WIDTH_M, runs)
            gone = (angles[:, None] - runs[:count, 0]) % (2.0 * math.pi)
            painted = np.any(gone < runs[:count, 1] - runs[:count, 0], axis=1)
            points = np.column_stack((0.3 + reach * np.cos(angles), -0.2 + reach * np.sin(angles)))
            assert np.count_nonzero(painted != inside_paint(points, segments, circles)) <= 2 * count
            assert count >= 2

    def test_circles_miss_lines_that_end_before_them(self) -> None:
        runs = np.empty((64, 4))
        for end, count in ((1.8, 0), (2.2, 1)):
            bars = segment_table(np.array([[0.3, 0.0, end, 0.0]]), WIDTH_M)
            assert circle_runs(0.0, 0.0, 2.0, (bars, NO_ROUNDS, NO_DISCS), WIDTH_M, runs) == count

    def test_a_body_hides_what_is_behind_it_as_far_as_its_height_says(self) -> None:
        high, low = (occluders(np.array([[2.0, 0.0, 0.25, height_m]]), 0.8) for height_m in (0.8, 0.4))
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
        crossings = observer.crossings(POSE)
        crossings = crossings[crossings[:, 5] != BAR]
        placed = POSE.transform(points.positions_m)
        marks = np.min([np.hypot(*(placed - disc[:2]).T) for disc in observer.field.discs], axis=0)
        off = np.minimum(line_distances(observer, POSE, points.positions_m), np.where(marks < 0.1, 0.0, np.inf))
        plain = crossings[:, 10] == PLAIN
        assert plain.sum() > 0.9 * len(points)
        assert np.median(off[plain]) < 1e-3
        assert np.all(off[plain] < 0.01)  # the middle of a bent line on a path lies a little beside it

    def test_nothing_is_seen_behind_a_robot_or_in_a_black_sector(self) -> None:
        observer = head()
        bodies = np.array([(*POSE.transform(np.array([0.8, 1.26])), 0.3, 0.8)])
        free = observer.observe(POSE, np.random.default_rng(0))
        hiding = observer.observe(POSE, np.random.default_rng(0), bodies)
        assert len(hiding) < len(free)
        assert not any(hidden(*POSE[:2], x, y, occluders(bodies, 0.8)) for x, y in POSE.transform(hiding.positions_m))
        sector = np.radians([[-30.0, 60.0]])
        black = observer.observe(POSE, np.random.default_rng(0), black_rad=sector)
        bearings = np.degrees(np.arctan2(black.positions_m[:, 1], black.positions_m[:, 0]))
        assert len(black) > 50
        assert not np.any((bearings > -29.99) & (bearings < 59.99))  # along the very edge half a ray is seen


# Headings along the tracks lie askew of the image's rows: along them, all points on one line err alike in an image, and
# the heading gains a fifth from that, which the observation level does not know.


# scenario, its mirror as built, images per second, seconds
