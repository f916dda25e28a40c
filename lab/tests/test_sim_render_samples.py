"""The samples of a pixel: where their rays lie, what they meet, and how near 2 x 2 of them come to 8 x 8."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt
import pytest

from touchline_lab.simulation.rendering.casting import CAST_ROWS, cast_rays
from touchline_lab.simulation.rendering.rendering import RayGrid, Renderer, sample_rays
from touchline_lab.simulation.rendering.solids import (
    BOTTOM,
    COLUMNS,
    CYLINDER,
    KIND,
    RADIUS,
    TOP,
    sort_into_cells,
)

pytestmark = pytest.mark.slow  # rendering


def even_rays() -> npt.NDArray[np.float32]:
    """Rays (5, 7, 6) that change evenly from pixel to pixel; one pixel sees nothing."""
    rows, columns = np.mgrid[:5, :7].astype(np.float32)
    rays = np.stack([a * columns + b * rows for a, b in ((1, 0), (0, 1), (2, 3), (1, 1), (-1, 2), (0.5, 0))], axis=-1)
    rays[2, 4] = np.nan
    return np.asarray(rays, dtype=np.float32)


@pytest.mark.parametrize("side", [2, 3])
def test_samples_lie_on_a_grid_between_the_rays_of_the_neighbours(side: int) -> None:
    grid = RayGrid(even_rays(), 0.1, np.zeros(3), 0.0, np.zeros((5, 7, 4), dtype=np.float32))
    samples = sample_rays(grid, side)
    steps = (np.arange(side) + 0.5) / side - 0.5
    down, right = np.meshgrid(steps, steps, indexing="ij")
    assert samples.each == side * side
    assert samples.starts.tolist() == [0, 7, 14, 20, 27, 34], "a pixel that sees nothing has no samples"
    for number, pixel in enumerate(samples.pixels.tolist()):
        v, u = divmod(pixel, 7)
        block = slice(number * side * side, (number + 1) * side * side)
        assert samples.rays[0, block] == pytest.approx(u + right.ravel(), abs=1e-5)
        assert samples.rays[1, block] == pytest.approx(v + down.ravel(), abs=1e-5)
        assert samples.rays[2, block] == pytest.approx((2 * (u + right) + 3 * (v + down)).ravel(), abs=1e-4)


def test_an_equal_camera_has_the_samples_of_the_one_before_and_any_other_has_its_own() -> None:
    def grid(**changes: object) -> RayGrid:
        still = np.zeros((5, 7, 4), dtype=np.float32)
        return dataclasses.replace(RayGrid(even_rays(), 0.1, np.zeros(3), 0.0, still), **changes)

    def samples(camera: RayGrid) -> npt.NDArray[np.float32]:
        return Renderer(camera)._samples.rays

    rays, still = even_rays(), np.zeros((5, 7, 4), dtype=np.float32)
    rays[0, 0, 5] += 1e-6
    still[0, 0, 3] = 1.0
    first = samples(grid())
    assert samples(grid()) is first
    for change in ({"rays": rays}, {"still": still}, {"pixel_angle": 0.2}, {"origin": np.ones(3)}, {"slack_m": 0.1}):
        assert grid(**change) != grid()
        assert samples(grid(**change)) is not first


def test_a_body_is_listed_in_every_cell_that_a_ray_to_it_may_lie_in() -> None:
    rng = np.random.default_rng(7)
    solids = np.zeros((12, COLUMNS))
    solids[:, KIND] = CYLINDER
    solids[:, 1:3] = rng.uniform(-6.0, 6.0, (12, 2))
    solids[:, RADIUS] = rng.uniform(0.05, 0.4, 12)
    solids[:, BOTTOM] = rng.uniform(0.0, 0.5, 12)
    solids[:, TOP] = solids[:, BOTTOM] + rng.uniform(0.1, 1.0, 12)
    cells = sort_into_cells(solids, np.array([0.5, -0.3]), (0.0, 0.02), (0.79, 0.81))
    upright = np.concatenate((np.eye(3).reshape(-1), np.zeros(3))).astype(np.float32)
    for k in range(12):
        turn, part, height = rng.uniform((-np.pi, 0.0, solids[k, BOTTOM]), (np.pi, 1.0, solids[k, TOP]), (200, 3)).T
        radius = solids[k, RADIUS] * np.sqrt(part)
        aim = np.stack((solids[k, 1] + radius * np.cos(turn), solids[k, 2] + radius * np.sin(turn), height))
        origin = np.tile([[0.5], [-0.3], [0.8]], 200)
        rays, cast = np.vstack((origin, aim - origin)).astype(np.float32), np.empty((CAST_ROWS, 200), dtype=np.float32)
        cast_rays(rays, 0, 200, upright, cast)
        for cell in cast[7].astype(int):
            assert k in cells.items[cells.starts[cell] : cells.starts[cell + 1]]
