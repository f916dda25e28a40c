"""Thresholds on hue, saturation, value and lightness: set by hand, or taken from the image's own histograms."""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from pydantic import Field

from touchline.config import Settings
from touchline.geometry import BoolArray, ByteArray
from touchline.perception.colour import NoCarpetError
from touchline.types import ImageArray

_HUE_BINS = 180  # OpenCV counts hue in steps of 2° and the rest in 256 levels
_GREENISH_DEG = (70.0, 190.0)  # from yellowish to bluish green: where a carpet's hue is looked for at all
_VIVID = 0.15  # saturation from which on a hue is surely no chance
_FAINT = 0.06  # saturation of the greyest carpet: one real one has 0.07 to 0.2, the light's own cast is less
_MORE = 4.0  # by so much pixels of a faint green must outnumber the vivid ones to be the carpet
_FAINT_SHARE = 0.2  # of faintly green pixels about the robot: noise makes some of every grey
_DARKEST = 20  # value, of 255: below, hue is noise
_MIN_SHARE = 0.05  # of greenish pixels about the robot: less, and no carpet is seen


# greatest HSL saturation of white: paint has less than 0.4, blurred with carpet too; carpet in the sun has 0.7 and
# more, 1 where it is overexposed
MAX_WHITE_SATURATION = 0.5
SURELY_LIGHTNESS = 0.9  # HSL lightness from which on its saturation doesn't count: near white it is noise
HUE_SIGMAS = 4.0  # half width of green's hue in its standard deviations
MIN_HUE_WIDTH_DEG = 24.0  # least half width of green's hue (degrees): chroma is stored at half the resolution
SATURATION_RATIO = 0.55  # least saturation of green, as a share of the carpet's: half way to paint
VALUE_RATIO = 0.25  # least value of green, as a share of the carpet's: a deep shadow has a third
# quantile of the carpet's lightness that counts for white: below the middle, because paint in shade is no lighter than
# carpet in the sun, which its saturation gives away
CARPET_QUANTILE = 0.4


class FixedThresholds(Settings):
    """Thresholds set by hand for one lighting, as the paper does; the values suit the recordings under lamps."""

    hue_low_deg: float = Field(90.0, ge=0, le=360, description="least hue of green (degrees)")
    hue_high_deg: float = Field(170.0, ge=0, le=360, description="greatest hue of green (degrees)")
    min_saturation: float = Field(0.25, ge=0, le=1, description="least HSV saturation of green: a carpet has 0.45")
    min_value: float = Field(0.12, ge=0, le=1, description="least HSV value of green: a carpet under lamps has 0.5")
    min_lightness: float = Field(
        0.58, ge=0, le=1, description="least HSL lightness of white: half way from carpet to paint under lamps"
    )


class AutomaticThresholds(Settings):
    """What the thresholds taken from an image are, relative to its carpet."""

    lightness_ratio: float = Field(
        1.45,
        gt=1,
        description="least lightness of white over the carpet's: paint has 2.2 times that of carpet; far lines lose "
        "half of it to blur",
    )


@dataclass(frozen=True, slots=True)
class Thresholds:
    """In OpenCV's units: hue in steps of 2°, the rest of 255. The last one is white's, the others are green's."""

    hue: tuple[int, int]
    min_saturation: int
    min_value: int
    min_lightness: int

    def green(self, hsv: ImageArray) -> ByteArray:
        """(H, W) 255 where an HSV image (H, W, 3) is green."""
        low, high = self.hue
        lower, upper = (low, self.min_saturation, self.min_value), (high, 255, 255)
        return np.asarray(cv2.inRange(hsv, lower, upper), dtype=np.uint8)

    def white(self, hls: ImageArray) -> ByteArray:
        """(H, W) 255 where an HLS image (H, W, 3) is white."""
        pale, surely = round(255 * MAX_WHITE_SATURATION), round(255 * SURELY_LIGHTNESS)
        light = cv2.inRange(hls, (0, self.min_lightness, 0), (180, 255, pale))
        return np.asarray(cv2.bitwise_or(light, cv2.inRange(hls, (0, surely, 0), (180, 255, 255))), dtype=np.uint8)


def fixed_thresholds(settings: FixedThresholds) -> Thresholds:
    """The settings in OpenCV's units."""
    s = settings
    shares = (s.min_saturation, s.min_value, s.min_lightness)
    return Thresholds((round(s.hue_low_deg / 2), round(s.hue_high_deg / 2)), *(round(255 * share) for share in shares))


class _Green(NamedTuple):
    """The most frequent greenish hue (of OpenCV's 180), and pixels (N,) near it, and of any greenish hue."""

    mode: int
    carpet: BoolArray
    greenish: BoolArray


def _most_frequent_green(hue: ImageArray, saturation: ImageArray, value: ImageArray, least_saturation: float) -> _Green:
    """Among pixels (N,) that have at least such a saturation."""
    low, high = (round(deg / 2) for deg in _GREENISH_DEG)
    greenish = (hue >= low) & (hue <= high) & (saturation > 255 * least_saturation) & (value > _DARKEST)
    counts = np.convolve(np.bincount(hue[greenish], minlength=_HUE_BINS), np.ones(5), mode="same")
    mode = int(np.argmax(counts))
    near = np.abs(hue.astype(np.int16) - mode) <= MIN_HUE_WIDTH_DEG / 2
    return _Green(mode, greenish & near, greenish)


def automatic_thresholds(hsv: ImageArray, lightness: ByteArray, settings: AutomaticThresholds) -> Thresholds:
    """From pixels (N, 3) and (N,) about the robot: green is their most frequent greenish hue, white is far lighter.

    Raises NoCarpetError if too few of them are greenish.
    """
    s = settings
    hue, saturation, value = hsv.T
    vivid, faint = (_most_frequent_green(hue, saturation, value, least) for least in (_VIVID, _FAINT))
    enough = np.count_nonzero(vivid.greenish) >= _MIN_SHARE * max(len(hue), 1)
    counts = [np.count_nonzero(found.carpet) for found in (vivid, faint)]
    if (not enough or counts[1] > _MORE * counts[0]) and counts[1] >= _FAINT_SHARE * max(len(hue), 1):
        mode, carpet, _ = faint
    elif enough:
        mode, carpet, _ = vivid
    else:
        raise NoCarpetError("no green carpet found around the robot: is the camera covered, or its center wrong?")
    width = MIN_HUE_WIDTH_DEG / 2
    width = max(width, HUE_SIGMAS * float(np.std(hue[carpet])))
    usual = float(np.quantile(lightness[carpet], CARPET_QUANTILE))
    return Thresholds(
        (max(round(mode - width), 0), min(round(mode + width), _HUE_BINS)),
        round(SATURATION_RATIO * float(np.median(saturation[carpet]))),
        round(VALUE_RATIO * float(np.median(value[carpet]))),
        round(min(s.lightness_ratio * usual, 0.5 * (usual + 255.0))),
    )
