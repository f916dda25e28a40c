"""The picture of a colour table: an image, what the table makes of it, and the table itself in slices."""

from __future__ import annotations

import cv2
import numpy as np

from touchline.perception.colour import GREEN, OTHER, WHITE, ColourModel
from touchline.types import ImageArray

CLASS_COLORS = {OTHER: (60, 60, 60), GREEN: (70, 160, 60), WHITE: (245, 245, 245)}  # BGR
_SIDE = 640
_SLICES = 16


def colour_picture(colours: ColourModel, image: ImageArray) -> ImageArray:
    """(S + 40, 3 S, 3) BGR: the image (H, W, 3), its classes, and 16 slices of the table: blue down, red across."""
    palette = np.array([CLASS_COLORS[code] for code in (OTHER, GREEN, WHITE)], dtype=np.uint8)
    panels = {
        "image": _fitted(image, cv2.INTER_AREA),
        "classes: green, white, other": _fitted(palette[colours.classify(image)], cv2.INTER_NEAREST),
        "the table: G in 16 steps; in each B down, R across": _fitted(_slices(colours, palette), cv2.INTER_NEAREST),
    }
    return np.hstack([_titled(panel, title) for title, panel in panels.items()])


def _slices(colours: ColourModel, palette: ImageArray) -> ImageArray:
    """(4 · 66, 4 · 66, 3): every fourth plane of the table; what is no class shows its own colour, darker."""
    levels = (np.arange(64) * 4 + 2).astype(np.uint8)
    tiles = []
    for g in range(0, 64, 64 // _SLICES):
        classes = colours.table[:, g, :]
        blue, red = np.meshgrid(levels, levels, indexing="ij")
        own = np.stack((blue, np.full_like(blue, levels[g]), red), axis=-1)
        tile = np.where((classes == OTHER)[..., np.newaxis], own // 3, palette[classes])
        tiles.append(np.pad(tile, ((1, 1), (1, 1), (0, 0)), constant_values=120))
    rows = [np.hstack(tiles[k : k + 4]) for k in range(0, _SLICES, 4)]
    return np.vstack(rows).astype(np.uint8)


def _fitted(image: ImageArray, interpolation: int) -> ImageArray:
    scale = _SIDE / max(image.shape[:2])
    size = (round(image.shape[1] * scale), round(image.shape[0] * scale))
    return np.asarray(cv2.resize(image, size, interpolation=interpolation), dtype=np.uint8)


def _titled(panel: ImageArray, title: str) -> ImageArray:
    side: ImageArray = np.full((_SIDE + 40, _SIDE, 3), 24, dtype=np.uint8)
    side[40 : 40 + panel.shape[0], : panel.shape[1]] = panel
    cv2.putText(side, title, (12, 27), cv2.FONT_HERSHEY_SIMPLEX, 0.55, (235, 235, 235), 1, cv2.LINE_AA)
    return side
