"""Rendering times on one core: `pytest lab/benchmarks/test_simulation.py`. Nothing here fails for being slow.

Frames of the real scenarios, with their robots, ball, goals and nets, along the robot's way: world brought up to date,
2 x 2 samples of each pixel, noise, sensor; without motion blur and rolling shutter. The goal is 50 ms for an
omnidirectional frame of 480 x 480 pixels and 100 ms for a perspective one of 752 x 480; docs/simulation.md has a table
of what was measured. Processor time, as there:

    pytest lab/benchmarks/test_simulation.py --benchmark-timer=time.process_time --benchmark-columns=min,median
"""

from __future__ import annotations

import itertools

import cv2
import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

FRAMES = 25


@pytest.fixture(autouse=True)
def one_core() -> None:
    cv2.setNumThreads(1)


def still(name: str) -> Simulation:
    """A run whose images are neither blurred nor skewed by motion."""
    scenario = open_scenario(name, seconds=20.0)
    camera = scenario.camera.model_copy(update={"motion_blur": False, "rolling_shutter_ms": 0.0})
    return Simulation(scenario.model_copy(update={"camera": camera}))


@pytest.mark.parametrize(
    "name",
    ["match", "straight-tracks", "lighting-3", "tour-20", "worn-hall", "humanoid-walk", "walk-in-place"],
)
def test_a_frame_of_a_scenario(benchmark: BenchmarkFixture, name: str) -> None:
    """The first five see through a mirror (480 x 480), the last two through a lens (752 x 480)."""
    simulation = still(name)
    frames = itertools.cycle(np.linspace(0, len(simulation) - 1, FRAMES).astype(int).tolist())
    simulation.image(0)
    benchmark.pedantic(lambda: simulation.image(next(frames)), rounds=3 * FRAMES, warmup_rounds=FRAMES)


def test_the_sensor_alone(benchmark: BenchmarkFixture) -> None:
    simulation = still("match")
    camera, time_s = simulation.camera_model, float(simulation.image_times_s[5])
    image = camera.radiance(simulation.world, simulation.state(time_s), simulation.track.pose_at(time_s))
    rng = np.random.default_rng(1)
    benchmark(lambda: camera.sensor.develop(image, 12.0, 1.7, rng))
