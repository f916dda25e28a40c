"""iris-fusion: one whole update from points and both sensors to the pose, and its parts."""

from __future__ import annotations

import itertools
from functools import cache

import numpy as np
from pytest_benchmark.fixture import BenchmarkFixture

from touchline.geometry import FloatArray, Pose
from touchline.motion.odometry import Motion
from touchline.published.iris_fusion.modes import SensorFusion
from touchline.published.iris_fusion.particles import IrisParticles
from touchline.published.particles.particle_set import ParticleEstimate
from touchline.systems import RobotSetup, open_system
from touchline.types import Frame, System
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario


@cache
def drive() -> tuple[Simulation, list[Frame]]:
    """A drive over the 9 x 6 m field at 10 Hz: some 230 points and five samples of wheels and gyro per frame."""
    simulation = Simulation(open_scenario("tour-20", 1, 60.0, ["ideal=true"]), level="points")
    return simulation, list(simulation)


def test_one_update_of_iris_fusion(benchmark: BenchmarkFixture) -> None:
    """Points to pose, both sensors: 0.6 ms or less."""
    simulation, frames = drive()

    def ready() -> System:
        made = open_system("iris-fusion", RobotSetup(simulation.field, None, simulation.wheel_directions_rad))
        for frame in frames[:20]:
            made.step(frame)
        return made

    systems = itertools.chain.from_iterable(
        zip(itertools.repeat(ready(), len(frames) - 20), frames[20:], strict=True) for _ in itertools.count()
    )
    benchmark.pedantic(lambda made, frame: made.step(frame), setup=lambda: (next(systems), {}), rounds=2000)


def test_one_cycle_of_the_particle_filter(benchmark: BenchmarkFixture) -> None:
    """Motion, 600 particles x 100 points, tempering, resampling, mean."""
    simulation, frames = drive()
    points = points_of(frames[100])
    particles = IrisParticles(simulation.field, np.random.default_rng(0))
    particles.start_at(Pose(*simulation.truth.poses[100]), np.diag([0.03, 0.03, 0.01]) ** 2)
    still = Motion(Pose(0.0, 0.0, 0.0), np.diag([1e-5, 1e-5, 1e-6]), 0.0)

    def cycle() -> None:
        particles.predict(still)
        particles.update(points)

    benchmark(cycle)


def test_the_fusion_alone(benchmark: BenchmarkFixture) -> None:
    pose = Pose(1.0, 0.5, 0.3)
    fusion, motion = SensorFusion(), Motion(Pose(0.0, 0.0, 0.0), np.diag([1e-5, 1e-5, 1e-6]), 0.0)
    fusion.place(pose, np.eye(3) * 1e-4)
    vision = ParticleEstimate(pose, np.eye(3) * 1e-4, 100, 0.95)
    benchmark(fusion.update, pose, motion, vision, 0.1)


def points_of(frame: Frame) -> FloatArray:
    """100 points (100, 2) of a frame."""
    assert frame.observation is not None
    positions_m = frame.observation.points.positions_m
    return np.ascontiguousarray(positions_m[np.arange(100) * len(positions_m) // 100])
