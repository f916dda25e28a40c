"""The image sensor against its documented moments; pictures against the recorded ones."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from touchline.errors import InputError
from touchline.sources import open_source
from touchline_lab.simulation.cameras.image_sensor import ImageSensor, LinearImageCamera, noise_numbers

pytestmark = pytest.mark.slow  # rendering

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


def plain_picture(
    sensor: ImageSensor, radiance: npt.NDArray[np.float32], exposure_ms: float, gain: float, seed: int | None
) -> npt.NDArray[np.uint8]:
    """The picture by OpenCV's own blur and demosaicing and by the formula as it is written."""
    height, width, sigma = *radiance.shape[:2], sensor.optics_blur_sigma_px
    size = 2 * math.ceil(2.5 * sigma) + 1
    blurred = np.asarray(cv2.GaussianBlur(radiance, (size, size), sigma) if sigma > 0.0 else radiance, dtype=float)
    rows, columns = np.indices((height, width))
    channel = (rows % 2 + columns % 2)[..., np.newaxis]  # RGGB
    value = np.take_along_axis(blurred * sensor.white_balance_rgb, channel, axis=2)[..., 0]
    value *= exposure_ms * gain * sensor.k
    if seed is not None:
        shot = gain / sensor.full_well_electrons
        variance = value * shot + (sensor.read_noise_electrons * shot) ** 2
        value += noise_numbers(np.random.default_rng(seed), height * width).reshape(height, width) * np.sqrt(variance)
    mosaic = (np.clip(value, 0.0, 1.0) * 65535.0 + 0.5).astype(np.uint16)
    colour = cv2.cvtColor(mosaic, cv2.COLOR_BayerRGGB2BGR)
    return np.round(255.0 * (colour / 65535.0) ** (1.0 / sensor.gamma)).astype(np.uint8)


@pytest.mark.parametrize("seed", [None, 8])
@pytest.mark.parametrize("sigma", [0.0, 0.3, 0.6, 1.3, 3.0])
def test_pictures_of_all_sizes_are_those_of_plain_arithmetic(sigma: float, seed: int | None) -> None:
    sensor = ImageSensor(optics_blur_sigma_px=sigma)
    content = np.random.default_rng(6)
    small = [(h, w) for h in range(1, 10) for w in range(1, 10)]
    for height, width in (*small, (64, 33), (61, 80), (3, 200), (201, 2), (480, 480), (480, 752)):
        radiance = (content.uniform(0.0, 0.7, (height, width, 3)) ** 2).astype(np.float32)  # up to some that clip
        before = radiance.copy()
        rng = None if seed is None else np.random.default_rng(seed)
        picture = sensor.develop(radiance, 12.0, 1.7, rng)
        apart = np.abs(picture.astype(int) - plain_picture(sensor, radiance, 12.0, 1.7, seed)).max(axis=2)
        assert apart.max() <= 1
        assert np.count_nonzero(apart) <= math.ceil(1e-4 * apart.size)  # what rounding of sums does
        assert np.array_equal(radiance, before)


def test_exposure_times_gain_counts_and_bright_things_clip() -> None:
    dim, same, bright = (FLAT.develop(even(0.1), e, g, None) for e, g in ((12.0, 1.0), (3.0, 4.0), (200.0, 4.0)))
    assert np.array_equal(dim, same)
    assert np.all(dim == round(255.0 * (0.1 * 12.0 * 0.16) ** (1.0 / 2.2)))
    assert np.all(bright == 255)


def test_linear_images_follow_the_documented_model(small_data: Path) -> None:
    source = open_source(small_data / "omni_exposure")
    camera = LinearImageCamera.open(source, 1)
    camera.set(10.0, 1.0)
    dark = camera.grab().astype(float)
    camera.set(10.0, 2.0)
    bright = camera.grab().astype(float)
    usable = (dark > 60).all(axis=2) & (bright < 220).all(axis=2)
    ratio = np.median((bright[usable] / dark[usable]) ** 2.2)
    assert ratio == pytest.approx(2.0, rel=0.02)
    camera.set(400.0, 1.0)
    assert (camera.grab()[usable] == 255).mean() > 0.8  # the rest mixes with what is black beside it


def test_recordings_without_linear_images_are_refused(small_data: Path) -> None:
    with pytest.raises(InputError, match="says nothing of linear images"):
        LinearImageCamera.open(open_source(small_data / "omni_msl_sun"), 0)
    camera = LinearImageCamera.open(open_source(small_data / "omni_exposure"), 0)
    with pytest.raises(InputError, match="positive"):
        camera.set(-1.0, 1.0)
