"""Frames per second at the observation level beside the rendered one. Run with `make benchmark`."""

from __future__ import annotations

import itertools
import statistics
import time

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario


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


@pytest.mark.parametrize("name", ["straight-tracks", "match"])
def test_the_ratio_of_both_levels_is_printed(name: str) -> None:
    """Medians of processor time, as docs/simulation.md has them."""
    medians_ms = []
    for level, frames in (("points", 200), ("images", 20)):
        simulation = Simulation(open_scenario(name, seconds=60.0), level)
        simulation.frame(0)
        times_ns = []
        for index in range(1, frames + 1):
            start = time.process_time_ns()
            simulation.frame(index)
            times_ns.append(time.process_time_ns() - start)
        medians_ms.append(1e-6 * statistics.median(times_ns))
    points_ms, images_ms = medians_ms
    print(f"{name}: {points_ms:.2f} ms against {images_ms:.1f} ms rendered, {images_ms / points_ms:.0f} times faster")
    assert images_ms > 50.0 * points_ms
