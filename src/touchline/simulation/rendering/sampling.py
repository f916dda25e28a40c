"""The rays of a pixel's samples, and how far they reach from the ray through its middle."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

Float32Array = npt.NDArray[np.float32]
_SAFETY = 1.05  # reaches are compared along curves that are taken to be straight within a pixel


class SampleRays(NamedTuple):
    """All that follows from a camera's rays (H, W, 6) once it is known which of its pixels see the world.

    side: samples along each side of a pixel (`fill_samples` gives their rays). spread (2, N): largest angles (rad)
    between a pixel's samples and its middle across and along the elevation; widest: the largest of all; shift_m:
    between their origins. texture (5, N): the samples of a grid of side 2 lie at +-p +-q; p and q as angles (rad) along
    and across the elevation (0 with other sides), and the width (rad) over which textures are smoothed, as in angles
    (H W,) for all. aside_m: how far rays pass beside the axis; heights_m: of the lowest and the highest origin.
    """

    side: int
    angles: Float32Array
    spread: Float32Array
    texture: Float32Array
    widest: float
    shift_m: float
    aside_m: float
    heights_m: tuple[float, float]


def sample_rays(rays: Float32Array, pixels: npt.NDArray[np.int32], side: int, pixel_angle: float) -> SampleRays:
    """A regular grid of samples within each of pixels (N,), flat indices, of rays (H, W, 6).

    pixel_angle: width of a pixel (rad) for textures, unless the pixel is in truth notably wider.
    """
    samples = np.empty((6, len(pixels) * side * side), dtype=np.float32)
    fill_samples(rays, pixels, side, samples)
    spread, texture = (np.empty((rows, len(pixels)), dtype=np.float32) for rows in (2, 5))
    angles = np.full(rays[..., 0].size, pixel_angle, dtype=np.float32)
    shift = _measure(rays.reshape(-1, 6), pixels, samples, side * side, spread, texture)
    if side == 2:
        width = 4.0 * np.sqrt(texture[0] ** 2 + texture[2] ** 2)
        angles[pixels] = np.where(width > 1.3 * pixel_angle, width, pixel_angle)
    else:
        texture[:4] = 0.0
    texture[4] = angles[pixels]
    seen = rays.reshape(-1, 6)[pixels].astype(np.float64)
    x, y, z = seen[:, :3].T
    origin = seen[:, :2].mean(axis=0) if len(seen) else np.zeros(2)
    level = np.maximum(np.hypot(seen[:, 3], seen[:, 4]), 1e-9)
    aside = np.abs((x - origin[0]) * seen[:, 4] - (y - origin[1]) * seen[:, 3]) / level
    return SampleRays(
        side, angles, spread, texture, float(spread.max(initial=0.0)), shift, float(aside.max(initial=0.0)),
        (float(z.min(initial=np.inf)), float(z.max(initial=-np.inf))),
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def fill_samples(rays: Float32Array, pixels: npt.NDArray[np.int32], side: int, samples: Float32Array) -> None:
    """Fill rays (6, >= N side^2) on a regular grid within each of pixels (N,), flat indices, pixel after pixel.

    They lie between the rays (H, W, 6) of the pixels' neighbours; a table of them all would not fit the caches.
    """
    flat, width, total = rays.reshape(-1), np.uint32(rays.shape[1]), np.uint32(rays.shape[0] * rays.shape[1])
    offsets = ((np.arange(side) + 0.5) / side - 0.5).astype(np.float32)
    one, half, quarter = np.float32(1.0), np.float32(0.5), np.float32(0.25)
    for i in range(len(pixels)):
        n = np.uint32(pixels[i])
        u = n % width
        left = n - np.uint32(1) if u > 0 and not np.isnan(flat[np.uint32(6 * n - 3)]) else n
        right = n + np.uint32(1) if u + 1 < width and not np.isnan(flat[np.uint32(6 * n + 9)]) else n
        up = n - width if n >= width and not np.isnan(flat[np.uint32(6 * (n - width) + 3)]) else n
        down = n + width if n + width < total and not np.isnan(flat[np.uint32(6 * (n + width) + 3)]) else n
        per_u = half if right - left == 2 else one
        per_v = half if down - up == 2 * width else one
        for c in range(6):
            at = np.uint32(c)
            middle = flat[np.uint32(6 * n + at)]
            du = (flat[np.uint32(6 * right + at)] - flat[np.uint32(6 * left + at)]) * per_u
            dv = (flat[np.uint32(6 * down + at)] - flat[np.uint32(6 * up + at)]) * per_v
            if side == 2:
                k, p, q = np.uint32(4 * i), quarter * du, quarter * dv
                samples[c, k], samples[c, k + np.uint32(1)] = middle - p - q, middle + p - q
                samples[c, k + np.uint32(2)], samples[c, k + np.uint32(3)] = middle - p + q, middle + p + q
            else:
                for b in range(side):
                    for a in range(side):
                        samples[c, (i * side + b) * side + a] = middle + offsets[a] * du + offsets[b] * dv


@njit(cache=True, error_model="numpy")
def _measure(
    rays: Float32Array,
    pixels: npt.NDArray[np.int32],
    samples: Float32Array,
    each: int,
    spread: Float32Array,
    texture: Float32Array,
) -> float:
    """Fill spread (2, N) and texture (5, N), but for its last row, of pixels (N,) with rays (H W, 6).

    samples (6, N each): as from `fill_samples`.

    Returns the largest distance (m) between origins, 0 for single samples.
    """
    shift = 1e-5 if each > 1 else 0.0
    for i in range(len(pixels)):
        n = pixels[i]
        level = np.hypot(rays[n, 3], rays[n, 4])
        ux, uy, rise = rays[n, 3] / level, rays[n, 4] / level, rays[n, 5] / level
        texture[:4, i] = 0.0
        spread[0, i], spread[1, i] = 0.0, 0.0
        for k in range(each):
            j = i * each + k
            dx, dy = samples[3, j], samples[4, j]
            aside = np.arctan2(ux * dy - uy * dx, ux * dx + uy * dy) / np.sqrt(1.0 + rise * rise)
            along = (samples[5, j] / np.hypot(dx, dy) - rise) / (1.0 + rise * rise)
            spread[0, i] = max(spread[0, i], _SAFETY * abs(aside))
            spread[1, i] = max(spread[1, i], _SAFETY * abs(along))
            column, row = (0.25 if k % 2 else -0.25), (0.25 if k // 2 else -0.25)
            texture[0, i] += column * along
            texture[1, i] += column * aside
            texture[2, i] += row * along
            texture[3, i] += row * aside
            apart = 0.0
            for c in range(3):
                apart += (samples[c, j] - rays[n, c]) ** 2
            shift = max(shift, np.sqrt(apart))
    return shift
