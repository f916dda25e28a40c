"""A camera made of one 16-bit linear image: any exposure and gain applied by the recordings' exposure model.

value = clip(L · white balance · exposure_ms · gain · k + noise, 0, 1), on an RGGB mosaic, then demosaiced;
pixel = round(255 · value^(1 / gamma)). See docs/how-to-calibrate.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from touchline.errors import InputError
from touchline.sources.decoding import decode_image
from touchline.sources.description import finite_number
from touchline.sources.folder import Recording
from touchline.types import ImageArray


@dataclass(frozen=True, slots=True)
class SensorConstants:
    """`sensor` of sequence.yaml."""

    k: float
    full_well_electrons: float
    read_noise_electrons: float
    gamma: float
    white_balance_rgb: tuple[float, float, float]
    optics_blur_sigma_px: float
    linear_radiance_at_65535: float

    @classmethod
    def of(cls, recording: Recording) -> SensorConstants:
        """The constants of a recording with linear images. InputError naming what is missing."""
        path = recording.folder / "sequence.yaml"
        sensor = recording.sequence.get("sensor")
        if not recording.linear or not isinstance(sensor, dict):
            raise InputError(f"{path}: says nothing of linear images (sensor: linear_png: true)")
        names = [name for name in cls.__slots__ if name != "white_balance_rgb"]
        numbers = {name: _positive(sensor, name, f"{path}: sensor") for name in names}
        balance = sensor.get("white_balance_rgb")
        shares = [finite_number(value) for value in balance] if isinstance(balance, list) else []
        if len(shares) != 3 or any(value is None or value <= 0.0 for value in shares):
            raise InputError(f"{path}: sensor: 'white_balance_rgb' needs three positive numbers")
        red, green, blue = (float(value) for value in shares if value is not None)
        return cls(white_balance_rgb=(red, green, blue), **numbers)


class LinearImageCamera:
    """Offers `set` and `grab` over a linear image. radiance: (H, W, 3) linear, B, G, R."""

    def __init__(
        self, radiance: npt.NDArray[np.float32], sensor: SensorConstants, rng: np.random.Generator | None = None
    ) -> None:
        self.sensor = sensor
        self._rng = np.random.default_rng(0) if rng is None else rng
        self._exposure_ms, self._gain = 1.0, 1.0
        blur = sensor.optics_blur_sigma_px
        balance = np.array(sensor.white_balance_rgb[::-1], dtype=np.float32)
        blurred = cv2.GaussianBlur(radiance, (0, 0), blur) if blur > 0.0 else radiance
        self._mosaic = _mosaic(np.asarray(blurred * balance, dtype=np.float32))

    @classmethod
    def open(cls, recording: Recording, index: int, rng: np.random.Generator | None = None) -> LinearImageCamera:
        """The camera of one image of a recording with linear images. InputError if the image can't be read."""
        sensor = SensorConstants.of(recording)
        name = recording.image_name(index)
        decoded = decode_image(recording.folder / name)
        if decoded.pixels is None or decoded.pixels.dtype != np.uint16:
            raise InputError(f"{recording.folder / name}: is not a 16-bit linear image {decoded.what}".rstrip())
        radiance = decoded.pixels.astype(np.float32) * (sensor.linear_radiance_at_65535 / 65535.0)
        return cls(radiance, sensor, rng)

    def set(self, exposure_ms: float, gain: float) -> None:
        """Use these settings from the next image on."""
        if not (math.isfinite(exposure_ms) and math.isfinite(gain) and exposure_ms > 0.0 and gain > 0.0):
            raise InputError(f"camera: exposure and gain must be positive, found {exposure_ms} ms and {gain}")
        self._exposure_ms, self._gain = exposure_ms, gain

    def grab(self) -> ImageArray:
        """An image (H, W, 3), B, G, R, with the settings set last and fresh noise."""
        s = self.sensor
        value = self._mosaic * np.float32(self._exposure_ms * self._gain * s.k)
        shot = self._gain / s.full_well_electrons
        deviation = np.sqrt(value * np.float32(shot) + np.float32((s.read_noise_electrons * shot) ** 2))
        value += deviation * self._rng.standard_normal(value.shape, dtype=np.float32)
        codes = (np.clip(value, 0.0, 1.0) * 65535.0 + 0.5).astype(np.uint16)
        colour = cv2.cvtColor(codes, cv2.COLOR_BayerRGGB2BGR)
        response = np.rint(255.0 * (np.arange(65536) / 65535.0) ** (1.0 / s.gamma)).astype(np.uint8)
        image: ImageArray = response[colour]
        return image


def _mosaic(colour: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """What the pixels behind an RGGB pattern get, (H, W), of (H, W, 3) B, G, R."""
    mosaic = colour[..., 1].copy()
    mosaic[0::2, 0::2] = colour[0::2, 0::2, 2]
    mosaic[1::2, 1::2] = colour[1::2, 1::2, 0]
    return mosaic


def _positive(sensor: Mapping[str, Any], name: str, where: str) -> float:
    number = finite_number(sensor.get(name))
    if number is None or number < 0.0 or (number == 0.0 and "sigma" not in name and "noise" not in name):
        raise InputError(f"{where}: '{name}' must be a positive number, found {sensor.get(name)!r}")
    return number
