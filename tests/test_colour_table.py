"""The table of colours: what its loop fills in is what the definition says, cell by cell."""

import numpy as np
import pytest

from touchline.geometry import ByteArray, FloatArray
from touchline.perception.colour import (
    _BITS,
    DARKEST_GREEN,
    GREEN,
    GREEN_SIGMAS,
    OTHER,
    WHITE,
    WHITEST_GREEN,
    Carpet,
    _build_table,
    chromaticity,
)


def _defined(carpet: Carpet, white: FloatArray, signal: FloatArray) -> ByteArray:
    """The same, of all cells at once."""
    levels = (np.arange(1 << _BITS) + 0.5) * (1 << (8 - _BITS))
    cells, green = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), axis=-1).reshape(-1, 3), carpet.green
    offset, brightness = chromaticity(cells) - carpet.center, cells.sum(axis=1) / green.sum()
    distance = np.sqrt(np.einsum("ni,ij,nj->n", offset, np.linalg.inv(carpet.spread), offset))
    excess, toward = cells - green, white - green
    is_green = distance < GREEN_SIGMAS * np.clip(1.0 / brightness, 0.6, 3.0)
    is_green &= (brightness > DARKEST_GREEN) & (excess @ signal < WHITEST_GREEN)
    blue, limited, red = cells.T
    follows = np.abs(blue - red * green[0] / max(green[2], 1e-9)) < 25.0
    is_green |= (limited > 246.0) & (red < 0.85 * limited) & follows
    ahead = excess @ toward
    cosine = ahead / np.maximum(np.linalg.norm(excess, axis=1) * np.linalg.norm(toward), 1e-9)
    is_white = ~is_green & (cosine > 0.8) & (ahead > 0.3 * float(toward @ toward))
    classes: ByteArray = np.where(is_green, GREEN, np.where(is_white, WHITE, OTHER)).astype(np.uint8)
    return classes.reshape((1 << _BITS,) * 3)


@pytest.mark.parametrize("seed", range(5))
def test_the_loop_fills_in_what_is_defined(seed: int) -> None:
    rng = np.random.default_rng(seed)
    green = np.array([rng.uniform(30.0, 90.0), rng.uniform(90.0, 150.0), rng.uniform(20.0, 80.0)])
    spread = np.diag(rng.uniform(2e-4, 2e-3, 2))
    carpet = Carpet(np.zeros((0, 3)), green, chromaticity(green[np.newaxis])[0], spread, 3.0)
    white = rng.uniform(180.0, 250.0, 3)
    signal = rng.uniform(0.001, 0.004, 3)
    table, defined = _build_table(carpet, white, signal), _defined(carpet, white, signal)
    assert len(np.unique(defined)) == 3
    assert (table != defined).mean() < 1e-4  # on an edge sums in another order may decide otherwise
