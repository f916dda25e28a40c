"""Registration at the statistical bound, and the search that needs no start."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from line_scenes import load_point_sets, polar_covariances

from touchline.field import FieldModel, open_field
from touchline.field.offset_map import offset_table
from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.localization.registration.kernels import Plan, register
from touchline.localization.registration.registration import TRACKING, Registration
from touchline.localization.registration.unseen import count_unseen, unseen, view_of
from touchline.localization.search.pose_search import PoseSearch, Wanted
from touchline.types import LinePoints, points_at
from touchline_lab.points.bound import bound_covariance

FIELD = open_field("msl-18x12")
REGISTRATION = Registration(FIELD.distance_map())
NOISE = (0.02, 0.01, 0.0087)


class PointSet(NamedTuple):
    field: FieldModel
    points: list[LinePoints]
    truth: FloatArray


@pytest.fixture(scope="module")
def point_set(small_data: Path) -> PointSet:
    """What a robot saw at 100 places."""
    sets = load_point_sets(small_data)
    places = [sets.frame(k) for k in range(100)]
    frames = [replace(points_at(each), covariances_m2=polar_covariances(each)) for each in places]
    return PointSet(sets.field, frames, sets.truth)


def lines_near(pose: Pose, reach_m: float) -> FloatArray:
    """Points of the lines within reach of a pose, robot frame, without noise."""
    seen = pose.inverse().transform(np.vstack(FIELD.polylines(0.15)))
    return np.ascontiguousarray(seen[np.hypot(*seen.T) < reach_m])


def step_in_numpy(points: FloatArray, covariances: FloatArray, pose: FloatArray, plan: Plan) -> FloatArray:
    """One Gauss-Newton step of `kernels.register`, from exact offsets."""
    place = Pose(*pose)
    seen = place.transform(points)
    step = 1e-4
    slopes = [
        (FIELD.line_distances(seen + axis) - FIELD.line_distances(seen - axis)) / (2 * step)
        for axis in step * np.eye(2)
    ]
    distances, normals = FIELD.line_distances(seen), np.column_stack(slopes)
    in_robot = place.inverse()._replace(x=0.0, y=0.0).transform(normals)
    foot = points - distances[:, None] * in_robot
    ratio = (np.sum(foot**2, axis=1) + 0.01) / (np.sum(points**2, axis=1) + 0.01)
    variances = np.clip(ratio, 0.5, 2.0) * np.einsum("ni,nij,nj->n", in_robot, covariances, in_robot) + plan.floor_m2
    reach = plan.widths_m[0] ** 2 + plan.gate2 * variances
    weights = (reach / (reach + distances**2)) ** 2 / variances
    lever = seen - pose[:2]
    u = np.column_stack((normals, normals[:, 1] * lever[:, 0] - normals[:, 0] * lever[:, 1]))
    return np.asarray(pose - np.linalg.solve((u.T * weights) @ u + np.eye(3), u.T @ (weights * distances)))


def test_a_step_is_that_of_plain_numpy() -> None:
    truth = Pose(3.2, -1.4, 0.5)
    points = lines_near(truth, 4.0) + np.random.default_rng(2).normal(0.0, 0.04, lines_near(truth, 4.0).shape)
    covariances, start = polar_covariances(points, NOISE), np.add(truth, [0.08, -0.05, 0.03])
    plan = TRACKING._replace(widths_m=np.array([0.3]))
    found = register(points, covariances, offset_table(FIELD.distance_map()), start, plan).pose
    assert found == pytest.approx(step_in_numpy(points, covariances, start, plan), abs=1e-3)


def test_offsets_are_exact_on_a_straight_line() -> None:
    truth = Pose(4.0, -2.0, 0.7)
    points = lines_near(truth, 3.0)
    found = REGISTRATION.register(points, polar_covariances(points, NOISE), np.add(truth, [0.1, 0.1, 0.05]))
    assert found.pose == pytest.approx(np.array(truth), abs=2e-3)
    assert found.explained == 1.0
    assert found.noise < 0.01


def test_a_lone_line_leaves_the_way_along_it_open() -> None:
    noise = np.random.default_rng(4).normal(0.0, 0.01, 60)
    points = np.column_stack((np.linspace(-2.0, 2.0, 60), 1.5 + noise))  # of the side line, y = 5.94
    start = np.array([4.5, 4.45, 0.02])
    found = REGISTRATION.register(points, polar_covariances(points, NOISE), start)
    assert found.pose[:2] == pytest.approx([4.5, FIELD.width / 2 - 0.0625 - 1.5], abs=0.02)
    assert found.covariance[0, 0] > 1.0
    assert found.covariance[1, 1] < 0.02**2


def test_no_points_say_nothing() -> None:
    none = np.zeros((0, 2))
    found = REGISTRATION.register(none, polar_covariances(none, NOISE), np.array([1.0, 2.0, 0.3]))
    assert found.pose == pytest.approx([1.0, 2.0, 0.3])
    assert found.explained == 0.0
    assert found.covariance[0, 0] > 50.0
    assert PoseSearch(FIELD, REGISTRATION).everywhere(none, polar_covariances(none, NOISE)) == ()


def test_the_covariance_is_honest(point_set: PointSet) -> None:
    registration = Registration(point_set.field.distance_map())
    squares = []
    for points, truth in zip(point_set.points, point_set.truth, strict=False):
        found = registration.register(points.positions_m, points.covariances_m2, np.add(truth, [0.05, -0.05, 0.02]))
        error = found.pose - truth
        error[2] = wrap_angle(float(error[2]))
        squares.append(error @ np.linalg.solve(found.covariance, error) / 3.0)
    assert 0.8 < float(np.mean(squares)) < 1.2


def slope(pose: Pose, step: FloatArray, points: FloatArray) -> FloatArray:
    """Derivative (N,) of the distances of points from the lines, along a step (3,) of 1e-5 of the pose."""
    ahead, behind = (Pose(*np.add(pose, side * step)).transform(points) for side in (1, -1))
    return (FIELD.line_distances(ahead) - FIELD.line_distances(behind)) / 2e-5


def test_the_bound_of_a_cross() -> None:
    """Points of two lines at right angles, with 3 cm noise: 3 cm over the root of their number in each direction."""
    truth = Pose(0.0, 3.0, 0.0)  # beside the halfway line and the side line
    along_y = np.column_stack((np.full(25, 0.01), np.linspace(-0.5, 2.5, 25)))
    along_x = np.column_stack((np.linspace(-3.0, -0.5, 36), np.full(36, FIELD.width / 2 - 0.0625 - 3.0 + 0.01)))
    points = np.vstack((along_y, along_x))
    covariance = bound_covariance(FIELD, points, np.tile(0.03**2 * np.eye(2), (61, 1, 1)), truth)
    slopes = [slope(truth, step, points) for step in 1e-5 * np.eye(3)]
    assert np.linalg.inv(covariance) == pytest.approx(
        np.array(slopes) @ np.transpose(slopes) / 0.03**2, rel=1e-3, abs=1.0
    )
    fixed = np.linalg.inv(np.linalg.inv(covariance)[:2, :2])
    assert np.sqrt(np.diag(fixed)) == pytest.approx([0.03 / 5.0, 0.03 / 6.0], rel=1e-3)


def test_without_a_bound_the_points_leave_the_pose_open() -> None:
    line = np.column_stack((np.linspace(-2.0, 2.0, 20), np.full(20, 1.0)))
    with pytest.raises(ValueError, match="leave the pose open"):
        bound_covariance(FIELD, line, np.tile(1e-3 * np.eye(2), (20, 1, 1)), Pose(4.5, FIELD.width / 2 - 1.0, 0.0))


FAR = np.array([50.0, 0.0, 0.0])


def test_the_wanted_mode_is_found_and_others_are_left(point_set: PointSet) -> None:
    search = PoseSearch(point_set.field, Registration(point_set.field.distance_map()))
    for k in range(20):
        points = point_set.points[k]
        best = search.everywhere(points.positions_m, points.covariances_m2)[0]
        given, least = (points.positions_m, points.covariances_m2), best.log_likelihood - 5.0
        found = search.everywhere(*given, wanted=Wanted(FAR, least, -math.inf))
        assert found[0].pose.distance_to(best.pose) < 1e-6
        assert search.everywhere(*given, wanted=Wanted(FAR, least + 265.0, -math.inf)) == ()
        ends = best.pose, best.pose.mirrored()
        for followed in ends:
            others = search.everywhere(*given, wanted=Wanted(followed.as_array(), least, -math.inf))
            assert all(one.pose.distance_to(end) > 0.05 for one in others for end in ends)


def test_the_followed_pose_and_its_twin_are_excluded() -> None:
    wanted = Wanted(np.array([2.0, 1.0, 3.1]), 0.0, 0.0)
    assert wanted.excludes((2.05, 0.96, 3.1 - 2.0 * math.pi), twins=False)
    assert not wanted.excludes((2.0, 1.0, 3.04), twins=False)
    assert not wanted.excludes((2.11, 1.0, 3.1), twins=True)
    assert not wanted.excludes((-2.0, -1.0, 3.1 - math.pi), twins=False)
    assert wanted.excludes((-2.0, -1.0, 3.1 - math.pi), twins=True)


def test_lines_that_were_not_seen_are_counted() -> None:
    """The arms of a corner: each is predicted, and missing where it was looked past it."""
    corner = Pose(-8.0, -5.0, 0.0)
    seen = lines_near(corner, 4.0)
    poses = np.array([corner, (0.0, 0.0, 0.0)], dtype=np.float64)
    assert count_unseen(FIELD.line_tables, poses, view_of(seen))[0, 0] > 30
    missing, elsewhere = unseen(FIELD.line_tables, view_of(seen), poses)
    assert missing == 0
    assert elsewhere > 10  # the centre circle
    left = seen[seen[:, 1] > 0.5]  # what lies to the right was not looked at
    assert unseen(FIELD.line_tables, view_of(left), poses)[0] == 0
