"""Whether a camera sees anything at all."""

from __future__ import annotations

import numpy as np

from touchline.types import ImageArray

LEAST_CONTRAST = 1.5  # grey levels between parts of the image: a covered one has 0.3, the dimmest usable one 3


def contrast(image: ImageArray) -> float:
    """Standard deviation (grey levels) of the mean brightness of 10 x 10 parts of an image (H, W, 3)."""
    lines, width = image[::4], image.shape[1]
    rows, columns = max(len(lines) // 10, 1), max(-(-width // 4) // 10, 1)
    # whole rows in whole numbers first: a mean over three axes takes four times longer
    sums = lines[: len(lines) // rows * rows].reshape(-1, rows, 3 * width).sum(axis=1, dtype=np.uint32)
    thin = sums.reshape(len(sums), width, 3)[:, ::4]
    parts = thin[:, : thin.shape[1] // columns * columns].reshape(len(sums), -1, 3 * columns).sum(axis=2)
    return float((parts / (3 * rows * columns)).std())


def is_covered(image: ImageArray) -> bool:
    """Whether an image (H, W, 3) shows nothing but noise, as under a covered lens; a dim hall has contrast."""
    return contrast(image) < LEAST_CONTRAST
