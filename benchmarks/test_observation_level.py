"""Frames per second at the observation level beside the rendered one. Run with `make benchmark`."""

from __future__ import annotations

import itertools

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from touchline.simulation.run import Simulation
from touchline.simulation.scenario import open_scenario


@pytest.mark.parametrize("level", ["points", "images"])
@pytest.mark.parametrize("name", ["straight-tracks", "match"])
def test_one_frame(benchmark: BenchmarkFixture, name: str, level: str) -> None:
    """World, sensors and line points, or world, sensors and a 480 x 480 image: points have to be 50 times faster."""
    simulation = Simulation(open_scenario(name, seconds=60.0), level)
    simulation.frame(0)
    indices = itertools.cycle(range(len(simulation)))
    benchmark.pedantic(
        lambda: simulation.frame(next(indices)), rounds=2000 if level == "points" else 60, warmup_rounds=3
    )
