"""What an image shows along the scan lines: colours between its pixels, how white each is, and its colour class."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.geometry import BoolArray, ByteArray, Float32Array
from touchline.perception.scan_lines import ScanLines
from touchline.types import ImageArray

BODY = 3  # a fourth class of samples: the robot itself
LEVEL = 3  # row of the values
CACHE_LINE = 64  # bytes
CHUNK = 2048  # samples that are worked on together: few enough to stay in the first-level cache


class PathSamples(NamedTuple):
    """What an image shows at the N samples of ScanLines.

    values: (4, N), B, G, R and the level: the colours' signal, higher by 1 on paint than on carpet. classes: (N,).
    pixels: (4, CHUNK), what the kernels work with: the upper two and the lower two pixels about some of the samples,
    four bytes of the image each.
    """

    values: Float32Array
    classes: ByteArray
    pixels: npt.NDArray[np.uint32]


def no_samples(count: int) -> PathSamples:
    """Room for `count` samples."""
    return PathSamples(np.zeros((4, count), np.float32), np.zeros(count, np.uint8), np.zeros((4, CHUNK), np.uint32))


def sample_paths(
    image: ImageArray,
    lines: ScanLines,
    masked: BoolArray,
    signal: Float32Array,
    table: ByteArray,
    samples: PathSamples,
) -> None:
    """Look up the N samples of scan lines in an image (H, W, 3), contiguous.

    Fills `samples`: colours bilinear, levels by `signal` (3,), classes by the table (64, 64, 64), or BODY where masked
    (N,) says that it is the robot itself.
    """
    # from every byte on: a pixel and the blue of the next one
    words = np.ndarray((image.size - 3,), np.uint32, image, 0, (1,))
    _fill(words, 3 * image.shape[1], (lines.corners, lines.shares), masked, signal, table, samples)


@njit(cache=True)
def _fill(words, width, places, masked, signal, table, samples):  # type: ignore[no-untyped-def]
    """Fill the samples in loops that each do one simple thing, which the compiler makes SIMD instructions of."""
    values, classes, pixels = samples
    corners, shares = places
    cells = table.reshape(-1)
    beside, below = np.uint64(3), np.uint64(width)  # unsigned: none can count from the end
    fetched = _fetched(words)
    for first in range(0, len(corners), CHUNK):
        last = min(first + CHUNK, len(corners))
        upper_left, upper_right = pixels[0, : last - first], pixels[1, : last - first]
        lower_left, lower_right = pixels[2, : last - first], pixels[3, : last - first]
        for k in range(last - first):
            here = np.uint64(corners[first + k])
            upper_left[k], upper_right[k] = words[here], words[here + beside]
            lower_left[k], lower_right[k] = words[here + below], words[here + below + beside]
        about = (upper_left, upper_right, lower_left, lower_right)
        for channel in range(3):
            _blend(about, shares[0, first:last], shares[1, first:last], 8 * channel, values[channel, first:last])
        blue, green, red = values[0, first:last], values[1, first:last], values[2, first:last]
        _weigh(blue, green, red, signal, values[LEVEL, first:last])
        _cells(blue, green, red, upper_left)
        for k in range(last - first):
            classes[first + k] = BODY if masked[first + k] else cells[np.uint64(upper_left[k])]
    return fetched  # or the compiler would leave it out


@njit(cache=True)
def _fetched(words):  # type: ignore[no-untyped-def]
    """The sum of one byte of each line of the cache: read in order, an image comes from memory twice as fast."""
    total = np.uint32(0)
    for k in range(0, len(words), CACHE_LINE):
        total += words[k]
    return total


@njit(cache=True)
def _blend(about, right, down, shift, out):  # type: ignore[no-untyped-def]
    """One channel, bilinear: the eight bits from `shift` on of the four pixels about each sample.

    right, down: how far the sample is on its way to the next pixel.
    """
    one, byte, bits = np.float32(1.0), np.uint32(255), np.uint32(shift)
    p00, p01, p10, p11 = about
    for k in range(len(out)):
        w11 = right[k] * down[k]
        w01, w10 = right[k] - w11, down[k] - w11
        upper = (one - right[k] - w10) * np.float32(p00[k] >> bits & byte) + w01 * np.float32(p01[k] >> bits & byte)
        out[k] = upper + w10 * np.float32(p10[k] >> bits & byte) + w11 * np.float32(p11[k] >> bits & byte)


@njit(cache=True)
def _weigh(blue, green, red, weights, out):  # type: ignore[no-untyped-def]
    b, g, r = weights[0], weights[1], weights[2]
    for k in range(len(out)):
        out[k] = b * blue[k] + g * green[k] + r * red[k]


@njit(cache=True)
def _cells(blue, green, red, out):  # type: ignore[no-untyped-def]
    """Where the colours stand in a table of 64³ cells laid flat."""
    two, six, twelve = np.uint32(2), np.uint32(6), np.uint32(12)
    for k in range(len(out)):
        out[k] = np.uint32(blue[k]) >> two << twelve | np.uint32(green[k]) >> two << six | np.uint32(red[k]) >> two
