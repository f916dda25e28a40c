"""The carpet's look: pile as a pyramid of tiles, seams, wear and worn lines; colour only, no relief."""

import cv2
import numpy as np
from numba import njit

from touchline.geometry import Float32Array, FloatArray

_TILE_TEXELS, _LEVELS = 512, 9  # of the pile's pyramid
_TEXEL_M = 0.006  # of its finest level: a tile of 3 m
_MIN_TILE_TEXELS = _TILE_TEXELS >> (_LEVELS - 1)
PILE = 0.10  # standard deviation of the pile's brightness at its finest texel
SEAM_M = 0.012  # width of a seam between two strips of carpet
SEAM_OFFSET = 0.37  # of the strips from the middle of the field, in strips
_SEAM_DEPTH = 0.4  # by so much a seam is darker
_PATCH = 0.15  # the pile's tile, enlarged by 1 / 0.15, tells where paint is rubbed off: patches of 4 cm


def pile_pyramid(rng: np.random.Generator) -> Float32Array:
    """Brightness of the pile: tiles one after the other, float32, mean 0, standard deviation 1 at the finest level.

    Level n is the finest one (512 x 512 texels) averaged over 2^n texels (512 / 2^n squared), so that a look-up at a
    level whose texel is as large as a pixel's footprint shows what a camera would average: the further, the smoother.
    The finest level is white noise plus weaker noise 4, 16 and 64 texels wide, which distance leaves over.
    """
    tile = rng.standard_normal((_TILE_TEXELS, _TILE_TEXELS))
    for step, strength in ((4, 0.25), (16, 0.15), (64, 0.12)):
        coarse = rng.standard_normal((_TILE_TEXELS // step, _TILE_TEXELS // step))
        around = cv2.resize(np.pad(coarse, 1, mode="wrap"), None, fx=step, fy=step, interpolation=cv2.INTER_LINEAR)
        tile += strength * around[step:-step, step:-step]
    levels = [(tile - tile.mean()) / tile.std()]
    for _ in range(1, _LEVELS):
        last = levels[-1]
        levels.append(0.25 * (last[::2, ::2] + last[1::2, ::2] + last[::2, 1::2] + last[1::2, 1::2]))
    return np.concatenate([level.ravel() for level in levels]).astype(np.float32)


def wear_map(rng: np.random.Generator, columns: int, rows: int, step_m: float) -> FloatArray:
    """Slow brightness of a used carpet (rows, columns), mean 0, standard deviation 1: blotches of 0.5 to 4 m."""
    total = np.zeros((rows, columns))
    for size_m, strength in ((0.5, 0.45), (1.2, 0.6), (4.0, 0.8)):
        step = max(1, round(size_m / step_m))
        coarse = rng.standard_normal((rows // step + 4, columns // step + 4))
        smooth = cv2.resize(coarse, None, fx=step, fy=step, interpolation=cv2.INTER_CUBIC)
        total += strength * smooth[step : step + rows, step : step + columns]
    total -= total.mean()
    return np.asarray(total / total.std())


@njit(cache=True, error_model="numpy")
def pile_at(pyramid: Float32Array, x: float, y: float, square: float) -> float:
    """Brightness of the pile (mean 0) at a point (m), smoothed to a footprint of that square (m^2).

    Between the texels of the level whose texel is the next larger, without kinks.
    """
    start, size, texel = 0, _TILE_TEXELS, _TEXEL_M
    while texel * texel < square and size > _MIN_TILE_TEXELS:
        start += size * size
        size >>= 1
        texel *= 2.0
    mask, scale = size - 1, 1.0 / texel
    fx, fy = x * scale + 65536.0, y * scale + 65536.0
    i, j = np.int64(fx), np.int64(fy)
    a, b = fx - i, fy - j
    a, b = a * a * (3.0 - 2.0 * a), b * b * (3.0 - 2.0 * b)
    low, high = start + (j & mask) * size, start + ((j + 1) & mask) * size
    i0, i1 = i & mask, (i + 1) & mask
    top = pyramid[low + i0] * (1.0 - a) + pyramid[low + i1] * a
    bottom = pyramid[high + i0] * (1.0 - a) + pyramid[high + i1] * a
    return float(top * (1.0 - b) + bottom * b)


@njit(cache=True, error_model="numpy")
def seam_shade(carpet: FloatArray, x: float, width: float) -> float:
    """What a thin dark seam between strips of carpet across the field's length leaves of the light.

    Box-filtered over a width (m). carpet[3]: spacing of the seams (m).
    """
    strip = x / carpet[3] + SEAM_OFFSET
    offset, width = (strip - np.round(strip)) * carpet[3], max(width, 1e-6)
    dark = min(offset + 0.5 * width, 0.5 * SEAM_M) - max(offset - 0.5 * width, -0.5 * SEAM_M)
    return float(1.0 - _SEAM_DEPTH * max(dark, 0.0) / width)


@njit(cache=True, error_model="numpy")
def rubbed_off(pyramid: Float32Array, wear: FloatArray, x: float, y: float) -> tuple[float, float]:
    """Share of the paint that is rubbed off at a point of a line, and share of the light that dirt takes.

    wear (2,): of the lines, scuffed ratio (patches a few centimetres large) and dirt (stretches of metres), 0 to 1.
    """
    patch = pile_at(pyramid, _PATCH * x, _PATCH * y, 0.0)
    stretch = pile_at(pyramid, x, y, 0.3)
    level = 0.7 * patch + 2.0 * stretch
    bare = min(max(2.0 * (level + 2.5 * wear[0] - 1.25), 0.0), 1.0) if wear[0] > 0.0 else 0.0
    return bare, wear[1] * min(max(0.5 + 2.0 * stretch + 0.3 * patch, 0.0), 1.0)
