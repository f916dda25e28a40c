"""The tint of the light, by the carpet: clouds pass, lamps go on, and what was learned is multiplied by it."""

from dataclasses import replace

import numpy as np

from touchline.geometry import FloatArray, IntArray
from touchline.perception.colour import CELLS, ColourModel, channel_sums
from touchline.types import ImageArray

NO_TINT = np.ones(3)
_MIN_TINT, _MAX_TINT = 0.04, 0.4  # change of the carpet's colour (logarithm) that is followed, and the most
_MIN_PIXELS = 50  # of carpet, that tell it
_GREENISH = 0.35  # of the learned carpet's excess of green, from which on a colour may be carpet in other light


class Tint:
    """`value` (3,): what multiplies B, G, R of the colours that were learned, brightness aside."""

    def __init__(self) -> None:
        self.value: FloatArray = NO_TINT

    def forget(self) -> None:
        """Colours are learned anew."""
        self.value = NO_TINT

    def follow(self, image: ImageArray, pixels: IntArray, green: FloatArray) -> bool:
        """Whether an image (H, W, 3) has another one. pixels (N, 2): v, u of those that see the ground; green (3,): of
        the learned carpet.
        """
        tint, count = _tint_of(image[pixels[:, 0], pixels[:, 1]].astype(np.float64), green)
        if count < _MIN_PIXELS:
            return False
        changed = bool(np.abs(np.log(tint / self.value)).max() > _MIN_TINT)
        self.value = tint if changed else self.value
        return changed


def tinted_model(model: ColourModel, tint: FloatArray) -> ColourModel:
    """A model in a light that multiplies B, G, R by a tint (3,)."""
    middles = (np.arange(CELLS) + 0.5) / tint[:, np.newaxis]
    table = model.table[np.ix_(*np.minimum(middles, CELLS - 1).astype(np.intp))]
    return replace(model, table=table, green=model.green * tint, white=model.white * tint, signal=model.signal / tint)


def _tint_of(colours: FloatArray, green: FloatArray) -> tuple[FloatArray, int]:
    """What multiplies B, G, R of the learned carpet (3,) in those of colours (N, 3) that may be it; how many are."""
    shares, usual = colours / np.maximum(channel_sums(colours), 1.0)[:, np.newaxis], green / green.sum()
    carpet = shares[shares[:, 1] - 1.0 / 3.0 > _GREENISH * (usual[1] - 1.0 / 3.0)]
    if not len(carpet):
        return NO_TINT, 0
    change = np.log(np.maximum(np.median(carpet, axis=0), 1e-3) / np.maximum(usual, 1e-6))
    return np.exp(np.clip(change, -_MAX_TINT, _MAX_TINT)), len(carpet)
