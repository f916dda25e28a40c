"""The error map of figure 9: its values against exact distances, its edges and its picture."""

from __future__ import annotations

import numpy as np
import pytest

from touchline.errors import InputError
from touchline.field import open_field
from touchline.field.error_map import error_map


@pytest.mark.parametrize("name", ["indoor-9x6", "msl-18x12"])
@pytest.mark.parametrize("farthest_m", [1.0, 0.4])
def test_every_sample_is_the_exact_distance_in_256_steps(name: str, farthest_m: float) -> None:
    field = open_field(name)
    found = error_map(field, 0.1, farthest_m)
    ny, nx = found.values.shape
    ix, iy = np.meshgrid(np.arange(nx), np.arange(ny))
    places = found.origin_m + 0.1 * np.stack((ix, iy), axis=-1).reshape(-1, 2)
    exact = 255.0 * np.minimum(field.line_distances(places) / farthest_m, 1.0)
    assert found.values.dtype == np.uint8
    assert np.abs(found.values.ravel() - exact).max() <= 0.5 + 1e-3  # the distances are kept in single precision


def test_lines_are_0_and_far_places_255() -> None:
    field = open_field("indoor-9x6")
    found = error_map(field, 0.05)
    assert np.all(found.look_up([[4.475, 0.0], [0.0, 0.0], [0.725, 0.0]]) <= 8)  # up to half a sample away
    assert found.look_up([[1.5, 0.0]])[0] == pytest.approx(255 * (1.5 - 0.725), abs=1)  # from the centre circle
    assert np.all(found.look_up([[30.0, 0.0], [0.0, -30.0], [-5.6, 3.9]]) == 255)
    assert np.all(np.concatenate([found.values[[0, -1]].ravel(), found.values[:, [0, -1]].ravel()]) == 255)


def test_the_sample_nearest_to_a_point_counts() -> None:
    found = error_map(open_field("indoor-9x6"), 0.05)
    place = found.origin_m + 0.05 * np.array([77, 31])
    around = place + np.array([[0.0, 0.0], [0.024, -0.024], [-0.024, 0.024]])
    assert found.look_up(around).tolist() == [int(found.values[31, 77])] * 3
    for row, column in ((40, 35), (95, 130)):  # the map slopes along x there, and both ways
        around = found.origin_m + 0.05 * (
            np.array([column, row]) + np.array([[0.45, 0.0], [0.0, 0.45], [-0.45, -0.45]])
        )
        assert found.look_up(around).tolist() == [int(found.values[row, column])] * 3
    with pytest.raises(ValueError, match=r"\(N, 2\)"):
        found.look_up([1.0, 2.0])


def test_the_picture_has_x_upwards() -> None:
    found = error_map(open_field("indoor-9x6"), 0.05)
    picture = found.picture()
    ny, nx = found.values.shape
    assert picture.shape == (nx, ny)
    assert picture[0, 0] == found.values[-1, -1]  # largest x at the top, largest y on the left
    assert np.array_equal(picture[:, 0], found.values[-1, ::-1])


@pytest.mark.parametrize("farthest_m", [0.0, -1.0, float("nan"), float("inf")])
def test_a_map_without_a_distance_is_refused(farthest_m: float) -> None:
    with pytest.raises(InputError, match="error map"):
        error_map(open_field("indoor-9x6"), 0.05, farthest_m)
