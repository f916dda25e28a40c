"""A camera made of one linear image, recorded or rendered: any exposure and gain applied by the exposure model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from touchline.errors import InputError
from touchline.simulation.cameras.image_sensor import ImageSensor, check_exposure
from touchline.sources.description import finite_number
from touchline.sources.folder import Recording
from touchline.types import ImageArray

_NUMBERS = ("k", "full_well_electrons", "read_noise_electrons", "gamma", "optics_blur_sigma_px")


class LinearImageCamera:
    """Offers `set` and `grab`, as the exposure control wants them, over a linear image.

    radiance: (H, W, 3) float32, red green blue, without blur and noise. rng: of the noise.
    """

    def __init__(
        self,
        radiance: npt.NDArray[np.float32],
        sensor: ImageSensor | None = None,
        rng: np.random.Generator | None = None,
    ) -> None:
        self.radiance = radiance
        self.sensor = sensor or ImageSensor()
        self._rng = np.random.default_rng(0) if rng is None else rng
        self._exposure_ms, self._gain = 12.0, 1.7

    @classmethod
    def open(cls, recording: Recording, index: int, rng: np.random.Generator | None = None) -> LinearImageCamera:
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
