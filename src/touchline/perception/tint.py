"""The tint of the light, by the carpet: clouds pass, lamps go on, and what was learned is multiplied by it."""

from dataclasses import replace

import numpy as np
from numba import njit

from touchline.geometry import FloatArray, IntArray
from touchline.perception.colour import CELLS, ColourModel
from touchline.perception.line_graph.sorting import median_of
from touchline.types import ImageArray

NO_TINT = np.ones(3)
_MIN_TINT, _MAX_TINT = 0.04, 0.4  # change of the carpet's colour (logarithm) that is followed, and the most
_MIN_PIXELS = 50  # of carpet, that tell it
_GREENISH = 0.35  # of the learned carpet's excess of green, from which on a colour may be carpet in other light


class Tint:
    """`value` (3,): what multiplies B, G, R of the colours that were learned, brightness aside."""

    def __init__(self, warmth: bool = False) -> None:
        """warmth: blue against red alone is followed: carpet that glosses all about a robot is as pale in both."""
        self.value: FloatArray = NO_TINT
        self._warmth = warmth

    def forget(self) -> None:
        """Colours are learned anew."""
        self.value = NO_TINT

    def follow(self, image: ImageArray, pixels: IntArray, green: FloatArray) -> bool:
        """Whether an image (H, W, 3) has another one. pixels (N, 2): v, u of those that see the ground; green (3,): of
        the learned carpet.
        """
        usual = green / green.sum()
        shares, least = np.empty(3), _GREENISH * (usual[1] - 1.0 / 3.0)
        if _carpet_shares(np.ascontiguousarray(image), pixels, least, shares) < _MIN_PIXELS:
            return False
        change = np.log(np.maximum(shares, 1e-3) / np.maximum(usual, 1e-6))
        if self._warmth:
            change = 0.5 * (change[0] - change[2]) * np.array([1.0, 0.0, -1.0])
        tint = np.exp(np.clip(change, -_MAX_TINT, _MAX_TINT))
        changed = bool(np.abs(np.log(tint / self.value)).max() > _MIN_TINT)
        self.value = tint if changed else self.value
        return changed


def tinted_model(model: ColourModel, tint: FloatArray) -> ColourModel:
    """A model in a light that multiplies B, G, R by a tint (3,)."""
    middles = (np.arange(CELLS) + 0.5) / tint[:, np.newaxis]
    table = model.table[np.ix_(*np.minimum(middles, CELLS - 1).astype(np.intp))]
    return replace(model, table=table, green=model.green * tint, white=model.white * tint, signal=model.signal / tint)


@njit(cache=True, error_model="numpy")
def _carpet_shares(image: ImageArray, pixels: IntArray, least: float, median: FloatArray) -> int:
    """Medians of the shares of B, G, R in those of pixels (N, 2) in which G's exceeds a third by more than the least,
    into median (3,); how many these are.
    """
    shares, count = np.empty((3, len(pixels))), 0
    for i in range(len(pixels)):
        v, u = pixels[i, 0], pixels[i, 1]
        b, g, r = np.float64(image[v, u, 0]), np.float64(image[v, u, 1]), np.float64(image[v, u, 2])
        total = max(b + g + r, 1.0)
        shares[0, count], shares[1, count], shares[2, count] = b / total, g / total, r / total
        if g / total - 1.0 / 3.0 > least:
            count += 1
    for k in range(3 if count else 0):
        median[k] = median_of(shares[k, :count])
    return count
