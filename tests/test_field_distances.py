"""Distances to lines, and the distance map, against brute force and a plain NumPy twin."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from touchline.errors import InputError
from touchline.field import FieldModel, lookup, open_field
from touchline.geometry import FloatArray

coordinates = st.floats(-3.0, 3.0)
angles = st.floats(-7.0, 7.0)
radii = st.floats(0.05, 2.0)


@st.composite
def fields(draw: st.DrawFn) -> FieldModel:
    """A field of up to two segments, circles and arcs anywhere, at least one line in all."""
    starts = draw(st.lists(st.tuples(coordinates, coordinates), max_size=2))
    segments = [
        (x, y, x + length * math.cos(a), y + length * math.sin(a))
        for x, y in starts
        for length, a in [draw(st.tuples(st.floats(0.1, 3.0), angles))]
    ]
    circles = draw(st.lists(st.tuples(coordinates, coordinates, radii), max_size=2))
    arcs = draw(st.lists(st.tuples(coordinates, coordinates, radii, angles, angles), max_size=2))
    arcs = [arc for arc in arcs if abs(math.remainder(arc[4] - arc[3], 2 * math.pi)) > 0.01]
    if not (segments or circles or arcs):
        segments = [(0.0, 0.0, 1.0, 0.5)]
    return FieldModel(
        name="drawn", length=6.0, width=6.0, line_width=0.1,
        segments=np.array(segments), circles=np.array(circles), arcs=np.array(arcs),
    )  # fmt: skip


points_lists = st.lists(st.tuples(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0)), min_size=1, max_size=5)


def twin_line_distances(field: FieldModel, points: FloatArray) -> FloatArray:
    """The NumPy twin of the compiled loop: distances (N,) by angles instead of dot products."""
    columns = []
    for x1, y1, x2, y2 in field.segments:
        start, step = np.array((x1, y1)), np.array((x2 - x1, y2 - y1))
        share = np.clip((points - start) @ step / (step @ step), 0.0, 1.0)
        columns.append(np.linalg.norm(points - start - share[:, None] * step, axis=1))
    for cx, cy, radius in field.circles:
        columns.append(np.abs(np.hypot(points[:, 0] - cx, points[:, 1] - cy) - radius))
    for cx, cy, radius, start, end in field.arcs:
        sweep = np.mod(end - start, 2 * np.pi)
        bearing = np.mod(np.arctan2(points[:, 1] - cy, points[:, 0] - cx) - start, 2 * np.pi)
        ring = np.abs(np.hypot(points[:, 0] - cx, points[:, 1] - cy) - radius)
        ends = [np.hypot(points[:, 0] - cx - radius * np.cos(a), points[:, 1] - cy - radius * np.sin(a))
                for a in (start, end)]  # fmt: skip
        columns.append(np.where(bearing <= sweep, ring, np.minimum(*ends)))
    return np.min(columns, axis=0)


@settings(deadline=None)
@given(fields(), points_lists)
def test_line_distance_agrees_with_the_numpy_twin(field: FieldModel, where: list[tuple[float, float]]) -> None:
    points = np.array(where)
    np.testing.assert_allclose(field.line_distances(points), twin_line_distances(field, points), atol=1e-7)


def test_line_distances_known_by_hand() -> None:
    field = open_field("msl-18x12")
    points = [(0.0, 0.0), (0.0, 1.9375), (9.2375, 0.0), (4.0, 5.0), (8.9375 + 3.0, 5.9375 + 4.0), (1.0, 0.0)]
    np.testing.assert_allclose(field.line_distances(points), [0.0, 0.0, 0.3, 0.9375, 5.0, 0.9375], atol=1e-12)


def test_arcs_have_ends() -> None:
    quarter = FieldModel(name="q", length=4, width=4, line_width=0.1, arcs=[(0.0, 0.0, 1.0, 0.0, math.pi / 2)])
    points = [(2.0, 0.0), (0.5, 0.5), (-1.0, 0.0), (0.0, -1.0), (1.0, -0.5)]
    expected = [1.0, 1.0 - math.sqrt(0.5), math.sqrt(2.0), math.sqrt(2.0), 0.5]
    np.testing.assert_allclose(quarter.line_distances(points), expected, atol=1e-12)


@pytest.mark.parametrize("end", [2 * math.pi, 6.283186, -2 * math.pi])
def test_an_arc_of_a_whole_turn_is_a_circle_even_with_a_rounded_end(end: float) -> None:
    arc = FieldModel(name="a", length=4, width=4, line_width=0.1, arcs=[(0.2, 0.1, 1.0, 0.0, end)])
    circle = FieldModel(name="c", length=4, width=4, line_width=0.1, circles=[(0.2, 0.1, 1.0)])
    points = np.random.default_rng(1).uniform(-2, 2, (50, 2))
    np.testing.assert_allclose(arc.line_distances(points), circle.line_distances(points), atol=1e-5)


def test_a_nan_point_has_a_nan_distance_and_others_keep_theirs() -> None:
    distances = open_field("indoor-9x6").line_distances([(np.nan, 0.0), (0.0, 1.0), (0.0, np.nan)])
    assert np.isnan(distances).tolist() == [True, False, True]


def test_points_of_another_shape_are_refused() -> None:
    with pytest.raises(ValueError, match=r"\(N, 2\)"):
        open_field("indoor-9x6").line_distances([1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match=r"\(N, 2\)"):
        open_field_once().distance_map(0.1, 1.0).look_up(np.zeros(2))


@settings(max_examples=20, deadline=None)
@given(fields(), st.floats(0.05, 0.3), st.floats(0.0, 1.0))
def test_map_samples_are_exact_at_their_places(field: FieldModel, resolution: float, margin: float) -> None:
    chart = field.distance_map(resolution, margin)
    iy, ix = np.mgrid[0 : chart.values.shape[0], 0 : chart.values.shape[1]]
    places = chart.origin_m + resolution * np.stack((ix.ravel(), iy.ravel()), axis=1)
    np.testing.assert_allclose(chart.values[..., 0].ravel(), twin_line_distances(field, places), rtol=1e-6, atol=1e-6)
    assert chart.values.dtype == np.float32
    assert np.all(places[0] <= -3.0 - margin + 1e-6)
    assert np.all(places[-1] >= 3.0 + margin - 1e-6)


def test_map_gradient_is_the_slope_of_the_distance_away_from_its_ridges() -> None:
    field = open_field("msl-22x14")
    chart = field.distance_map(0.05, 1.0)
    rng = np.random.default_rng(3)
    iy, ix = rng.integers(0, chart.values.shape[0], 3000), rng.integers(0, chart.values.shape[1], 3000)
    places = chart.origin_m + 0.05 * np.stack((ix, iy), axis=1)
    h = 1e-5
    slopes, smooth = [], np.abs(field.line_distances(places)) > 1e-3
    for step in ((h, 0.0), (0.0, h)):
        ahead, behind = field.line_distances(places + step), field.line_distances(places - step)
        slopes.append((ahead - behind) / (2 * h))
        smooth &= np.abs(ahead + behind - 2 * field.line_distances(places)) / h < 1e-2  # no kink within the step
    assert smooth.mean() > 0.9
    np.testing.assert_allclose(chart.values[iy, ix, 1:][smooth], np.stack(slopes, axis=1)[smooth], atol=5e-3)
    np.testing.assert_allclose(np.linalg.norm(chart.values[iy, ix, 1:][smooth], axis=1), 1.0, atol=1e-5)


def test_gradient_on_a_line_and_at_a_circle_centre_is_zero() -> None:
    ring = FieldModel(name="ring", length=4, width=4, line_width=0.1, circles=[(0.0, 0.0, 1.0)])
    chart = ring.distance_map(0.5, 0.0)
    middle = chart.values.shape[0] // 2
    assert chart.values[middle, middle].tolist() == [1.0, 0.0, 0.0]
    assert chart.values[middle, middle + 2].tolist() == [0.0, 0.0, 0.0]


def test_the_default_map_has_samples_every_25_mm_to_3_m_beyond_the_lines() -> None:
    chart = open_field("msl-18x12").distance_map()
    assert chart.values.shape == (721, 961, 3)
    assert chart.resolution_m == 0.025
    np.testing.assert_allclose(chart.origin_m, (-12.0, -9.0), atol=1e-12)


def test_the_same_map_is_computed_once() -> None:
    field = open_field("indoor-9x6")
    assert field.distance_map(0.05) is field.distance_map(0.05)
    assert field.distance_map(0.05) is not field.distance_map(0.06)


@pytest.mark.parametrize(
    ("resolution", "margin"), [(0.0, 1.0), (-0.1, 1.0), (math.nan, 1.0), (0.1, -1.0), (1e-6, 1.0), (0.1, math.inf)]
)
def test_a_map_that_cannot_be_is_refused(resolution: float, margin: float) -> None:
    with pytest.raises(InputError, match="distance map"):
        open_field("indoor-9x6").distance_map(resolution, margin)


def twin_lookup(values: FloatArray, origin: FloatArray, resolution: float, x: float, y: float) -> FloatArray:
    """Bilinear look-up (3,) with the position, not the index, clamped to the map."""
    rows, columns = values.shape[:2]
    fx = float(np.clip((x - origin[0]) / resolution, 0, columns - 1))
    fy = float(np.clip((y - origin[1]) / resolution, 0, rows - 1))
    ix, iy = min(int(fx), columns - 2), min(int(fy), rows - 2)
    table = values.astype(np.float64)
    low = table[iy, ix] + (fx - ix) * (table[iy, ix + 1] - table[iy, ix])
    high = table[iy + 1, ix] + (fx - ix) * (table[iy + 1, ix + 1] - table[iy + 1, ix])
    return low + (fy - iy) * (high - low)


@settings(deadline=None)
@given(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0))
def test_lookup_is_bilinear_and_stays_on_the_map(x: float, y: float) -> None:
    chart = open_field_once().distance_map(0.1, 1.0)
    found = lookup(chart.table, x, y)
    np.testing.assert_allclose(found, twin_lookup(chart.values, chart.origin_m, 0.1, x, y), atol=1e-6)
    distances, gradients = chart.look_up(np.array([(x, y)]))
    np.testing.assert_array_equal((distances[0], *gradients[0]), found)


@pytest.mark.parametrize("place", [(np.nan, 0.0), (0.0, np.nan), (np.inf, -np.inf), (1e300, -1e300)])
def test_lookup_of_what_is_no_place_is_safe(place: tuple[float, float]) -> None:
    chart = open_field_once().distance_map(0.1, 1.0)
    assert np.all(np.isfinite(lookup(chart.table, *place)))


_FIELD: list[FieldModel] = []


def open_field_once() -> FieldModel:
    """One field for all examples, so that its map is computed once."""
    if not _FIELD:
        _FIELD.append(open_field("indoor-9x6"))
    return _FIELD[0]
