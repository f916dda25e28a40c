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
        tint = np.empty(3)
        changed, is_learned = _compared(np.ascontiguousarray(image), pixels, green, self._warmth, self.value, tint)
        if is_learned and self.value is not NO_TINT:
            self.value = NO_TINT
            return True
        if changed:
            self.value = tint
        return changed


def tinted_model(model: ColourModel, tint: FloatArray) -> ColourModel:
    """A model in a light that multiplies B, G, R by a tint (3,)."""
    middles = (np.arange(CELLS) + 0.5) / tint[:, np.newaxis]
    table = model.table[np.ix_(*np.minimum(middles, CELLS - 1).astype(np.intp))]
    return replace(tinted_colours(model, tint), table=table)


def tinted_colours(model: ColourModel, tint: FloatArray) -> ColourModel:
    """The same without its table, which stays that of the learned light."""
    return replace(model, green=model.green * tint, white=model.white * tint, signal=model.signal / tint)


@njit(cache=True, error_model="numpy")
def _compared(image, pixels, green, warmth, before, tint):  # type: ignore[no-untyped-def]
    """Tint (3,) of the light of an image (H, W, 3) by the green (3,) in its pixels (N, 2): whether it is another one
    than before (3,), and whether it is none at all. Both are false where too few pixels show carpet.
    """
    total, change, medians, changed, is_learned = green[0] + green[1] + green[2], np.zeros(3), np.empty(3), False, True
    wanted, least = range(0, 3, 2 if warmth else 1), _GREENISH * (green[1] / total - 1.0 / 3.0)
    if _carpet_shares(image, pixels, least, wanted, medians) < _MIN_PIXELS:
        return False, False
    for k in wanted:
        change[k] = math.log(max(medians[k], 1e-3) / max(green[k] / total, 1e-6))
    if warmth:
        change[0] = 0.5 * (change[0] - change[2])
        change[2] = -change[0]
    for k in range(3):
        tint[k] = math.exp(min(max(change[k], -_MAX_TINT), _MAX_TINT))
        changed = changed or abs(math.log(tint[k] / before[k])) > _MIN_TINT
        is_learned = is_learned and abs(math.log(tint[k])) < 0.5 * _MIN_TINT
    return changed, is_learned


@njit(cache=True, error_model="numpy")
def _carpet_shares(image, pixels, least, wanted, median):  # type: ignore[no-untyped-def]
    """Medians of the shares of those wanted of B, G, R in those of pixels (N, 2) in which G's exceeds a third by more
    than the least, into median (3,); how many these are.
    """
    shares, count = np.empty((3, len(pixels))), 0
    for i in range(len(pixels)):
        v, u = np.uint64(pixels[i, 0]), np.uint64(pixels[i, 1])  # unsigned: none can count from the end
        b, g, r = np.float64(image[v, u, 0]), np.float64(image[v, u, 1]), np.float64(image[v, u, 2])
        if max(b, g, r) > _CLIPPED:
            continue
        total = max(b + g + r, 1.0)
        shares[0, count], shares[1, count], shares[2, count] = b / total, g / total, r / total
        if g / total - 1.0 / 3.0 > least:
            count += 1
    for k in wanted if count else range(0):
        median[k] = median_of(shares[k, :count])
    return count
