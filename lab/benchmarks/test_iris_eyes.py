"""Perception and odometry of iris-fusion: line points by thresholds, wheels and gyro. Run with `make benchmark`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from touchline.motion import DeadReckoning, MotionHistory, WheelSettings
from touchline.published.iris_fusion.hsv_lines import HsvLineDetector
from touchline.sources import open_source
from touchline.types import Frame, ImageArray

EXAMPLE = Path(__file__).parents[1] / "examples" / "omni_msl_track_short"


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    return list(open_source(EXAMPLE))


@pytest.fixture
def detector() -> HsvLineDetector:
    source = open_source(EXAMPLE)
    return HsvLineDetector(source.camera, line_width_m=source.field.line_width)


@pytest.fixture
def image(frames: list[Frame]) -> ImageArray:
    image = frames[20].image
    assert image is not None
    return image


def test_line_points_by_thresholds(benchmark: BenchmarkFixture, detector: HsvLineDetector, image: ImageArray) -> None:
    """A whole 480 x 480 image: blur, both colour spaces, thresholds, hull, rays, covariances."""
    benchmark(detector.detect, image)


def test_thresholds_hull_and_masks(benchmark: BenchmarkFixture, detector: HsvLineDetector, image: ImageArray) -> None:
    benchmark(detector.masks, image)


def test_white_runs_along_144_rays(benchmark: BenchmarkFixture, detector: HsvLineDetector, image: ImageArray) -> None:
    masks = detector.masks(image)
    detector._distances(masks)
    benchmark(detector._distances, masks)


def test_white_runs_numpy_twin_of_the_sampling_alone(
    benchmark: BenchmarkFixture, detector: HsvLineDetector, image: ImageArray
) -> None:
    """Only the bilinear look-up of the same samples, in plain NumPy."""
    light = detector.masks(image).lightness.astype(np.float64)
    radii = np.arange(detector.camera.inner_radius_px, detector.outer_px)

    def sample() -> None:
        path = np.array(detector.camera.center) + radii[:, np.newaxis, np.newaxis] * detector.rays
        j, i = np.floor(path).astype(int).transpose(2, 0, 1)
        fu, fv = (path - np.floor(path)).transpose(2, 0, 1)
        top = (1 - fu) * light[i, j] + fu * light[i, j + 1]
        _ = (1 - fv) * top + fv * ((1 - fu) * light[i + 1, j] + fu * light[i + 1, j + 1])

    benchmark(sample)


def test_wheel_odometry_of_one_frame(benchmark: BenchmarkFixture, frames: list[Frame]) -> None:
    """Five samples each of wheels and gyro."""
    directions = open_source(EXAMPLE).wheel_directions_rad
    assert directions is not None
    history, rest = MotionHistory(wheels=WheelSettings(), wheel_directions_rad=directions), iter(frames[1:])
    odometry = DeadReckoning(history)

    def motion(frame: Frame) -> None:
        history.add(frame)
        odometry.advance(frame.stamp_ns)

    motion(frames[0])
    benchmark.pedantic(motion, setup=lambda: ((next(rest),), {}), rounds=len(frames) - 1)
