"""White against the carpet on both sides: what is brighter and less coloured than both, at a line's width from it.

Where shaded paint has the colour of carpet in the sun, no table of colours tells them apart, but their neighbours do:
shade multiplies both, and logarithms of their colours still differ by the same. The edge of a shadow has one such side.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numba import njit

from touchline.geometry import BoolArray, Float32Array, FloatArray, IntArray
from touchline.perception.colour import GREEN, ColourModel, channel_sums
from touchline.types import ImageArray

BLOCK_PX = 2  # turf glitters: means of so many pixels each way are compared
_THICK = 2  # blocks to the sides of a line that is wide enough for the mean of 3 x 3 of them
_DARK = 2.0  # so many times as much brighter than a floor that is no carpet, on one side
_GREY = 0.3  # of the carpet's colour on the other side, at most, has such a floor: the carpet's shadow has nearly all
_COLOUR = 2.0  # as much weighs a change of colour against one of brightness: paint then changes both alike
_TEXTURE, _ABOVE = 0.99, 1.5  # quantile of what is as much darker and more coloured, and times it is no texture
_MIN_CONTRAST = 0.02  # of the logarithm: carpet without any texture is drawn
_MIN_BLOCKS, _OFTEN = 30, 2.0  # that paint is learned from, and times as often as the opposite: else it is texture
_AROUND = 31  # blocks each way that tell the carpet beside paint
_FAINT, _GROWN = 0.4, 8  # of the contrast of paint is enough beside it; so many times it grows
_NEXT = np.ones((3, 5), np.uint8)  # blocks beside: distant lines run across the image


class Contrast(NamedTuple):
    """least: contrast from which on a block is white. paint: (3,) B, G, R of paint in the light that was learned.
    unseen: ratio of such blocks, of the half that contrasts most, that a table of colours calls green.
    """

    least: float
    paint: FloatArray
    unseen: float


def mean_blocks(image: ImageArray) -> Float32Array:
    """(R, C, 3) means of blocks of an image (H, W, 3); what is left over at its right and lower edge is left out."""
    rows, columns = image.shape[0] // BLOCK_PX, image.shape[1] // BLOCK_PX
    whole = image[: BLOCK_PX * rows, : BLOCK_PX * columns]
    blocks: Float32Array = cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA).astype(np.float32)
    return blocks


def contrasts(blocks: Float32Array, reach: IntArray, dark: float = math.inf) -> Float32Array:
    """(R, C) by how much each of blocks (R, C, 3) is brighter and less coloured than both its sides; 0 for no more.

    reach: (R, 2) how far, in blocks across and along the image, its sides are in each row; 0: it sees no ground. dark:
    a block that is brighter than one side by so many times as much need not be less coloured than that, where that has
    hardly a colour against the other side.
    """
    found: Float32Array = np.zeros(blocks.shape[:2], dtype=np.float32)
    _exceed(*_looks(blocks, reach), reach, dark, found)
    return found


def _looks(blocks: Float32Array, reach: IntArray) -> tuple[Float32Array, Float32Array]:
    """Brightness and paleness of blocks (R, C, 3), each (R, C, 2), of a block and about it."""
    blue, green, red = cv2.split(cv2.log(blocks + 1.0))
    other = 0.5 * (blue + red)
    own = np.dstack(((2.0 * other + green) / 3.0, _COLOUR * (other - green)))
    beside: Float32Array = cv2.blur(own, (3, 3)).astype(np.float32)
    thick = reach.min(axis=1) > _THICK
    return np.where(thick[:, np.newaxis, np.newaxis], beside, own), beside


def _both_signs(own: Float32Array, beside: Float32Array, reach: IntArray) -> Float32Array:
    """(2, R, C) `contrasts`, and by how much blocks are darker and more coloured than both sides."""
    found: Float32Array = np.zeros((2, *own.shape[:2]), dtype=np.float32)
    planes = [np.ascontiguousarray(np.moveaxis(each, -1, 0)) for each in (own, beside)]
    _exceed_or_fall(planes[0], planes[1], reach, found)
    return found


@njit(cache=True)
def _exceed_or_fall(own: Float32Array, beside: Float32Array, reach: IntArray, found: Float32Array) -> None:
    """By how much blocks exceed both sides, and fall below them, in the direction of four in which they do most, into
    found (2, R, C). own, beside: (2, R, C) brightness and paleness.
    """
    rows, columns = found.shape[1:]
    for row in range(rows):
        across, along = reach[row]
        for way in range(4 if along > 0 else 0):
            dv, du = (0 if way == 0 else along), (0 if way == 1 else across if way < 3 else -across)
            if not dv <= row < rows - dv:
                continue
            first, last = abs(du), columns - abs(du)
            here = own[:, row, first:last]
            one = beside[:, row - dv, first - du : last - du]
            other = beside[:, row + dv, first + du : last + du]
            most = found[:, row, first:last]
            for i in range(most.shape[1]):
                bright, pale = here[0, i] - one[0, i], here[1, i] - one[1, i]
                brighter, paler = here[0, i] - other[0, i], here[1, i] - other[1, i]
                most[0, i] = max(most[0, i], min(min(bright, pale), min(brighter, paler)))
                most[1, i] = max(most[1, i], -max(max(bright, pale), max(brighter, paler)))


@njit(cache=True)
def _exceed(own: Float32Array, beside: Float32Array, reach: IntArray, dark: float, found: Float32Array) -> None:
    """By how much blocks exceed both sides in the direction of four in which they do most, into found (R, C).

    own, beside: (R, C, 2) brightness and paleness, of a block and about it.
    """
    rows, columns = found.shape
    for row in range(rows):
        across, along = reach[row]
        for way in range(4 if along > 0 else 0):
            dv, du = (0 if way == 0 else along), (0 if way == 1 else across if way < 3 else -across)
            for column in range(abs(du), columns - abs(du) if dv <= row < rows - dv else 0):
                one, other = beside[row - dv, column - du], beside[row + dv, column + du]
                bright, pale = own[row, column, 0] - one[0], own[row, column, 1] - one[1]
                brighter, paler = own[row, column, 0] - other[0], own[row, column, 1] - other[1]
                first, second = min(bright, pale), min(brighter, paler)
                exceeds = min(first, second)
                if other[1] >= _GREY * one[1]:
                    exceeds = max(exceeds, min(first, brighter / dark))
                if one[1] >= _GREY * other[1]:
                    exceeds = max(exceeds, min(second, bright / dark))
                found[row, column] = max(found[row, column], exceeds)


def white_blocks(blocks: Float32Array, reach: IntArray, least: float) -> BoolArray:
    """(R, C) which of blocks (R, C, 3) are white: what contrasts enough, and what is faint beside it."""
    contrast = contrasts(blocks, reach, dark=_DARK)
    white, faint = contrast > least, contrast > _FAINT * least
    for _ in range(_GROWN):
        white = faint & (cv2.dilate(white.astype(np.uint8), _NEXT) > 0)
    return white


def learn_contrast(
    images: Sequence[ImageArray], around: BoolArray, reach: IntArray, model: ColourModel
) -> Contrast | None:
    """What paint is like against the carpet beside it; None where too little is seen.

    around: (H, W) ground that is looked at. The carpet's own texture is as often darker and more coloured than both
    sides as it is brighter and less coloured: paint has to exceed that.
    """
    ground = cv2.resize(around.astype(np.uint8), None, fx=1.0 / BLOCK_PX, fy=1.0 / BLOCK_PX) > 0
    ground = ground[: len(reach), : around.shape[1] // BLOCK_PX]
    blocks = [mean_blocks(image) for image in images]
    looks = [_looks(each, reach) for each in blocks]
    both = [_both_signs(*look, reach) for look in looks]
    texture = np.concatenate([below[ground] for _, below in both])
    least = max(_ABOVE * float(np.quantile(texture, _TEXTURE)) if len(texture) else 0.0, _MIN_CONTRAST)
    rows, box = [], (_AROUND, _AROUND)
    for each, (contrast, _) in zip(blocks, both, strict=True):
        bare, paint = (contrast < _FAINT * least) & ground, (contrast > least) & ground
        number = cv2.blur(bare.astype(np.float32), box)[paint]
        carpet = cv2.blur(each * bare[..., np.newaxis], box)[paint] / np.maximum(number, 1e-3)[:, np.newaxis]
        is_green = model.classify(each[paint][np.newaxis].astype(np.uint8))[0] == GREEN
        light = np.maximum(channel_sums(carpet), 1.0) / model.green.sum()
        rows.append(np.column_stack((contrast[paint], is_green, (each[paint] - carpet) / light[:, np.newaxis])))
    table = np.concatenate(rows).astype(np.float64)
    if len(table) < max(_MIN_BLOCKS, _OFTEN * np.count_nonzero(texture > least)):
        return None
    strong = table[:, 0] >= np.median(table[:, 0])
    return Contrast(least, model.green + np.median(table[strong, 2:], axis=0), float(table[strong, 1].mean()))
