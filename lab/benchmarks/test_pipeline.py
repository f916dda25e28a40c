"""Image array to pose, and its parts, on the bundled example recording. Run with `make benchmark`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from touchline.localization.registration.learned_mirror import LearnedMirror
from touchline.localization.registration.weights import precision_weights
from touchline.perception.path_samples import no_samples, sample_paths
from touchline.published.nubot_mti.system import NubotMti
from touchline.sources import open_source
from touchline.systems import RobotSetup, open_system
from touchline.types import Frame

EXAMPLE = Path(__file__).parents[1] / "examples" / "omni_msl_track_short"


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    return list(open_source(EXAMPLE))


@pytest.fixture
def warm(frames: list[Frame]) -> NubotMti:
    """A system that has followed the first 20 images: compiled, colours learned."""
    source = open_source(EXAMPLE)
    system = open_system("nubot-mti", RobotSetup(source.field, source.camera))
    for frame in frames[:20]:
        system.step(frame)
    assert isinstance(system, NubotMti)
    return system


def test_image_array_to_pose(benchmark: BenchmarkFixture, frames: list[Frame], warm: NubotMti) -> None:
    """One whole step on a decoded 480 x 480 image: perception, matching, tilt, fusion, failure detection."""
    rest: Iterator[Frame] = iter(frames[20:])
    benchmark.pedantic(warm.step, setup=lambda: ((next(rest),), {}), rounds=len(frames) - 20)


def test_line_points(benchmark: BenchmarkFixture, frames: list[Frame], warm: NubotMti) -> None:
    assert warm.detector is not None
    benchmark(warm.detector.observe, frames[20])


def test_sampling_the_scan_lines(benchmark: BenchmarkFixture, frames: list[Frame], warm: NubotMti) -> None:
    assert warm.detector is not None
    detector = warm.detector.detector
    model, lines = detector.colours, detector.scan_lines
    assert model is not None
    out = no_samples(len(lines.samples))
    signal, own = model.signal.astype(np.float32), np.flatnonzero(lines.at_samples(detector.body))
    benchmark(sample_paths, frames[20].image, lines, own, signal, model.table, out)


def test_sampling_the_scan_lines_numpy_twin(benchmark: BenchmarkFixture, frames: list[Frame], warm: NubotMti) -> None:
    assert warm.detector is not None
    detector = warm.detector.detector
    model = detector.colours
    assert model is not None

    def sample() -> None:
        image = frames[20].image
        assert image is not None
        u, v = detector.scan_lines.samples.T
        j, i = u.astype(int), v.astype(int)
        fu, fv = (u - j)[:, None], (v - i)[:, None]
        top = (1 - fu) * image[i, j] + fu * image[i, j + 1]
        bottom = (1 - fu) * image[i + 1, j] + fu * image[i + 1, j + 1]
        colours = (1 - fv) * top + fv * bottom
        _ = colours @ model.signal
        b, g, r = colours.astype(int).T >> 2
        _ = np.where(detector.body[i, j], 3, model.table[b, g, r])

    benchmark(sample)


def test_matching_from_the_prediction(benchmark: BenchmarkFixture, frames: list[Frame], warm: NubotMti) -> None:
    assert warm.detector is not None
    points = warm.detector.observe(frames[20]).points
    weights = precision_weights(points, warm.settings.weights)
    benchmark(warm.tracker.matcher.match, points.positions_m, weights, warm.tracker.filter.pose)


def test_mirror_tilt(benchmark: BenchmarkFixture, frames: list[Frame], warm: NubotMti) -> None:
    assert warm.detector is not None
    points = warm.detector.observe(frames[20]).points
    tilt = LearnedMirror(open_source(EXAMPLE).field)
    tilt.update(points, warm.tracker.filter.pose)
    benchmark(tilt.update, points, warm.tracker.filter.pose)
