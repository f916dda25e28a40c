"""Crossings typed L, T and X with their orientation, counted by hand on the drawn fields."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from touchline.field import Crossing, FieldModel, open_field, preset_names
from touchline.types import CrossingKind

DEGREE = math.pi / 180.0


def found(field: FieldModel, kind: str, curved: bool | None = None) -> list[tuple[float, float, int]]:
    """x, y (mm accuracy) and orientation (whole degrees) of the crossings of a kind."""
    return sorted(
        (round(c.x, 3), round(c.y, 3), round(c.orientation_rad / DEGREE))
        for c in field.crossings
        if c.kind.value == kind and curved in (None, c.curved)
    )


def four_ways(x: float, y: float, degrees: int) -> list[tuple[float, float, int]]:
    """The crossing at x, y > 0 and its three mirror images."""
    images = ((1, 1, degrees), (-1, 1, 180 - degrees), (1, -1, -degrees), (-1, -1, degrees - 180))
    return [(sx * x, sy * y, (d + 179) % 360 - 179) for sx, sy, d in images]


def test_msl_18x12_has_its_crossings_where_the_rules_put_them() -> None:
    field = open_field("msl-18x12")
    corners = [*four_ways(8.938, 5.938, -135), *four_ways(6.812, 3.188, -45), *four_ways(8.312, 1.688, -45)]
    assert found(field, "L") == sorted(corners)
    stems = [*four_ways(8.938, 3.188, 180), *four_ways(8.938, 1.688, 180), (0.0, 5.938, -90), (0.0, -5.938, 90)]
    assert found(field, "T", curved=False) == sorted(stems)
    assert found(field, "X") == [(0.0, -1.938, 0), (0.0, 1.938, 0)]


def test_msl_corner_arcs_make_tees_on_both_lines_whose_stem_is_the_arc() -> None:
    at = 9.0 - math.sqrt(0.6875**2 - 0.0625**2)  # where the arc meets the middle of the touch line
    tilt = math.degrees(math.asin(0.0625 / 0.6875))
    arcs = [c for c in open_field("msl-18x12").crossings if c.kind is CrossingKind.T and c.curved]
    assert len(arcs) == 8
    first = next(c for c in arcs if c.x > 0 and c.y > 5.9)
    assert (first.x, first.y) == pytest.approx((at, 5.9375))
    assert first.orientation_rad == pytest.approx((-90.0 + tilt) * DEGREE)


def test_indoor_9x6_has_eight_corners_six_tees_and_two_crosses() -> None:
    field = open_field("indoor-9x6")
    assert found(field, "L") == sorted([*four_ways(4.475, 2.975, -135), *four_ways(3.925, 1.075, -45)])
    assert found(field, "T") == sorted([*four_ways(4.475, 1.075, 180), (0.0, 2.975, -90), (0.0, -2.975, 90)])
    assert found(field, "X") == [(0.0, -0.725, 0), (0.0, 0.725, 0)]


@pytest.mark.parametrize("name", preset_names())
def test_half_a_turn_maps_the_crossings_onto_themselves(name: str) -> None:
    crossings = open_field(name).crossings
    for c in crossings:
        turned = c.orientation_rad + (0.0 if c.kind is CrossingKind.X else math.pi)
        assert any(
            o.kind is c.kind
            and math.hypot(o.x + c.x, o.y + c.y) < 1e-6
            and abs(math.remainder(o.orientation_rad - turned, 2 * math.pi)) < 1e-5
            for o in crossings
        ), c


def crossings_of(*segments: tuple[float, float, float, float], **more: object) -> list[Crossing]:
    parts = {"segments": np.array(segments), **more}
    return list(FieldModel(name="t", length=9, width=9, line_width=0.1, **parts).crossings)  # type: ignore[arg-type]


def test_an_l_points_into_its_opening() -> None:
    (corner,) = crossings_of((0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 2.0))
    assert (corner.kind, corner.x, corner.y) == (CrossingKind.L, 0.0, 0.0)
    assert corner.orientation_rad == pytest.approx(math.pi / 4)


def test_a_t_points_along_its_stem() -> None:
    (tee,) = crossings_of((-1.0, 0.0, 1.0, 0.0), (0.2, 0.0, 0.2, -2.0))
    assert (tee.kind, tee.x, tee.y) == (CrossingKind.T, pytest.approx(0.2), pytest.approx(0.0))
    assert tee.orientation_rad == pytest.approx(-math.pi / 2)


def test_an_x_has_the_direction_of_an_arm_within_a_quarter_turn() -> None:
    c, s = math.cos(2.0), math.sin(2.0)
    (cross,) = crossings_of((-c, -s, c, s), (-s, c, s, -c))
    assert cross.kind is CrossingKind.X
    assert cross.orientation_rad == pytest.approx(2.0 - math.pi / 2)


@pytest.mark.parametrize("gap", [-0.09, -0.05, 0.0, 0.05, 0.09])
def test_paint_that_ends_within_a_line_width_of_a_line_touches_it_and_does_not_cross_it(gap: float) -> None:
    (tee,) = crossings_of((-1.0, 0.0, 1.0, 0.0), (0.0, gap, 0.0, 2.0))
    assert tee.kind is CrossingKind.T


def test_paint_that_ends_farther_from_a_line_does_not_touch_it() -> None:
    assert crossings_of((-1.0, 0.0, 1.0, 0.0), (0.0, 0.11, 0.0, 2.0)) == []


def test_a_line_painted_in_two_pieces_crosses_like_one() -> None:
    (tee,) = crossings_of((-1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 2.0))
    assert tee.kind is CrossingKind.T
    assert tee.orientation_rad == pytest.approx(math.pi / 2)


def test_lines_that_go_straight_on_or_only_touch_a_circle_make_no_crossing() -> None:
    assert crossings_of((-1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0)) == []
    assert crossings_of((-2.0, 1.0, 2.0, 1.0), circles=np.array([(0.0, 0.0, 1.0)])) == []


def test_two_circles_cross_twice() -> None:
    crosses = crossings_of(circles=np.array([(-0.6, 0.0, 1.0), (0.6, 0.0, 1.0)]))
    assert [(c.kind, round(c.x, 9), round(c.y, 9)) for c in crosses] == [
        (CrossingKind.X, 0.0, -0.8),
        (CrossingKind.X, 0.0, 0.8),
    ]


@settings(deadline=None)
@given(st.floats(-3.1, 3.1), st.floats(-2.0, 2.0), st.floats(-2.0, 2.0))
def test_turning_and_moving_a_field_turns_and_moves_its_crossings(turn: float, dx: float, dy: float) -> None:
    segments = np.array([(-1.0, 0.0, 1.0, 0.0), (0.2, 0.0, 0.2, -2.0), (1.0, 0.0, 1.0, 1.5)])
    c, s = math.cos(turn), math.sin(turn)
    rotation = np.array(((c, -s), (s, c)))
    moved = np.concatenate((segments[:, :2] @ rotation.T + (dx, dy), segments[:, 2:] @ rotation.T + (dx, dy)), axis=1)
    before, after = crossings_of(*segments), crossings_of(*moved)
    assert len(before) == len(after) == 2
    for one, other in zip(before, sorted(after, key=lambda o: o.kind), strict=True):
        assert one.kind is other.kind
        np.testing.assert_allclose(rotation @ (one.x, one.y) + (dx, dy), (other.x, other.y), atol=1e-9)
        assert abs(math.remainder(other.orientation_rad - one.orientation_rad - turn, 2 * math.pi)) < 1e-9
