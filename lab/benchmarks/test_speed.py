"""Times of the systems' steps, the papers' parts and the simulator: `make benchmark`. Nothing fails for being slow.

Figures of the simulator are processor times: `--benchmark-timer=time.process_time --benchmark-columns=min,median`.
"""

from __future__ import annotations

import itertools
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from touchline.evaluation.runner import robot_setup
from touchline.field import open_field
from touchline.geometry import FloatArray, Pose
from touchline.localization.one_shot.locate import locate_points
from touchline.localization.registration.weights import WeightSettings, range_weights
from touchline.motion.odometry import Motion
from touchline.published.nubot.global_search import GlobalSearch, GlobalSearchSettings, sample_errors
from touchline.published.nubot.matcher import Matcher
from touchline.published.nubot_mcl.particles import NubotParticlePaper, NubotParticles, NubotParticleSettings
from touchline.sources import Recording, open_source
from touchline.systems import open_system
from touchline.types import Prior
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

ROOT = Path(__file__).parents[2]
MIRROR, HUMANOID = ROOT / "examples" / "omni_msl_track_short", ROOT / "tests" / "data" / "humanoid_9x6_walk"
FIELD, TRUTH, START = open_field("msl-18x12"), Pose(3.2, -1.4, 0.5), Pose(3.35, -1.5, 0.58)
MATCHER, LEARNED = Matcher(FIELD.distance_map()), 20  # images that compile and teach the colours


@cache
def points() -> FloatArray:
    """100 points within 6 m, 2 % range noise, 5 % clutter: the setting of the published point sets."""
    rng = np.random.default_rng(0)
    seen = TRUTH.inverse().transform(np.vstack(list(FIELD.polylines(0.02))))
    seen = seen[np.hypot(*seen.T) < 6.0]
    seen = seen[rng.permutation(len(seen))[:100]] * (1.0 + 0.02 * rng.standard_normal((100, 1)))
    seen[:5] = rng.uniform(-4.0, 4.0, (5, 2))
    return np.ascontiguousarray(seen)


@pytest.mark.parametrize(
    ("recording", "name"),
    [(MIRROR, name) for name in ("touchline", "nubot-mti", "nubot-mcl", "iris-fusion")]
    + [(HUMANOID, name) for name in ("touchline", "nimbro-lines")],
)
def test_image_array_to_pose(benchmark: BenchmarkFixture, recording: Path, name: str) -> None:
    source = open_source(recording)
    assert isinstance(source, Recording)
    assert source.truth is not None
    system, frames = open_system(name, robot_setup(source)), list(source)
    system.reset(Prior(source.truth[0]))
    for frame in frames[:LEARNED]:
        system.step(frame)
    rest = iter(frames[LEARNED:])
    benchmark.pedantic(system.step, setup=lambda: ((next(rest),), {}), rounds=len(frames) - LEARNED)


def test_matching(benchmark: BenchmarkFixture) -> None:
    """25 RPROP iterations."""
    weights = range_weights(points(), WeightSettings())
    pose, _, _ = benchmark(MATCHER.descend, points(), weights, START.as_array())
    assert Pose(*pose).distance_to(TRUTH) < 0.05


def test_315_samples_and_five_refinements(benchmark: BenchmarkFixture) -> None:
    search = GlobalSearch(MATCHER, FIELD.length, FIELD.width, GlobalSearchSettings(rounds=1))
    benchmark(search.locate, points(), range_weights(points(), WeightSettings()), 0.55)


def test_315_samples(benchmark: BenchmarkFixture) -> None:
    samples = GlobalSearch(MATCHER, FIELD.length, FIELD.width).samples_m
    benchmark(sample_errors, MATCHER.distance_map, points(), samples, 0.55, 2.55)


@pytest.mark.parametrize("particles", [600, 6000, 100_000, 1_000_000])
def test_a_cycle_of_particles(benchmark: BenchmarkFixture, particles: int) -> None:
    """Motion, weights, resampling, estimate with 100 points; resampled in every cycle, the dearest case."""
    paper = NubotParticlePaper(refined_clusters=0, resampling_threshold=1.0)
    settings = NubotParticleSettings(particles=particles, paper=paper)
    mcl = NubotParticles(MATCHER, FIELD.length, FIELD.width, np.random.default_rng(0), settings)
    mcl.restart(TRUTH.heading)
    motion = Motion(Pose(0.1, 0.0, 0.02), np.diag([1e-4, 1e-4, 1e-5]), 0.0)
    benchmark(lambda: (mcl.predict(motion), mcl.update(points(), None)))


def test_locate(benchmark: BenchmarkFixture) -> None:
    """The whole field and circle, with the test against chance."""
    benchmark.pedantic(locate_points, (points(), FIELD), rounds=5, warmup_rounds=1)


@pytest.mark.parametrize("level", ["points", "images"])
@pytest.mark.parametrize("name", ["match", "straight-tracks", "tour-20", "worn-hall", "humanoid-walk"])
def test_a_simulated_frame(benchmark: BenchmarkFixture, name: str, level: str) -> None:
    """World, sensors and line points; or an image of 2 x 2 samples a pixel, neither blurred nor skewed, one thread."""
    cv2.setNumThreads(1)
    scenario = open_scenario(name, seconds=20.0)
    camera = scenario.camera.model_copy(update={"motion_blur": False, "rolling_shutter_ms": 0.0})
    simulation = Simulation(scenario.model_copy(update={"camera": camera}), level)
    indices = itertools.cycle(range(len(simulation)))
    benchmark.pedantic(lambda: simulation.frame(next(indices)), rounds=60, warmup_rounds=3)
