"""Adaptive supersampling against the image supersampled everywhere: two grey levels, in every pixel."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import numpy.typing as npt
import pytest

from touchline.field import open_field
from touchline.geometry import Pose
from touchline.simulation.cameras.base import field_from_body
from touchline.simulation.cameras.mirror import combined, solve_mirror
from touchline.simulation.cameras.mirror_rays import MirrorMount
from touchline.simulation.cameras.omni import SimulatedOmniCamera
from touchline.simulation.cameras.pinhole import SimulatedPinholeCamera
from touchline.simulation.rendering import rendering
from touchline.simulation.rendering.casting import cast_rays, spread_rays
from touchline.simulation.rendering.sampling import fill_samples, sample_rays
from touchline.simulation.rendering.solids import CYLINDER, sort_into_cells
from touchline.simulation.run import Simulation
from touchline.simulation.scenario import open_scenario
from touchline.simulation.world.hall import default_world
from touchline.simulation.world.world import PAINTS, Block, RobotActor, WorldState

GREY_LEVELS = 2  # the bound, for the largest difference of any pixel and colour


def pictures(simulation: Simulation, time_s: float) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """One instant of a run, still and without noise: supersampled adaptively, and everywhere."""
    camera, settings = simulation.camera_model, simulation.scenario.camera
    view = simulation.world, simulation.state(time_s), simulation.track.pose_at(time_s)
    images = []
    for everywhere in (False, True):
        radiance = camera.radiance(*view, simulation.track.attitude_at(time_s), everywhere=everywhere)
        picture = camera.sensor.develop(radiance, settings.exposure_ms, settings.gain, None)
        images.append(picture.astype(np.int64))
    return images[0], images[1]


@pytest.mark.parametrize(
    ("name", "seed"),
    [("match", 3), ("match", 8), ("humanoid-walk", 3), ("humanoid-walk", 9), ("lighting-3", 2), ("tour-20", 5),
     ("calibration-strip", 1), ("chessboard", 4)],
)  # fmt: skip
def test_no_pixel_differs_by_more_than_two_grey_levels_from_full_supersampling(name: str, seed: int) -> None:
    simulation = Simulation(open_scenario(name, seed=seed, seconds=20.0))
    for share in (0.1, 0.45, 0.8):
        time_s = float(simulation.image_times_s[int(share * len(simulation))])
        adaptive, full = pictures(simulation, time_s)
        assert full.max() > 150, "a picture"
        assert np.abs(adaptive - full).max() <= GREY_LEVELS


def test_where_a_post_bends_away_most_its_foot_is_supersampled() -> None:
    """At the very side of a post neighbouring rays meet it much farther behind: at its foot, so do they miss it."""
    simulation = Simulation(open_scenario("humanoid-walk", seed=23, seconds=30.0))
    adaptive, full = pictures(simulation, float(simulation.image_times_s[len(simulation) // 2 - 1]))
    assert np.abs(adaptive - full).max() <= GREY_LEVELS


def test_only_a_small_part_of_the_pixels_is_supersampled_and_it_matters() -> None:
    camera = SimulatedPinholeCamera()
    robots = (RobotActor(1.0, 0.6, 0.5), RobotActor(3.0, -1.0, 1.5, shape="humanoid", height=1.2))
    world = dataclasses.replace(default_world(open_field("indoor-9x6"), 3), robots=robots)
    pose = Pose(-1.3, 0.8, -0.1)
    one = SimulatedPinholeCamera(side=1).radiance(world, WorldState(), pose).copy()
    adaptive = camera.radiance(world, WorldState(), pose)
    changed = np.any(np.abs(adaptive - one) > 0.05 * one, axis=2)
    assert 0.003 < changed.mean() < 0.12


@pytest.mark.parametrize(
    ("mirror", "lean_rad", "seeds"),
    [(False, 0.15, (5, 67, 89)), (False, 0.0, (6, 15, 28)), (True, 0.1, (3, 41, 61)), (True, 0.0, (50, 51))],
)
def test_bodies_anywhere_through_one_another_and_a_leaning_camera(
    mirror: bool, lean_rad: float, seeds: tuple[int, ...]
) -> None:
    camera = (
        SimulatedOmniCamera.from_mirror(solve_mirror(combined()), MirrorMount()) if mirror else SimulatedPinholeCamera()
    )
    colours = list(PAINTS.values())
    for seed in seeds:
        rng = np.random.default_rng(seed)
        pose = Pose(*rng.uniform((-2.0, -1.5, -3.0), (2.0, 1.5, 3.0)))
        clutter = []
        for _ in range(8 if mirror else 5):
            away, turn = rng.uniform(0.5, 4.0), pose.heading + rng.uniform(-1.0, 1.0) * (3.0 if mirror else 0.6)
            x, y, bottom = pose.x + away * math.cos(turn), pose.y + away * math.sin(turn), rng.choice([0.0, 0.0, 0.4])
            length, width, height = rng.uniform((0.05, 0.05, 0.03), (0.6, 0.6, 0.9))
            kind, colour = ("box", "cylinder")[rng.integers(2)], colours[rng.integers(len(colours))]
            clutter.append(Block(kind, x, y, rng.uniform(-3.0, 3.0), length, width, bottom, bottom + height, (colour,)))
        world = dataclasses.replace(default_world(open_field("indoor-9x6"), 3), clutter=tuple(clutter))
        attitude = rng.uniform(-lean_rad, lean_rad), rng.uniform(-lean_rad, lean_rad)
        adaptive, full = (
            camera.sensor.develop(
                camera.radiance(world, WorldState(), pose, attitude, everywhere=everywhere), 12.0, 1.7, None
            )
            for everywhere in (False, True)
        )
        assert np.abs(adaptive.astype(np.int64) - full).max() <= GREY_LEVELS


def test_the_outline_of_a_hidden_body_is_not_supersampled(monkeypatch: pytest.MonkeyPatch) -> None:
    chosen, render_middles = [], rendering._render_middles
    monkeypatch.setattr(rendering, "_render_middles", lambda *args: chosen.append(render_middles(*args)) or chosen[-1])
    camera, pose = SimulatedPinholeCamera(), Pose(-1.3, 0.8, -0.1)
    world = dataclasses.replace(default_world(open_field("indoor-9x6"), 3), clutter=())
    tower = Block("cylinder", 1.0, 0.6, 0.0, 0.4, 0.4, 0.2, 0.9, (PAINTS["red"],))
    base = Block("box", 1.0, 0.6, 0.3, 0.6, 0.6, 0.0, 0.2, (PAINTS["white"],))
    behind = Block("box", 2.0, 0.5, 0.3, 0.1, 0.1, 0.3, 0.6, (PAINTS["black"],))
    clutters = (), (tower,), (base, behind), (tower, base, behind)
    worlds = [dataclasses.replace(world, clutter=clutter) for clutter in clutters]
    images = [camera.radiance(one, WorldState(), pose).copy() for one in worlds]
    adaptive, full = (
        camera.sensor.develop(image, 12.0, 1.7, None).astype(np.int64)
        for image in (images[-1], camera.radiance(worlds[-1], WorldState(), pose, everywhere=True))
    )
    assert np.abs(adaptive - full).max() <= GREY_LEVELS
    tower_alone, others, together = (set(pixels.tolist()) for pixels in chosen[1:])
    covered = np.flatnonzero(np.any(images[1] != images[0], axis=2)).tolist()
    inside = set(covered) - tower_alone
    assert len(inside & others) > 100, "in plain sight they are"
    assert len(inside & together) < 0.1 * len(inside & others), "but where the tower stands on the base"


def test_a_pixels_samples_stay_within_its_extents() -> None:
    camera = SimulatedPinholeCamera()
    pixels = np.flatnonzero(np.arange(camera.width * camera.height) % 61 == 0).astype(np.int32)
    samples = sample_rays(camera._grid.rays, pixels, 2, camera._grid.pixel_angle)
    pose = field_from_body(Pose(0.3, -0.2, 1.1), (0.06, -0.05))[np.newaxis]
    middles = np.ascontiguousarray(camera._grid.rays.reshape(-1, 6)[pixels].T)
    rays = np.empty((6, 4 * len(pixels)), dtype=np.float32)
    fill_samples(camera._grid.rays, pixels, 2, rays)
    rows, cast = np.zeros(len(pixels), dtype=np.int32), np.empty((9, len(pixels)), dtype=np.float32)
    extents, beside = np.empty((3, len(pixels)), dtype=np.float32), np.empty_like(cast)
    cast_rays(middles, rows, pose, 512, 64, cast)
    spread_rays(samples.spread, cast, math.hypot(pose[0, 6], pose[0, 7]), samples.shift_m, extents)
    for k in range(4):
        cast_rays(np.ascontiguousarray(rays[:, k::4]), rows, pose, 512, 64, beside)
        turn = np.arcsin(np.clip(cast[3] * beside[4] - cast[4] * beside[3], -1.0, 1.0))
        assert np.all(np.abs(turn) <= extents[0])
        assert np.all(np.abs(beside[5] - cast[5]) <= extents[1])
        falling = cast[5] < -0.05
        assert np.all(np.abs(beside[6] - cast[6])[falling] <= extents[2][falling])


def test_a_body_is_listed_in_every_cell_that_a_ray_to_it_may_lie_in() -> None:
    rng = np.random.default_rng(7)
    solids = np.zeros((12, 14))
    solids[:, 0] = CYLINDER
    solids[:, 1:3] = rng.uniform(-6.0, 6.0, (12, 2))
    solids[:, 9] = rng.uniform(0.05, 0.4, 12)
    solids[:, 7] = rng.uniform(0.0, 0.5, 12)
    solids[:, 8] = solids[:, 7] + rng.uniform(0.1, 1.0, 12)
    starts, items, _ = sort_into_cells(solids, 0.5, -0.3, 0.0, 0.02, 0.79, 0.81, 0.0, 512, 64)
    upright = np.hstack((np.eye(3).reshape(-1), np.zeros(3)))[np.newaxis]
    for k in range(12):
        turn, share, height = rng.uniform((-np.pi, 0.0, solids[k, 7]), (np.pi, 1.0, solids[k, 8]), (200, 3)).T
        radius = solids[k, 9] * np.sqrt(share)
        aim = np.stack((solids[k, 1] + radius * np.cos(turn), solids[k, 2] + radius * np.sin(turn), height))
        origin = np.tile([[0.5], [-0.3], [0.8]], 200)
        rays, cast = np.vstack((origin, aim - origin)).astype(np.float32), np.empty((9, 200), dtype=np.float32)
        cast_rays(rays, np.zeros(200, dtype=np.int32), upright, 512, 64, cast)
        for cell in cast[7].astype(int):
            assert k in items[starts[cell] : starts[cell + 1]]
