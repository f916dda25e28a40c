"""The samples of a pixel: where their rays lie, what they meet, and how near 2 x 2 of them come to 8 x 8."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt
import pytest

from touchline_lab.simulation.cameras.base import field_from_body
from touchline_lab.simulation.rendering.casting import CAST_ROWS, cast_rays
from touchline_lab.simulation.rendering.rendering import RayGrid, Renderer, sample_rays
from touchline_lab.simulation.rendering.scene import Scene
from touchline_lab.simulation.rendering.solids import (
    BOTTOM,
    COLUMNS,
    CYLINDER,
    KIND,
    NET,
    RADIUS,
    TOP,
    sort_into_cells,
)
from touchline_lab.simulation.rendering.tracing import Ray, net_ratio
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

WINDOWS = {"match": (slice(60, 200), slice(140, 340)), "humanoid-walk": (slice(160, 300), slice(280, 480))}


@pytest.mark.parametrize(("name", "seed"), [("match", 3), ("match", 8), ("humanoid-walk", 3), ("humanoid-walk", 9)])
def test_two_by_two_samples_come_near_eight_by_eight(name: str, seed: int) -> None:
    """Part of an image, without noise: an eighth of the pixels hold an edge, whose four samples are seldom even."""
    simulation = Simulation(open_scenario(name, seed=seed, seconds=20.0, changes=["ideal=true"]))
    camera, settings, window = simulation.camera_model, simulation.scenario.camera, WINDOWS[name]
    grid = dataclasses.replace(camera._grid, rays=camera._grid.rays[window], still=camera._grid.still[window])
    few, many = Renderer(grid), Renderer(grid, side=8)
    scene = Scene(simulation.world)
    for part in (0.1, 0.45, 0.8):
        time_s = float(simulation.image_times_s[int(part * len(simulation))])
        scene.update(simulation.state(time_s))
        pose = field_from_body(simulation.track.pose_at(time_s), simulation.track.attitude_at(time_s))[np.newaxis]
        pictures = [
            camera.sensor.develop(renderer.render(scene, pose), settings.exposure_ms, settings.gain, None).astype(int)
            for renderer in (few, many)
        ]
        apart = np.abs(pictures[0] - pictures[1]).max(axis=2)
        assert pictures[0].max() > 100, "a picture"
        assert apart.mean() < 0.8, "grey levels"
        assert np.percentile(apart, 95) <= 4.0
        assert np.percentile(apart, 99) <= 15.0
        assert apart.max() <= 45


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


def test_what_a_net_lets_by_is_that_of_its_meshes_over_the_rays_width() -> None:
    mesh, thread, angle, distance = 0.12, 0.011, 0.004, 2.5
    net = np.array(
        [[NET, distance, 0.0, 0.0, 1.0, 1.5, 0.0, 0.0, 1.0, 1.5, 0.0, mesh, thread]]
    )  # across x, 2.5 m ahead
    fine = np.linspace(-0.5, 0.5, 401) * distance * angle
    for turn, height in ((0.0, 0.6), (0.01, 0.63), (0.0231, 0.557), (0.05, 0.61)):
        ux, uy = np.cos(turn), np.sin(turn)
        far = distance / ux
        aside, up = far * uy + fine * far / distance / ux, height + fine * far / distance
        gaps = [np.mean(np.abs(p - mesh * np.round(p / mesh)) > 0.5 * thread) for p in (aside, up)]
        ray = Ray(0.0, 0.0, height, ux, uy, 0.0)
        assert net_ratio(net, 0, ray, angle, 10.0) == pytest.approx(gaps[0] * gaps[1], abs=0.02)
    assert net_ratio(net, 0, Ray(0.0, 0.0, 0.6, 1.0, 0.0, 0.0), angle, 2.4) == 1.0, "the ray ends before the net"
    assert net_ratio(net, 0, Ray(0.0, 0.0, 1.2, 1.0, 0.0, 0.0), angle, 10.0) == 1.0, "above the net"
