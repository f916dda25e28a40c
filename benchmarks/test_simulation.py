"""Rendering times on one core: `pytest benchmarks/test_simulation.py`. Nothing here fails for being slow."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from touchline.field import open_field
from touchline.geometry import Pose
from touchline.simulation.mirror import solve_mirror, tangent_range
from touchline.simulation.omni import SimulatedOmniCamera
from touchline.simulation.pinhole import SimulatedPinholeCamera
from touchline.simulation.world import BallActor, RobotActor, World, WorldState, default_world

ROBOTS = (RobotActor(-6.0, -4.4, 0.3), RobotActor(5.0, 2.0, 1.0), RobotActor(2.0, -1.3, 2.0))
HUMANOID = (RobotActor(3.0, -1.0, 2.5, 0.2, 1.2, shape="humanoid"),)


@pytest.fixture(autouse=True)
def one_core() -> None:
    cv2.setNumThreads(1)


def furnished(name: str, robots: tuple[RobotActor, ...]) -> World:
    return dataclasses.replace(default_world(open_field(name), 4), robots=robots, balls=(BallActor(1.0, 0.7),))


def test_omni_480_x_480(benchmark: BenchmarkFixture) -> None:
    """The goal is 16.6 ms: world, adaptive supersampling, noise, sensor."""
    camera = SimulatedOmniCamera.from_mirror(solve_mirror(tangent_range()))
    world, rng = furnished("msl-18x12", ROBOTS), np.random.default_rng(1)
    benchmark(lambda: camera.render(world, WorldState(), Pose(0.2, -1.5, 0.0), rng=rng))


def test_perspective_752_x_480(benchmark: BenchmarkFixture) -> None:
    """The goal is 25 ms."""
    camera = SimulatedPinholeCamera()
    world, rng = furnished("indoor-9x6", HUMANOID), np.random.default_rng(1)
    benchmark(lambda: camera.render(world, WorldState(), Pose(-2.0, -0.9, 0.3), (0.02, -0.01), 8.0, 2.4, rng))


def test_the_sensor_alone(benchmark: BenchmarkFixture) -> None:
    camera = SimulatedOmniCamera.from_mirror(solve_mirror(tangent_range()))
    image = camera.radiance(furnished("msl-18x12", ()), WorldState(), Pose(0.2, -1.5, 0.0))
    rng = np.random.default_rng(1)
    benchmark(lambda: camera.sensor.develop(image, 12.0, 1.7, rng))


def test_everything_supersampled_for_comparison(benchmark: BenchmarkFixture) -> None:
    camera = SimulatedOmniCamera.from_mirror(solve_mirror(tangent_range()))
    world = furnished("msl-18x12", ROBOTS)
    benchmark(lambda: camera.radiance(world, WorldState(), Pose(0.2, -1.5, 0.0), everywhere=True))
