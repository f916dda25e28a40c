"""Colours learned from marked regions: the marks decide where they lie, between them the rules for green and white."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from touchline.errors import InputError
from touchline.geometry import BoolArray, ByteArray, Float32Array, FloatArray
from touchline.perception.colour import (
    GREEN,
    OTHER,
    WHITE,
    Carpet,
    ColourModel,
    chromaticity,
    colour_model,
    pixel_noise,
)
from touchline.perception.colour_ellipses import (
    COLOURED,
    FIXED,
    USUAL_BLACK,
    Ellipses,
    learned_black,
    learned_ellipse,
    luma_chroma,
    tinted_chroma,
)
from touchline.types import ImageArray

CLASSES = ("green", "white", "black", *COLOURED)
MIN_PIXELS = 30
_CODES = {"green": GREEN, "white": WHITE}
_CELLS = 64


@dataclass(frozen=True, eq=False, slots=True)
class Region:
    """A marked polygon (N, 2) u, v in one image, and the class of everything in it."""

    file: str
    kind: str
    polygon: FloatArray

    def mask(self, shape: tuple[int, int]) -> BoolArray:
        """(H, W) pixels inside."""
        inside = np.zeros(shape, dtype=np.uint8)
        cv2.fillPoly(inside, [np.rint(self.polygon).astype(np.int32)], 1)
        return inside.astype(np.bool_)


def marked_colour_model(images: Mapping[str, ImageArray], regions: Sequence[Region]) -> ColourModel:
    """Learn from regions of images (H, W, 3), B, G, R, by file name.

    The carpet is what is marked green, the paint what is marked white (guessed without); marked colours override the
    rules in the cells of the table where they lie, and set the ellipses of their classes. Raises InputError without
    enough green.
    """
    pixels = {kind: _pixels_of(images, regions, kind) for kind in CLASSES}
    green = pixels["green"]
    if len(green) < MIN_PIXELS:
        raise InputError(f"colours: {len(green)} pixels are marked green, at least {MIN_PIXELS} are needed")
    shares = chromaticity(green)
    spread = np.cov(shares.T) + np.eye(2) * 0.004**2
    noise = _noise(images, regions)
    carpet = Carpet(green, np.median(green, axis=0), shares.mean(axis=0), spread, noise)
    white = np.median(pixels["white"], axis=0) if len(pixels["white"]) >= MIN_PIXELS else None
    if white is not None and float(white.sum()) <= 1.1 * float(carpet.green.sum()):
        raise InputError(
            "colours: what is marked white is hardly brighter than what is marked green; are they swapped?"
        )
    model = colour_model(carpet, white)
    black = USUAL_BLACK
    if len(pixels["black"]) >= MIN_PIXELS:
        luma, _, _ = luma_chroma(np.vstack((model.green, pixels["black"])))
        black = learned_black(luma[1:], float(luma[0]))
    return replace(model, table=_with_votes(model.table, pixels), ellipses=_ellipses(pixels, model), black=black)


def _ellipses(pixels: Mapping[str, FloatArray], model: ColourModel) -> Ellipses:
    """Those of the marked classes from their marks alone, fixed ones for all others."""
    return tuple(
        learned_ellipse(tinted_chroma(pixels[name], model.white), fixed, 0.0)
        if len(pixels[name]) >= MIN_PIXELS
        else fixed
        for name, fixed in zip(COLOURED, FIXED, strict=True)
    )


def _pixels_of(images: Mapping[str, ImageArray], regions: Sequence[Region], kind: str) -> FloatArray:
    chosen = [images[r.file][r.mask(images[r.file].shape[:2])] for r in regions if r.kind == kind]
    return np.concatenate(chosen).astype(np.float64) if chosen else np.zeros((0, 3))


def _noise(images: Mapping[str, ImageArray], regions: Sequence[Region]) -> float:
    levels = []
    for region in regions:
        if region.kind == "green":
            image = images[region.file]
            levels.append(pixel_noise([image], region.mask(image.shape[:2])))
    return float(np.median(levels))


def _with_votes(table: ByteArray, pixels: Mapping[str, FloatArray]) -> ByteArray:
    """The table with marked pixels' classes in the cells where they lie, spread to the cells beside."""
    votes = np.zeros((3, _CELLS, _CELLS, _CELLS), dtype=np.float32)
    for kind, colours in pixels.items():
        cells = colours.astype(np.int64) >> 2
        np.add.at(votes[_CODES.get(kind, OTHER)], tuple(cells.T), 1.0 / max(len(colours), 1))
    spread = np.stack([_spread(volume) for volume in votes])
    decided = spread.max(axis=0) > 0.0
    return np.where(decided, spread.argmax(axis=0), table).astype(np.uint8)


def _spread(volume: Float32Array) -> Float32Array:
    """Sums over 3 x 3 x 3 cells."""
    padded = np.pad(volume, 1)
    n = _CELLS
    total = np.zeros_like(volume)
    for i in range(3):
        for j in range(3):
            for k in range(3):
                total += padded[i : i + n, j : j + n, k : k + n]
    return total
