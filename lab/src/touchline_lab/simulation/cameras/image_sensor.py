"""Linear radiance -> the 8-bit picture of a camera: blur, mosaic, noise, demosaic, response; one image as a camera.

    value = clip(L * white_balance * exposure_ms * gain * k + noise, 0, 1)
    noise: variance = value * gain / full_well_electrons + (read_noise_electrons * gain / full_well_electrons)^2
    pixel = round(255 * value^(1 / gamma))

Before that the lens may scatter part of the light around (bloom) and darken the corners (vignetting: by a part that
grows with the square of the distance from the middle).
Noise is normal with mean 0 and that variance on the RGGB mosaic, whose values have 16 bits; the mosaic is demosaiced
bilinearly. The normal numbers come from a table of 2^22, read from a random place on for each image: independent from
pixel to pixel, and at one pixel from image to image but for one pair of images in four million.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from typing_extensions import Self

from touchline.errors import InputError
from touchline.geometry import ByteArray, Float32Array
from touchline.sources.description import finite_number
from touchline.sources.folder import Recording
from touchline.types import ImageArray

_NUMBERS = ("k", "full_well_electrons", "read_noise_electrons", "gamma", "optics_blur_sigma_px")  # of sequence.yaml


@dataclass(frozen=True, slots=True)
class ImageSensor:
    """Constants of the exposure model; the defaults are those of the recorded cameras."""

    k: float = 0.16
    full_well_electrons: float = 12000.0
    read_noise_electrons: float = 12.0
    gamma: float = 2.2
    white_balance_rgb: tuple[float, float, float] = (1.0, 1.064, 1.19)
    optics_blur_sigma_px: float = 0.6
    vignetting: float = 0.0
    bloom: float = 0.0

    def __post_init__(self) -> None:
        positive = (self.k, self.full_well_electrons, self.gamma, *self.white_balance_rgb)
        other = (self.read_noise_electrons, self.optics_blur_sigma_px, self.vignetting, self.bloom)
        if not (all(map(math.isfinite, (*positive, *other))) and min(positive) > 0.0 and min(other) >= 0.0):
            what = "k, full well, gamma and white balance are positive, noise and blur not negative"
            raise InputError(f"image sensor: {what}")

    def develop(
        self, radiance: Float32Array, exposure_ms: float, gain: float, rng: np.random.Generator | None
    ) -> ImageArray:
        """The picture (H, W, 3) uint8 BGR of linear radiance (H, W, 3) float32, red green blue.

        rng None leaves the noise out. Raises InputError for an exposure or gain that is not positive.
        """
        check_exposure(exposure_ms, gain)
        height, width = radiance.shape[:2]
        if height < 3 or width < 3:  # such a mosaic has no pixel with neighbours all around
            return np.zeros((height, width, 3), dtype=np.uint8)
        if self.bloom > 0.0:
            radiance = (1.0 - self.bloom) * radiance + self.bloom * _scattered(radiance)
        if self.optics_blur_sigma_px > 0.0:
            size = 2 * math.ceil(2.5 * self.optics_blur_sigma_px) + 1
            radiance = np.asarray(cv2.GaussianBlur(radiance, (size, size), self.optics_blur_sigma_px))
        mosaic = np.empty((height, width), dtype=np.float32)
        for row, column in ((0, 0), (0, 1), (1, 0), (1, 1)):
            channel = row + column  # RGGB
            scale = np.float32(self.white_balance_rgb[channel] * exposure_ms * gain * self.k)
            np.multiply(radiance[row::2, column::2, channel], scale, out=mosaic[row::2, column::2])
        if self.vignetting > 0.0:
            mosaic *= 1.0 - np.float32(self.vignetting) * _distance_squared(height, width)
        if rng is not None:
            shot = np.float32(gain / self.full_well_electrons)
            deviation = np.sqrt(mosaic * shot + (np.float32(self.read_noise_electrons) * shot) ** 2)
            mosaic += deviation * noise_numbers(rng, height * width).reshape(height, width)
        codes = (np.clip(mosaic, 0.0, 1.0, out=mosaic) * np.float32(65535.0) + np.float32(0.5)).astype(np.uint16)
        return _response(self.gamma)[cv2.cvtColor(codes, cv2.COLOR_BayerRGGB2BGR)]

    def sequence_constants(self) -> dict[str, Any]:
        """The `sensor` mapping of a recording's sequence.yaml."""
        constants: dict[str, Any] = asdict(self)
        for name in ("vignetting", "bloom"):
            if constants[name] == 0.0:
                del constants[name]
        constants["white_balance_rgb"] = list(self.white_balance_rgb)
        constants["bayer"] = "RGGB, demosaiced"
        return constants


def check_exposure(exposure_ms: float, gain: float) -> None:
    """InputError unless both are positive numbers."""
    if not (math.isfinite(exposure_ms) and exposure_ms > 0.0 and math.isfinite(gain) and gain > 0.0):
        raise InputError(f"camera: exposure and gain are positive, found {exposure_ms} ms and {gain}")


_NOISE_COUNT = 1 << 22


@lru_cache(maxsize=1)
def _noise_table() -> Float32Array:
    return np.random.default_rng(20130701).standard_normal(_NOISE_COUNT, dtype=np.float32)


def noise_numbers(rng: np.random.Generator, count: int) -> Float32Array:
    """Normal numbers (count,) of variance 1, the noise of an image of so many pixels: a part of one fixed table."""
    table = _noise_table()
    if count > len(table) // 4:
        return rng.standard_normal(count, dtype=np.float32)
    start = int(rng.integers(len(table) - count))
    return table[start : start + count]


def _scattered(radiance: Float32Array) -> Float32Array:
    """The light (H, W, 3) that a lens throws around: a twentieth of the image's width, and over all of it."""
    height, width = radiance.shape[:2]
    small = cv2.resize(radiance, (max(width // 8, 1), max(height // 8, 1)), interpolation=cv2.INTER_AREA)
    near = cv2.GaussianBlur(small, (0, 0), width / 160.0)
    around = 0.6 * near + 0.4 * small.mean(axis=(0, 1), dtype=np.float32)
    return np.asarray(cv2.resize(around, (width, height), interpolation=cv2.INTER_LINEAR))


@lru_cache(maxsize=4)
def _distance_squared(height: int, width: int) -> Float32Array:
    """(H, W) squared distance from the middle, 1 in the corners."""
    y, x = np.ogrid[-1.0 : 1.0 : height * 1j, -1.0 : 1.0 : width * 1j]
    return np.asarray((x * x * width**2 + y * y * height**2) / (width**2 + height**2), dtype=np.float32)


@lru_cache(maxsize=8)
def _response(gamma: float) -> ByteArray:
    """The 8-bit code of each 16-bit value (65536,)."""
    return np.round(255.0 * (np.arange(65536) / 65535.0) ** (1.0 / gamma)).astype(np.uint8)


class LinearImageCamera:
    """Offers `set` and `grab`, as the exposure control wants them, over a linear image.

    radiance: (H, W, 3) float32, red green blue, without blur and noise. rng: of the noise.
    """

    def __init__(
        self, radiance: Float32Array, sensor: ImageSensor | None = None, rng: np.random.Generator | None = None
    ) -> None:
        self.radiance = radiance
        self.sensor = sensor or ImageSensor()
        self._rng = np.random.default_rng(0) if rng is None else rng
        self._exposure_ms, self._gain = 12.0, 1.7

    @classmethod
    def open(cls, recording: Recording, index: int, rng: np.random.Generator | None = None) -> Self:
        """The camera of one image of a recording of 16-bit linear images. InputError if it can't be read."""
        sensor, scale = _sensor_of(recording)
        file = recording.path / recording.image_name(index)
        decoded = recording.stored_image(index)
        if decoded.pixels is None or decoded.pixels.dtype != np.uint16:
            raise InputError(f"{file}: is no 16-bit linear image{': ' + decoded.what if decoded.what else ''}")
        radiance = np.ascontiguousarray(decoded.pixels[..., ::-1], dtype=np.float32) * np.float32(scale / 65535.0)
        return cls(radiance, sensor, rng)

    def set(self, exposure_ms: float, gain: float) -> None:
        """Use these settings from the next image on. Raises InputError unless both are positive."""
        check_exposure(exposure_ms, gain)
        self._exposure_ms, self._gain = exposure_ms, gain

    def grab(self) -> ImageArray:
        """An image (H, W, 3), B, G, R, with the settings set last and fresh noise."""
        return self.sensor.develop(self.radiance, self._exposure_ms, self._gain, self._rng)


def _sensor_of(recording: Recording) -> tuple[ImageSensor, float]:
    """The sensor of sequence.yaml, and the radiance of the code 65535."""
    path = recording.folder / "sequence.yaml"
    sensor = recording.sequence.get("sensor")
    if not recording.linear or not isinstance(sensor, Mapping):
        raise InputError(f"{path}: says nothing of linear images (sensor: linear_png: true)")
    balance = sensor.get("white_balance_rgb")
    if not isinstance(balance, list) or len(balance) != 3:
        raise InputError(f"{path}: sensor: 'white_balance_rgb' needs three numbers")
    red, green, blue = (_number(value, "white_balance_rgb", str(path)) for value in balance)
    numbers: dict[str, Any] = {name: _number(sensor.get(name), name, str(path)) for name in _NUMBERS}
    scale = _number(sensor.get("linear_radiance_at_65535"), "linear_radiance_at_65535", str(path))
    return ImageSensor(white_balance_rgb=(red, green, blue), **numbers), scale


def _number(value: object, name: str, path: str) -> float:
    number = finite_number(value)
    if number is None:
        raise InputError(f"{path}: sensor: '{name}' must be a number, found {value!r}")
    return number
