"""The carpet's look: pile as a pyramid of tiles, wear as slow changes of brightness; colour only, no relief."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from touchline.simulation.rendering.pile import LEVELS, TILE_TEXELS


def pile_pyramid(rng: np.random.Generator) -> npt.NDArray[np.float32]:
    """Brightness of the pile: LEVELS tiles one after the other, float32, mean 0, standard deviation 1 at the finest
    level.

    Level n is the finest one (512 x 512 texels) averaged over 2^n texels (512 / 2^n squared), so that a look-up at a
    level whose texel is as large as a pixel's footprint shows what a camera would average: the further, the smoother.
    The finest level is white noise plus weaker noise 4, 16 and 64 texels wide, which distance leaves over.
    """
    size = TILE_TEXELS
    tile = 1.0 * rng.standard_normal((size, size))
    for step, strength in ((4, 0.25), (16, 0.15), (64, 0.12)):
        coarse = rng.standard_normal((size // step, size // step))
        tile += strength * _stretched(coarse, step)
    tile -= tile.mean()
    tile /= tile.std()
    levels = [tile]
    for _ in range(1, LEVELS):
        last = levels[-1]
        half = 0.25 * (last[::2, ::2] + last[1::2, ::2] + last[::2, 1::2] + last[1::2, 1::2])
        levels.append(half)
    return np.concatenate([level.ravel() for level in levels]).astype(np.float32)


def wear_map(rng: np.random.Generator, columns: int, rows: int, step_m: float) -> npt.NDArray[np.float64]:
    """Slow brightness of a used carpet (rows, columns), mean 0, standard deviation 1: blotches of 0.5 to 4 m."""
    total = np.zeros((rows, columns))
    for size_m, strength in ((0.5, 0.45), (1.2, 0.6), (4.0, 0.8)):
        step = max(1, round(size_m / step_m))
        coarse = rng.standard_normal((rows // step + 4, columns // step + 4))
        y, x = np.arange(rows) / step, np.arange(columns) / step
        total += strength * _interpolated(coarse, x, y)
    total -= total.mean()
    return np.asarray(total / total.std())


def _stretched(coarse: npt.NDArray[np.float64], step: int) -> npt.NDArray[np.float64]:
    """A periodic tile enlarged `step` times with linear interpolation."""
    size = len(coarse)
    position = (np.arange(size * step) + 0.5) / step - 0.5
    i, f = np.floor(position).astype(int), position - np.floor(position)
    rows = coarse[i % size] * (1.0 - f)[:, np.newaxis] + coarse[(i + 1) % size] * f[:, np.newaxis]
    return np.asarray(rows[:, i % size] * (1.0 - f) + rows[:, (i + 1) % size] * f)


def _interpolated(
    coarse: npt.NDArray[np.float64], x: npt.NDArray[np.float64], y: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Smoothstep interpolation of a grid at columns x and rows y."""
    i, j = x.astype(int), y.astype(int)
    f, g = x - i, y - j
    f, g = f * f * (3.0 - 2.0 * f), g * g * (3.0 - 2.0 * g)
    top = coarse[np.ix_(j, i)] * (1.0 - f) + coarse[np.ix_(j, i + 1)] * f
    bottom = coarse[np.ix_(j + 1, i)] * (1.0 - f) + coarse[np.ix_(j + 1, i + 1)] * f
    return np.asarray(top * (1.0 - g)[:, np.newaxis] + bottom * g[:, np.newaxis])
