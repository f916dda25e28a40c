"""What an image shows along the scan lines: colours between its pixels, how white each is, and its colour class."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.geometry import ByteArray, Float32Array, IndexArray
from touchline.perception.colour import GREEN
from touchline.perception.scan_lines import ScanLines
from touchline.types import ImageArray

BODY = 3  # a fourth class of samples: the robot itself
LEVEL = 3  # row of the values
CACHE_LINE = 64  # bytes
CHUNK = 2048  # samples that are worked on together: few enough to stay in the first-level cache


class PathSamples(NamedTuple):
    """What an image shows at the N samples of ScanLines.

    values: (4, N), B, G, R and the level: the colours' signal, higher by 1 on paint than on carpet. classes: (N,).
    pixels: (2, CHUNK), what the kernels work with: the upper two and the lower two pixels about some of the samples,
    eight bytes of the image each.
    """

    values: Float32Array
    classes: ByteArray
    pixels: npt.NDArray[np.uint64]


def no_samples(count: int) -> PathSamples:
    """Room for `count` samples."""
    return PathSamples(np.zeros((4, count), np.float32), np.zeros(count, np.uint8), np.zeros((2, CHUNK), np.uint64))


def sample_paths(
    image: ImageArray,
    lines: ScanLines,
    own: IndexArray,
    signal: Float32Array,
    table: ByteArray,
    samples: PathSamples,
) -> int:
    """Look up the N samples of scan lines in an image (H, W, 3), contiguous; returns how many are green.

    Fills `samples`: colours bilinear, levels by `signal` (3,), classes by the table (64, 64, 64), or BODY in the rows
    `own` (M,), which are the robot itself.
    """
    # from every byte on: a pixel and the next one
    words = np.ndarray((image.size - 7,), np.uint64, image, 0, (1,))
    greens, _ = _fill(words, 3 * image.shape[1], (lines.corners, lines.shares), own, signal, table, samples)
    return int(greens)


@njit(cache=True)
def _fill(words, width, places, own, signal, table, samples):  # type: ignore[no-untyped-def]
    """Fill the samples in loops that each do one simple thing, which the compiler makes SIMD instructions of."""
    values, classes, pixels = samples
    corners, shares = places
    cells, below = table.reshape(-1), np.uint64(width)  # unsigned: none can count from the end
    fetched = _fetched(words)
    for first in range(0, len(corners), CHUNK):
        last = min(first + CHUNK, len(corners))
        upper, lower = pixels[0, : last - first], pixels[1, : last - first]
        for k in range(last - first):
            here = np.uint64(corners[first + k])
            upper[k], lower[k] = words[here], words[here + below]
        blue, green, red = values[0, first:last], values[1, first:last], values[2, first:last]
        colours = (blue, green, red, values[LEVEL, first:last])
        _blend(upper, lower, (shares[0, first:last], shares[1, first:last]), signal, colours)
        _cells(blue, green, red, upper)
        for k in range(last - first):
            classes[first + k] = cells[upper[k]]
    for k in own:
        classes[k] = BODY
    greens = 0
    for k in range(len(classes)):
        greens += classes[k] == GREEN
    return greens, fetched  # or the compiler would leave it out


@njit(cache=True)
def _fetched(words):  # type: ignore[no-untyped-def]
    """The sum of one byte of each line of the cache: read in order, an image comes from memory twice as fast."""
    total = np.uint64(0)
    for k in range(0, len(words), CACHE_LINE):
        total += words[k]
    return total


@njit(cache=True)
def _blend(upper, lower, shares, signal, out):  # type: ignore[no-untyped-def]
    """B, G, R, bilinear, and the level from the pixels about each sample; all (M,).

    shares: how far the sample is on its way to the next pixel, to the right and down.
    """
    one, (right, down), (blue, green, red, level) = np.float32(1.0), shares, out
    by_blue, by_green, by_red = signal[0], signal[1], signal[2]
    for k in range(len(level)):
        w11 = right[k] * down[k]
        w01, w10 = right[k] - w11, down[k] - w11
        weights = one - right[k] - w10, w01, w10, w11
        b, g = _channel(upper[k], lower[k], 0, weights), _channel(upper[k], lower[k], 8, weights)
        r = _channel(upper[k], lower[k], 16, weights)
        blue[k], green[k], red[k] = b, g, r
        level[k] = by_blue * b + by_green * g + by_red * r


@njit(cache=True, inline="always")
def _channel(upper, lower, shift, weights):  # type: ignore[no-untyped-def]
    """The weighted sum of the eight bits from `shift` on of four pixels of 24 bits each, two above two."""
    here, beside, byte = np.uint64(shift), np.uint64(shift + 24), np.uint64(255)
    w00, w01, w10, w11 = weights
    above = w00 * np.float32(np.uint32(upper >> here & byte)) + w01 * np.float32(np.uint32(upper >> beside & byte))
    under = above + w10 * np.float32(np.uint32(lower >> here & byte))
    return under + w11 * np.float32(np.uint32(lower >> beside & byte))


@njit(cache=True)
def _cells(blue, green, red, out):  # type: ignore[no-untyped-def]
    """Where the colours stand in a table of 64³ cells laid flat."""
    two, six, twelve = np.uint32(2), np.uint32(6), np.uint32(12)
    for k in range(len(out)):
        out[k] = np.uint32(blue[k]) >> two << twelve | np.uint32(green[k]) >> two << six | np.uint32(red[k]) >> two
