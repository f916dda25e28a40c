"""The image sensor against its documented moments; pictures against the recorded ones."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from touchline.field import open_field
from touchline.geometry import Pose
from touchline.simulation.image_sensor import ImageSensor, expose
from touchline.simulation.omni import SimulatedOmniCamera
from touchline.simulation.pinhole import SimulatedPinholeCamera
from touchline.simulation.world import PAINTS, RobotActor, WorldState, default_world

FLAT = ImageSensor(optics_blur_sigma_px=0.0, white_balance_rgb=(1.0, 1.0, 1.0))


def even(radiance: float) -> npt.NDArray[np.float32]:
    return np.full((400, 400, 3), radiance, dtype=np.float32)


@pytest.mark.parametrize(("radiance", "gain"), [(0.02, 1.0), (0.1, 1.7), (0.05, 8.0)])
def test_noise_has_the_documented_mean_and_variance(radiance: float, gain: float) -> None:
    exposure_ms = 12.0 / gain
    value = radiance * exposure_ms * gain * FLAT.k
    picture = FLAT.develop(even(radiance), exposure_ms, gain, np.random.default_rng(3))
    raw = (picture[::2, ::2, 2].astype(float) / 255.0) ** FLAT.gamma  # red pixels of the mosaic keep their value
    variance = (
        value * gain / FLAT.full_well_electrons + (FLAT.read_noise_electrons * gain / FLAT.full_well_electrons) ** 2
    )
    slope = 255.0 / FLAT.gamma * value ** (1.0 / FLAT.gamma - 1.0)
    rounding = 1.0 / 12.0 / slope**2
    assert raw.mean() == pytest.approx(value, rel=0.01)
    assert raw.var() == pytest.approx(variance + rounding, rel=0.05)


def test_neighbouring_pixels_of_the_mosaic_and_following_images_have_noise_of_their_own() -> None:
    rng = np.random.default_rng(4)
    first, second = (FLAT.develop(even(0.05), 12.0, 4.0, rng)[::2, ::2, 2].astype(float) for _ in range(2))
    first, second = first - first.mean(), second - second.mean()
    power = float(np.mean(first * first))
    for other in (second, np.roll(first, 1, axis=0), np.roll(first, 1, axis=1)):
        assert abs(float(np.mean(first * other))) < 0.02 * power


def test_a_mosaic_is_exposed_as_by_plain_arithmetic() -> None:
    rng = np.random.default_rng(6)
    radiance = rng.uniform(0.0, 0.5, (6, 8, 3)).astype(np.float32)
    noise = rng.standard_normal(48).astype(np.float32)
    scale, shot, read = np.array([3.0, 3.2, 3.6]), 1e-4, 1e-6
    mosaic = np.empty((6, 8), dtype=np.uint16)
    expose(radiance, noise, scale, shot, read, mosaic)
    rows, columns = np.indices((6, 8))
    channel = rows % 2 + columns % 2  # RGGB
    value = np.take_along_axis(radiance * scale, channel[..., np.newaxis], axis=2)[..., 0]
    value = value + noise.reshape(6, 8) * np.sqrt(value * shot + read)
    assert np.max(np.abs(mosaic - np.clip(value, 0.0, 1.0) * 65535.0)) < 0.51


def test_exposure_times_gain_counts_and_bright_things_clip() -> None:
    dim, same, bright = (FLAT.develop(even(0.1), e, g, None) for e, g in ((12.0, 1.0), (3.0, 4.0), (200.0, 4.0)))
    assert np.array_equal(dim, same)
    assert np.all(dim == round(255.0 * (0.1 * 12.0 * 0.16) ** (1.0 / 2.2)))
    assert np.all(bright == 255)


def test_the_same_seed_gives_the_same_picture_and_another_seed_another() -> None:
    world = dataclasses.replace(default_world(open_field("indoor-9x6"), 5), robots=(RobotActor(1.0, 1.0, 0.0),))
    pictures = [
        SimulatedPinholeCamera().render(world, WorldState(), Pose(-2.0, 0.0, 0.1), rng=np.random.default_rng(seed))
        for seed in (1, 1, 2)
    ]
    assert np.array_equal(pictures[0], pictures[1])
    assert not np.array_equal(pictures[0], pictures[2])
    other = default_world(open_field("indoor-9x6"), 6)
    assert other.clutter != world.clutter


def true_pose(folder: Path, frame: int) -> Pose:
    row = np.loadtxt(folder / "ground_truth.tum")[frame]
    return Pose(row[1], row[2], float(2.0 * np.arctan2(row[6], row[7])))


def test_colours_of_the_rendered_carpet_and_paint_are_near_the_recorded_ones(shared_data: Path) -> None:
    folder = shared_data / "omni_msl_track"
    camera = SimulatedOmniCamera.load(folder / "camera.yaml")
    world = default_world(open_field(folder / "field.yaml"), 4)
    rendered = camera.render(world, WorldState(), true_pose(folder, 0), rng=np.random.default_rng(1))
    recorded = cv2.imread(str(folder / "images" / "000000.jpg"))
    for u, v in ((240, 150), (270, 80), (100, 230), (330, 200)):
        boxes = [image[v - 4 : v + 5, u - 4 : u + 5].reshape(-1, 3).mean(axis=0) for image in (rendered, recorded)]
        assert np.max(np.abs(boxes[0] - boxes[1])) < 12.0
    assert PAINTS["carpet"][1] > 2.0 * PAINTS["carpet"][0]
