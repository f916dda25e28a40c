"""The steps of a mirror calibration: edges healed, ends found, axes fitted, bearings smoothed."""

from __future__ import annotations

import numpy as np
import pytest

from touchline.geometry import FloatArray
from touchline.published.strip.axis import fit_axis
from touchline.published.strip.directions import groups_of_directions, healed, smooth_bearings, white_excess
from touchline.published.strip.edges import SPREAD_PX, end_edge

EDGES_M = np.array([0.6, 0.73, 0.86, 1.01, 1.17, 1.35, 1.55, 1.79, 2.06, 2.38, 2.78, 3.3, 3.98, 4.97, 6.5])
SIGNS = -((-1) ** np.arange(15))


def waving(directions: int) -> tuple[FloatArray, FloatArray]:
    """Directions (S,) and radii (S, 15) of a mirror that leans."""
    angles = np.arange(directions) * 2.0 * np.pi / directions
    return angles, 225.0 * np.arctan(EDGES_M / 1.57) + 5.0 * np.cos(angles - 0.4)[:, np.newaxis]


def test_an_edge_that_contradicts_other_directions_is_replaced() -> None:
    angles, radii = waving(24)
    spoilt = radii.copy()
    spoilt[7, 14] += 1.5
    spoilt[3, 0] = np.nan
    mended, which = healed(angles, spoilt, np.full(15, 0.2), of_its_own=True)
    assert np.argwhere(which).tolist() == [[3, 0], [7, 14]]
    assert mended == pytest.approx(radii, abs=1e-6)


def test_a_dent_in_the_mirror_stays() -> None:
    angles, radii = waving(24)
    radii[5] += 1.5  # every edge in one direction: no mistake of one edge
    mended, which = healed(angles, radii, np.full(15, 0.2), of_its_own=True)
    assert not which.any()
    assert np.array_equal(mended, radii)


def test_white_that_spreads_over_black_is_measured_as_a_zigzag() -> None:
    _, radii = waving(12)
    spread = radii - 0.15 * SIGNS  # where it gets brighter outwards the edge is seen too far in
    assert white_excess(spread, EDGES_M, SIGNS)[1:] == pytest.approx(np.full(14, 0.15), abs=0.02)
    assert white_excess(spread, EDGES_M, SIGNS)[0] == 0.0  # black beside carpet
    assert white_excess(radii, EDGES_M, SIGNS) == pytest.approx(np.zeros(15), abs=1e-6)


def blurred(r: FloatArray, edges: list[float], levels: list[float]) -> FloatArray:
    """Levels between edges, blurred as SPREAD says."""
    light = np.full(len(r), levels[-1])
    for edge, before, behind in zip(edges, levels, levels[1:], strict=False):
        light = light + (before - behind) * np.interp(r - edge, SPREAD_PX, SPREAD)
    return light


SPREAD = 1.0 / (1.0 + np.exp(SPREAD_PX / 0.5))
PROFILE_PX = np.arange(-8.0, 12.0, 0.25)


@pytest.mark.parametrize(
    ("edges", "levels"),
    [
        ([0.3], [1.0, 0.2]),  # carpet behind the strip
        ([0.3], [1.0, 0.6]),  # something brighter than the carpet
        ([0.3, 2.3], [1.0, 0.2, 0.9]),  # carpet, then a field line two pixels behind
        ([0.3, 2.3], [1.0, 0.2, 0.0]),  # carpet, then something black
    ],
)
def test_the_end_of_the_strip_is_found_whatever_lies_behind(edges: list[float], levels: list[float]) -> None:
    light = blurred(PROFILE_PX, edges, levels)
    assert end_edge(PROFILE_PX, light, 0.5, 0.2, SPREAD) == pytest.approx(0.3, abs=0.05)


def test_an_axis_through_another_centre_is_a_curve() -> None:
    center, radii = np.array([200.0, 200.0]), np.linspace(50.0, 190.0, 15)
    along = np.linspace(48.0, 195.0, 14)
    points = np.column_stack((203.0 + along, np.full(14, 202.0)))  # a line that passes the centre 2 px aside
    points[4] += (0.0, 3.0)  # a rod
    axis = fit_axis(points, center, radii)
    u, v = axis.pixels(radii)
    assert v == pytest.approx(np.full(15, 202.0), abs=0.05)
    assert np.hypot(u - 200.0, v - 200.0) == pytest.approx(radii)


def test_errors_of_turning_by_hand_are_smoothed() -> None:
    seen = np.arange(24) * 2.0 * np.pi / 24
    true = seen + 0.01 * np.cos(seen - 1.0) + 0.003 * np.sin(2.0 * seen)
    noise = np.random.default_rng(3).normal(0.0, np.radians(0.3), 24)
    smooth, wrong = smooth_bearings(seen, true + noise)
    assert wrong == {}
    assert np.sqrt(np.mean((smooth - true) ** 2)) < 0.75 * np.sqrt(np.mean(noise**2))
    given = true.copy()
    given[5] += np.radians(20.0)
    smooth, wrong = smooth_bearings(seen, given)
    assert list(wrong) == [5]
    assert smooth == pytest.approx(true, abs=1e-3)


def test_images_of_one_direction_are_one_group_across_the_seam() -> None:
    bearings = np.radians([0.5, 90.0, 180.0, 270.0, 359.0, 91.5])
    assert sorted(sorted(group) for group in groups_of_directions(bearings)) == [[0, 4], [1, 5], [2], [3]]
