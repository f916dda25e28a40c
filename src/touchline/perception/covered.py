"""Whether a camera sees anything at all."""

import numpy as np
from numba import njit

from touchline.types import ImageArray

MIN_CONTRAST = 1.5  # grey levels between parts of the image: a covered one has 0.3, the dimmest usable one 3


def contrast(image: ImageArray) -> float:
    """Standard deviation (grey levels) of the mean brightness of 10 x 10 parts of an image (H, W, 3)."""
    return float(np.sqrt(_variance(np.ascontiguousarray(image), np.inf)))


def is_covered(image: ImageArray) -> bool:
    """Whether an image (H, W, 3) shows nothing but noise, as under a covered lens; a dim hall has contrast."""
    enough = MIN_CONTRAST**2
    return bool(_variance(np.ascontiguousarray(image), enough) < enough)


@njit(cache=True)
def _variance(image, enough):  # type: ignore[no-untyped-def]
    """Variance of the mean brightness of 10 x 10 parts, each of every fourth pixel of every fourth row.

    As soon as the parts so far differ by so much that it will be `enough`, what is sure by then.
    """
    height, width = (image.shape[0] + 3) // 4, (image.shape[1] + 3) // 4
    rows, columns = max(height // 10, 1), max(width // 10, 1)
    down, across = height // rows, width // columns
    total = squares = count = 0
    variance = 0.0
    for i in range(down):
        for j in range(across):
            light = 0
            for v in range(4 * rows * i, 4 * rows * (i + 1), 4):
                for u in range(4 * columns * j, 4 * columns * (j + 1), 4):
                    light += np.int64(image[v, u, 0]) + image[v, u, 1] + image[v, u, 2]
            total += light
            squares += light * light
            count += 1
        variance = (squares - total * total / count) / (down * across * (3.0 * rows * columns) ** 2)
        if variance >= enough:
            break
    return variance
