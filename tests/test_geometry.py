"""Poses in space."""

from __future__ import annotations

import math

import numpy as np
import pytest

from touchline.geometry import Pose, Pose3, wrap_angle, wrap_angles


def some_pose(seed: int) -> Pose3:
    rng = np.random.default_rng(seed)
    return Pose3.from_roll_pitch_yaw(*rng.uniform(-1.2, 1.2, 3), translation_m=rng.normal(size=3))


def test_pitch_tips_the_nose_down_roll_lowers_the_right() -> None:
    ahead, right = np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, -1.0, 0.0]])
    assert Pose3.from_roll_pitch_yaw(0.0, 0.1).transform(ahead)[0, 2] < 0.0
    assert Pose3.from_roll_pitch_yaw(0.1, 0.0).transform(right)[0, 2] < 0.0


def test_composed_and_inverted_poses_move_points_as_their_parts_do() -> None:
    first, second = some_pose(1), some_pose(2)
    points = np.random.default_rng(3).normal(size=(5, 3))
    assert first.compose(second).transform(points) == pytest.approx(first.transform(second.transform(points)))
    assert first.inverse().transform(first.transform(points)) == pytest.approx(points)
    assert first.compose(first.inverse()).rotation == pytest.approx(Pose3.identity().rotation, abs=1e-12)


def test_planar_poses_move_points_as_complex_numbers_do() -> None:
    first, second, points = Pose(1.0, -2.0, 0.4), Pose(0.3, 0.7, -2.9), np.array([[1.0, 0.0], [-0.5, 2.0]])

    def turned(pose: Pose, x: float, y: float) -> complex:
        return complex(pose.x, pose.y) + np.exp(1j * pose.heading) * complex(x, y)

    moved = [turned(first, *point) for point in points.tolist()]
    np.testing.assert_allclose(first.transform(points), [(each.real, each.imag) for each in moved])
    place = turned(first, second.x, second.y)
    assert first.compose(second) == pytest.approx((place.real, place.imag, 0.4 - 2.9))
    assert first.compose(first.inverse()) == pytest.approx((0.0, 0.0, 0.0))
    assert first.inverse().compose(first) == pytest.approx((0.0, 0.0, 0.0))


def test_a_pose_of_the_wrong_shape_is_refused() -> None:
    with pytest.raises(ValueError, match=r"rotation \(3, 3\)"):
        Pose3(np.eye(2), np.zeros(3))


def test_an_angle_lies_above_minus_half_a_turn() -> None:
    angles = [-math.pi, math.pi, 3.0 * math.pi, 0.5 - 2.0 * math.pi, -0.5 + 4.0 * math.pi, 0.0]
    expected = pytest.approx([math.pi, math.pi, math.pi, 0.5, -0.5, 0.0])
    assert [wrap_angle(angle) for angle in angles] == expected
    assert wrap_angles(angles) == expected
