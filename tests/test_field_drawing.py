"""The drawing of the field: paint where it belongs, at its true width."""

from __future__ import annotations

import math

import numpy as np
import pytest

from touchline.errors import InputError
from touchline.field import FieldModel, open_field, preset_names
from touchline.field.drawing import CARPET, COLORS, NET, PAINT, draw_field, field_view
from touchline.geometry import ByteArray, FloatArray


def paint_area_m2(field: FieldModel, pixels_per_metre: float) -> float:
    """Area covered with paint, from the share of paint in each pixel's red channel."""
    red = draw_field(field, pixels_per_metre)[..., 2].astype(np.float64)
    return float(np.sum((red - CARPET[2]) / (PAINT[2] - CARPET[2])) / pixels_per_metre**2)


def color_at(picture: ByteArray, field: FieldModel, point: tuple[float, float]) -> tuple[int, ...]:
    u, v = np.round(field_view(field, 100.0).picture_from_field([point])[0]).astype(int)
    return tuple(int(channel) for channel in picture[v, u])


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow if "9x6" not in n else ()) for n in preset_names()]
)
def test_pixels_are_white_exactly_where_paint_lies(name: str) -> None:
    field = open_field(name)
    bare = FieldModel(
        name=name, length=field.length, width=field.width, line_width=field.line_width, border=field.border,
        segments=field.segments, circles=field.circles, arcs=field.arcs,
    )  # fmt: skip
    scale = 80.0
    picture, view = draw_field(bare, scale), field_view(bare, scale)
    v, u = np.mgrid[0 : view.height, 0 : view.width]
    points: FloatArray = np.stack(
        ((u - 0.5 * (view.width - 1)) / scale, (0.5 * (view.height - 1) - v) / scale), axis=-1
    ).reshape(-1, 2)
    np.testing.assert_allclose(view.picture_from_field(points)[:, 0], u.ravel(), atol=1e-9)
    distance = bare.line_distances(points).reshape(u.shape)
    on_field = (np.abs(points) <= (0.5 * bare.length, 0.5 * bare.width)).all(axis=1).reshape(u.shape)
    inside = on_field & (distance < 0.5 * bare.line_width - 1.0 / scale)  # corner arcs end with the field
    outside = distance > 0.5 * bare.line_width * math.sqrt(2.0) + 1.0 / scale  # corners are square
    assert np.all(picture[inside] == PAINT)
    assert np.all(picture[outside] == CARPET)
    assert inside.any()


@pytest.mark.parametrize("pixels_per_metre", [20.0, 50.0, 80.0])
def test_paint_has_its_true_width_at_any_scale(pixels_per_metre: float) -> None:
    bar = FieldModel(name="bar", length=4, width=4, line_width=0.125, segments=[(-1.0, 0.0, 1.0, 0.0)])
    ring = FieldModel(name="ring", length=4, width=4, line_width=0.125, circles=[(0.0, 0.0, 1.0)])
    bow = FieldModel(name="bow", length=4, width=4, line_width=0.125, arcs=[(0.0, 0.0, 1.0, 1.0, 3.0)])
    assert paint_area_m2(bar, pixels_per_metre) == pytest.approx(2.125 * 0.125, rel=0.03)
    assert paint_area_m2(ring, pixels_per_metre) == pytest.approx(2.0 * math.pi * 0.125, rel=0.03)
    assert paint_area_m2(bow, pixels_per_metre) == pytest.approx(2.0 * 0.125, rel=0.05)


def test_x_goes_right_and_y_goes_up() -> None:
    view = field_view(open_field("msl-18x12"), 10.0)
    assert (view.width, view.height) == (210, 150)
    np.testing.assert_allclose(
        view.picture_from_field([(0, 0), (1, 0), (0, 1)]), [(104.5, 74.5), (114.5, 74.5), (104.5, 64.5)]
    )


def test_goals_poles_and_marks_are_drawn_in_their_colours() -> None:
    field = open_field("indoor-9x6")
    picture = draw_field(field, 100.0)
    assert color_at(picture, field, (4.475, 1.3)) == COLORS["blue"]
    assert color_at(picture, field, (-4.475, -1.3)) == COLORS["yellow"]
    assert color_at(picture, field, (4.8, 0.0)) == NET
    assert color_at(picture, field, (0.0, 3.3)) == COLORS["yellow"]
    assert color_at(picture, field, (0.05, -3.3)) == COLORS["yellow"]
    assert color_at(picture, field, (0.085, -3.3)) == COLORS["blue"]
    assert color_at(picture, field, (3.2, 0.0)) == PAINT
    assert color_at(picture, field, (3.3, 0.0)) == CARPET


def test_strips_of_a_large_picture_join_without_a_seam() -> None:
    field = FieldModel(name="cross", length=8, width=8, line_width=0.1, segments=[(0.0, -3.0, 0.0, 3.0)])
    picture = draw_field(field, 120.0)
    middle = picture[260:940]
    assert np.all(middle == middle[0])


def test_the_margin_can_be_chosen() -> None:
    assert draw_field(open_field("spl-9x6"), 20.0, margin_m=0.0).shape == (121, 181, 3)


@pytest.mark.parametrize("scale", [0.0, -1.0, math.nan, 1e5])
def test_a_scale_that_makes_no_picture_is_refused(scale: float) -> None:
    with pytest.raises(InputError, match="field drawing"):
        draw_field(open_field("spl-9x6"), scale)
