"""A walking humanoid's image to its pose, and the parts of the line graph. Run with `make benchmark`."""

from __future__ import annotations

from itertools import cycle
from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from touchline.config import load_settings
from touchline.perception import LineGraphDetector, LineGraphSettings
from touchline.published.nimbro_lines.system import NimbroLines, NimbroLinesSettings
from touchline.sources import Recording, open_source
from touchline.systems import RobotSetup
from touchline.types import Frame, Prior

WALK = Path(__file__).parents[1] / "tests" / "data" / "humanoid_9x6_walk"
LEARNED = 6  # images that compile and learn colours


@pytest.fixture(scope="module")
def recording() -> Recording:
    return open_source(WALK)


@pytest.fixture(scope="module")
def frames(recording: Recording) -> list[Frame]:
    return list(recording)


def test_image_array_to_pose(benchmark: BenchmarkFixture, recording: Recording, frames: list[Frame]) -> None:
    """One whole step on a decoded 752 x 480 image with 500 particles: the paper's sum is 6.1 ms."""
    number = ("particles.min_particles=500", "particles.max_particles=500")
    settings = load_settings(NimbroLinesSettings, None, number)
    system = NimbroLines(RobotSetup(recording.field, recording.camera), settings, np.random.default_rng(0))
    assert recording.truth is not None
    system.reset(Prior(recording.truth[0]))
    for frame in frames[:LEARNED]:
        system.step(frame)
    rest = iter(frames[LEARNED:])
    benchmark.pedantic(system.step, setup=lambda: ((next(rest),), {}), rounds=len(frames) - LEARNED)


def test_features_of_an_image(benchmark: BenchmarkFixture, recording: Recording, frames: list[Frame]) -> None:
    detector = LineGraphDetector(recording.camera, LineGraphSettings(), recording.field)
    for frame in frames[:LEARNED]:
        detector.observe(frame)
    images = cycle(frames[LEARNED:])
    benchmark(lambda: detector.observe(next(images)))
