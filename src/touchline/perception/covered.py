"""Whether a camera sees anything at all."""

from __future__ import annotations

from touchline.types import ImageArray

LEAST_CONTRAST = 1.5  # grey levels between parts of the image: a covered one has 0.3, the dimmest usable one 3


def contrast(image: ImageArray) -> float:
    """Standard deviation (grey levels) of the mean brightness of 10 x 10 parts of an image (H, W, 3)."""
    thin = image[::4, ::4]
    rows, columns = (max(size // 10, 1) for size in thin.shape[:2])
    whole = thin[: rows * (thin.shape[0] // rows), : columns * (thin.shape[1] // columns)]
    parts = whole.reshape(whole.shape[0] // rows, rows, whole.shape[1] // columns, columns, -1)
    return float(parts.mean(axis=(1, 3, 4)).std())


def is_covered(image: ImageArray) -> bool:
    """Whether an image (H, W, 3) shows nothing but noise, as under a covered lens; a dim hall has contrast."""
    return contrast(image) < LEAST_CONTRAST
