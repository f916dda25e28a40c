"""The tint of the light, by the carpet: clouds pass, lamps go on, and what was learned is multiplied by it."""

import math
from dataclasses import replace

import numpy as np
from numba import njit

from touchline.geometry import FloatArray, IntArray
from touchline.perception.colour import CELLS, ColourModel
from touchline.perception.sorting import median_of
from touchline.types import ImageArray

NO_TINT = np.ones(3)
_MIN_TINT, _MAX_TINT = 0.04, 0.4  # change of the carpet's colour (logarithm) that is followed, and the most
_MIN_PIXELS = 50  # of carpet, that tell it
_CLIPPED = 245.0  # of a channel, from which on it may be brighter than it shows: carpet in the sun is pale, not tinted
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
        usual = (green / green.sum()).tolist()
        shares, least = np.empty(3), _GREENISH * (usual[1] - 1.0 / 3.0)
        if _carpet_shares(np.ascontiguousarray(image), pixels, least, shares) < _MIN_PIXELS:
            return False
        change = [
            math.log(max(share, 1e-3) / max(own, 1e-6)) for share, own in zip(shares.tolist(), usual, strict=True)
        ]
        if self._warmth:
            warmth = 0.5 * (change[0] - change[2])
            change = [warmth, 0.0, -warmth]
        tint = [math.exp(min(max(each, -_MAX_TINT), _MAX_TINT)) for each in change]
        changed = any(abs(math.log(new / old)) > _MIN_TINT for new, old in zip(tint, self.value.tolist(), strict=True))
        as_learned = self.value is not NO_TINT and all(abs(math.log(each)) < 0.5 * _MIN_TINT for each in tint)
        if changed or as_learned:
            self.value = NO_TINT if as_learned else np.array(tint)
        return changed or as_learned


def tinted_model(model: ColourModel, tint: FloatArray) -> ColourModel:
    """A model in a light that multiplies B, G, R by a tint (3,)."""
    middles = (np.arange(CELLS) + 0.5) / tint[:, np.newaxis]
    table = model.table[np.ix_(*np.minimum(middles, CELLS - 1).astype(np.intp))]
    return replace(tinted_colours(model, tint), table=table)


def tinted_colours(model: ColourModel, tint: FloatArray) -> ColourModel:
    """The same without its table, which stays that of the learned light."""
    return replace(model, green=model.green * tint, white=model.white * tint, signal=model.signal / tint)


@njit(cache=True, error_model="numpy")
def _carpet_shares(image: ImageArray, pixels: IntArray, least: float, median: FloatArray) -> int:
    """Medians of the shares of B, G, R in those of pixels (N, 2) in which G's exceeds a third by more than the least,
    into median (3,); how many these are.
    """
    shares, count = np.empty((3, len(pixels))), 0
    for i in range(len(pixels)):
        v, u = pixels[i, 0], pixels[i, 1]
        b, g, r = np.float64(image[v, u, 0]), np.float64(image[v, u, 1]), np.float64(image[v, u, 2])
        if max(b, g, r) > _CLIPPED:
            continue
        total = max(b + g + r, 1.0)
        shares[0, count], shares[1, count], shares[2, count] = b / total, g / total, r / total
        if g / total - 1.0 / 3.0 > least:
            count += 1
    for k in range(3 if count else 0):
        median[k] = median_of(shares[k, :count])
    return count
