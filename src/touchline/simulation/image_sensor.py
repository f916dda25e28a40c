"""Linear radiance -> the 8-bit picture of a camera: blur, mosaic, noise, demosaic, response.

    value = clip(L * white_balance * exposure_ms * gain * k + noise, 0, 1)
    noise: variance = value * gain / full_well_electrons + (read_noise_electrons * gain / full_well_electrons)^2
    pixel = round(255 * value^(1 / gamma))

Noise is normal with mean 0 and that variance on the RGGB mosaic, whose values have 16 bits; the mosaic is demosaiced
bilinearly. The normal numbers come from a table of 2^22, read from a random place on for each image: independent from
pixel to pixel, and at one pixel from image to image but for one pair of images in four million.
"""

from __future__ import annotations

import math
import threading
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.errors import InputError
from touchline.types import ImageArray


@dataclass(frozen=True, slots=True)
class ImageSensor:
    """Constants of the exposure model; the defaults are those of the recorded cameras."""

    k: float = 0.16
    full_well_electrons: float = 12000.0
    read_noise_electrons: float = 12.0
    gamma: float = 2.2
    white_balance_rgb: tuple[float, float, float] = (1.0, 1.064, 1.19)
    optics_blur_sigma_px: float = 0.6

    def __post_init__(self) -> None:
        positive = (self.k, self.full_well_electrons, self.gamma, *self.white_balance_rgb)
        other = (self.read_noise_electrons, self.optics_blur_sigma_px)
        if not (
            all(math.isfinite(v) and v > 0.0 for v in positive) and all(math.isfinite(v) and v >= 0.0 for v in other)
        ):
            raise InputError(
                "image sensor: k, full well, gamma and white balance are positive, noise and blur not negative"
            )

    def develop(
        self, radiance: npt.NDArray[np.float32], exposure_ms: float, gain: float, rng: np.random.Generator | None
    ) -> ImageArray:
        """The picture (H, W, 3) uint8 BGR of linear radiance (H, W, 3) float32, red green blue.

        rng None leaves the noise out. Raises InputError for an exposure or gain that is not positive.
        """
        check_exposure(exposure_ms, gain)
        shape = radiance.shape[:2]
        blurred, mosaic, colour = _space(shape[0], shape[1])
        if self.optics_blur_sigma_px > 0.0:
            size = 2 * math.ceil(2.5 * self.optics_blur_sigma_px) + 1
            radiance = cv2.GaussianBlur(  # type: ignore[assignment]
                radiance, (size, size), self.optics_blur_sigma_px, dst=blurred
            )
        scale = np.array(self.white_balance_rgb) * exposure_ms * gain * self.k
        noise = np.zeros(1, dtype=np.float32) if rng is None else _noise(rng, shape[0] * shape[1])
        shot = gain / self.full_well_electrons
        expose(radiance, noise, scale, shot, (self.read_noise_electrons * shot) ** 2, mosaic)
        cv2.cvtColor(mosaic, cv2.COLOR_BayerRGGB2BGR, dst=colour)
        picture = np.empty((*shape, 3), dtype=np.uint8)
        respond(colour, _response(self.gamma), picture)
        return picture

    def sequence_constants(self) -> dict[str, Any]:
        """The `sensor` mapping of a recording's sequence.yaml."""
        constants: dict[str, Any] = asdict(self)
        constants["white_balance_rgb"] = list(self.white_balance_rgb)
        constants["bayer"] = "RGGB, demosaiced"
        return constants


def check_exposure(exposure_ms: float, gain: float) -> None:
    """InputError unless both are positive numbers."""
    if not (math.isfinite(exposure_ms) and exposure_ms > 0.0 and math.isfinite(gain) and gain > 0.0):
        raise InputError(f"camera: exposure and gain are positive, found {exposure_ms} ms and {gain}")


_kept = threading.local()


def _space(height: int, width: int) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint16], npt.NDArray[np.uint16]]:
    """Arrays (H, W, 3), (H, W), (H, W, 3) for what comes between radiance and picture, kept for images of one size."""
    if getattr(_kept, "size", None) != (height, width):
        _kept.size = height, width
        _kept.arrays = (
            np.empty((height, width, 3), dtype=np.float32),
            np.empty((height, width), dtype=np.uint16),
            np.empty((height, width, 3), dtype=np.uint16),
        )
    arrays: tuple[npt.NDArray[np.float32], npt.NDArray[np.uint16], npt.NDArray[np.uint16]] = _kept.arrays
    return arrays


_NOISE_COUNT = 1 << 22


@lru_cache(maxsize=1)
def _noise_table() -> npt.NDArray[np.float32]:
    return np.random.default_rng(20130701).standard_normal(_NOISE_COUNT, dtype=np.float32)


def _noise(rng: np.random.Generator, count: int) -> npt.NDArray[np.float32]:
    """Normal numbers (count,) of variance 1: a part of one fixed table."""
    table = _noise_table()
    if count > len(table) // 4:
        return rng.standard_normal(count, dtype=np.float32)
    start = int(rng.integers(len(table) - count))
    return table[start : start + count]


@lru_cache(maxsize=8)
def _response(gamma: float) -> npt.NDArray[np.uint8]:
    """The 8-bit code of each 16-bit value (65536,)."""
    return np.round(255.0 * (np.arange(65536) / 65535.0) ** (1.0 / gamma)).astype(np.uint8)


@njit(cache=True, error_model="numpy")
def expose(
    radiance: npt.NDArray[np.float32],
    noise: npt.NDArray[np.float32],
    scale: npt.NDArray[np.float64],
    shot: float,
    read_variance: float,
    mosaic: npt.NDArray[np.uint16],
) -> None:
    """Fill an RGGB mosaic (H, W) of 16-bit values. scale (3,): value per radiance; noise (H W,) of variance 1, or
    (1,)."""
    width = mosaic.shape[1]
    for v in range(mosaic.shape[0]):
        for first in range(2):
            channel = (v & 1) + first
            values = radiance[v, first::2, channel]
            parts = noise[v * width + first : (v + 1) * width : 2] if len(noise) > 1 else noise[:0]
            _expose_row(
                values, parts, np.float32(scale[channel]), np.float32(shot), np.float32(read_variance),
                mosaic[v, first::2],
            )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _expose_row(
    radiance: npt.NDArray[np.float32],
    noise: npt.NDArray[np.float32],
    scale: np.float32,
    shot: np.float32,
    read_variance: np.float32,
    mosaic: npt.NDArray[np.uint16],
) -> None:
    """The pixels of one colour in one row, all (N,); noise may be empty."""
    none, one, top, half = np.float32(0.0), np.float32(1.0), np.float32(65535.0), np.float32(0.5)
    if len(noise) > 0:
        for u in range(len(mosaic)):
            value = radiance[u] * scale
            value += noise[u] * np.sqrt(max(value * shot + read_variance, none))
            mosaic[u] = np.uint16(min(max(value, none), one) * top + half)
    else:
        for u in range(len(mosaic)):
            mosaic[u] = np.uint16(min(max(radiance[u] * scale, none), one) * top + half)


@njit(cache=True, error_model="numpy")
def respond(colour: npt.NDArray[np.uint16], response: npt.NDArray[np.uint8], picture: npt.NDArray[np.uint8]) -> None:
    """The response curve, value by value: colour and picture (H, W, 3), response (65536,)."""
    flat, out = colour.reshape(-1), picture.reshape(-1)
    for i in range(len(flat)):
        out[i] = response[flat[i]]
