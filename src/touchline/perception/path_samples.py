"""What an image shows along the scan lines: colours between its pixels, how white each is, and its colour class."""

from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.geometry import ByteArray, Float32Array, IndexArray, Int32Array
from touchline.perception.colour import GREEN
from touchline.perception.scan_lines import ScanLines
from touchline.types import ImageArray

BODY = 3  # a fourth class of samples: the robot itself
LEVEL = 3  # row of the values
CACHE_LINE = 64  # bytes
_NEXT = np.uint64(24)  # bits from a pixel to the next one
CHUNK = 2048  # samples that are worked on together: few enough to stay in the first-level cache


class PathSamples(NamedTuple):
    """What an image shows at the N samples of ScanLines.

    values: (4, N), B, G, R and the level: the colours' signal, higher by 1 on paint than on carpet. classes: (N,).
    pixels: (4, CHUNK), what the kernels work with: the pixels about some of the samples, left and right of the upper
    row, then of the lower; four bytes of the image each.
    """

    values: Float32Array
    classes: ByteArray
    pixels: Int32Array


def no_samples(count: int) -> PathSamples:
    """Room for `count` samples."""
    return PathSamples(np.zeros((4, count), np.float32), np.zeros(count, np.uint8), np.zeros((4, CHUNK), np.int32))


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
    greens, _ = _fill(words, 3 * image.shape[1], (lines.corners, lines.shares, lines.span), own, signal, table, samples)
    return int(greens)


@njit(cache=True)
def _fill(words, width, places, own, signal, table, samples):  # type: ignore[no-untyped-def]
    """Fill the samples in loops that each do one simple thing, which the compiler makes SIMD instructions of: of signed
    integers, as only these have them to and from floats.
    """
    values, classes, pixels = samples
    corners, shares, (begin, end) = places
    cells, below = table.reshape(-1), np.uint64(width)  # unsigned: none can count from the end
    fetched = _fetched(words[begin:end])
    for first in range(0, len(corners), CHUNK):
        last = min(first + CHUNK, len(corners))
        for k in range(last - first):
            here = np.uint64(corners[first + k])
            upper, lower = words[here], words[here + below]
            pixels[0, k], pixels[1, k] = np.int32(upper), np.int32(upper >> _NEXT)
            pixels[2, k], pixels[3, k] = np.int32(lower), np.int32(lower >> _NEXT)
        blue, green, red = values[0, first:last], values[1, first:last], values[2, first:last]
        colours = (blue, green, red, values[LEVEL, first:last])
        _blend(pixels, (shares[0, first:last], shares[1, first:last]), signal, colours)
        _cells(blue, green, red, pixels[0])
        for k in range(last - first):
            classes[first + k] = cells[pixels[0, k]]
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
def _blend(pixels, shares, signal, out):  # type: ignore[no-untyped-def]
    """B, G, R, bilinear, and the level from the pixels about each sample; all (M,).

    shares: how far the sample is on its way to the next pixel, to the right and down.
    """
    one, (right, down), (blue, green, red, level) = np.float32(1.0), shares, out
    by_blue, by_green, by_red = signal[0], signal[1], signal[2]
    for k in range(len(level)):
        w11 = right[k] * down[k]
        w01, w10 = right[k] - w11, down[k] - w11
        weights, about = (one - right[k] - w10, w01, w10, w11), (pixels[0, k], pixels[1, k], pixels[2, k], pixels[3, k])
        b, g, r = _channel(about, 0, weights), _channel(about, 8, weights), _channel(about, 16, weights)
        blue[k], green[k], red[k] = b, g, r
        level[k] = by_blue * b + by_green * g + by_red * r


@njit(cache=True, inline="always")
def _channel(about, shift, weights):  # type: ignore[no-untyped-def]
    """The weighted sum of the eight bits from `shift` on of four pixels."""
    (p00, p01, p10, p11), (w00, w01, w10, w11), low, byte = about, weights, np.int32(shift), np.int32(255)
    above = w00 * np.float32(p00 >> low & byte) + w01 * np.float32(p01 >> low & byte)
    return above + w10 * np.float32(p10 >> low & byte) + w11 * np.float32(p11 >> low & byte)


@njit(cache=True)
def _cells(blue, green, red, out):  # type: ignore[no-untyped-def]
    """Where the colours stand in a table of 64³ cells laid flat."""
    two, six, twelve = np.int32(2), np.int32(6), np.int32(12)
    for k in range(len(blue)):
        out[k] = np.int32(blue[k]) >> two << twelve | np.int32(green[k]) >> two << six | np.int32(red[k]) >> two
