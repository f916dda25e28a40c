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
CHUNK = 1024  # samples that are worked on together: few enough to stay in the first-level cache


class PathSamples(NamedTuple):
    """What an image shows at the N samples of ScanLines.

    values: (4, N), B, G, R and the level: the colours' signal, higher by 1 on paint than on carpet. classes: (N,).
    pixels: (CHUNK, 4), what the kernels work with: the pixels about some of the samples, eight bytes from the left one
    of the upper row on, then of the lower.
    """

    values: Float32Array
    classes: ByteArray
    pixels: Int32Array


def no_samples(count: int) -> PathSamples:
    """Room for `count` samples."""
    return PathSamples(np.zeros((4, count), np.float32), np.zeros(count, np.uint8), np.zeros((CHUNK, 4), np.int32))


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
    return int(_fill(words, 3 * image.shape[1], (lines.corners, lines.shares), own, signal, table, samples))


def fetch(image: ImageArray, lines: ScanLines) -> None:
    """Bring what `sample_paths` reads of an image (H, W, 3), contiguous, from memory into the processor's caches: in
    order that takes half as long.
    """
    _sum_of(image.reshape(-1), lines.touched)


@njit(cache=True)
def _sum_of(row, places):  # type: ignore[no-untyped-def]
    """The sum of the bytes of a row at some places: the compiler would leave out to read what nobody gets."""
    total = np.uint64(0)
    for at in places:
        total += row[np.uint64(at)]
    return total


@njit(cache=True)
def _fill(words, width, places, own, signal, table, samples):  # type: ignore[no-untyped-def]
    """Fill the samples in loops that each do one simple thing, which the compiler makes SIMD instructions of: of signed
    integers, as only these have them to and from floats.
    """
    values, classes, pixels = samples
    corners, shares = places
    cells, below = table.reshape(-1), np.uint64(width)  # unsigned: none can count from the end
    room = pixels.reshape(-1)
    pairs = room.view(np.uint64)
    for first in range(0, len(corners), CHUNK):
        last = min(first + CHUNK, len(corners))
        here, found = corners[first:last], classes[first:last]
        for k in range(len(here)):
            at = np.uint64(here[k])
            pairs[2 * k], pairs[2 * k + 1] = words[at], words[at + below]
        blue, green, red = values[0, first:last], values[1, first:last], values[2, first:last]
        colours = (blue, green, red, values[LEVEL, first:last])
        _blend(room, (shares[0, first:last], shares[1, first:last]), signal, colours)
        _cells(blue, green, red, room)
        for k in range(len(found)):
            found[k] = cells[np.uint64(room[k])]
    for k in own:
        classes[k] = BODY
    return _greens(classes)


@njit(cache=True)
def _greens(classes):  # type: ignore[no-untyped-def]
    """How many are green: counted in bytes as far as these go, 32 of which are one SIMD instruction's."""
    total = np.int64(0)
    for first in range(0, len(classes), 128):
        part, some = classes[first : first + 128], np.uint8(0)
        for k in range(len(part)):
            some = np.uint8(some + np.uint8(part[k] == GREEN))
        total += np.int64(some)
    return total


@njit(cache=True)
def _blend(pixels, shares, signal, out):  # type: ignore[no-untyped-def]
    """B, G, R, bilinear, and the level from the pixels about each sample, four numbers of each; all (M,).

    shares: how far the sample is on its way to the next pixel, to the right and down.
    """
    one, (right, down), (blue, green, red, level) = np.float32(1.0), shares, out
    by_blue, by_green, by_red = signal[0], signal[1], signal[2]
    for k in range(len(level)):
        w11 = right[k] * down[k]
        w01, w10 = right[k] - w11, down[k] - w11
        weights = one - right[k] - w10, w01, w10, w11
        upper, after, lower, beyond = pixels[4 * k], pixels[4 * k + 1], pixels[4 * k + 2], pixels[4 * k + 3]
        b = _channel((upper, upper, lower, lower), (0, 24), weights)  # of eight bytes: b g r b, g r and two more
        g = _channel((upper, after, lower, beyond), (8, 0), weights)
        r = _channel((upper, after, lower, beyond), (16, 8), weights)
        blue[k], green[k], red[k] = b, g, r
        level[k] = by_blue * b + by_green * g + by_red * r


@njit(cache=True, inline="always")
def _channel(about, shifts, weights):  # type: ignore[no-untyped-def]
    """The weighted sum of the eight bits of four pixels, from the first shift on in the left ones, the other in the
    right ones.
    """
    (p00, p01, p10, p11), (w00, w01, w10, w11) = about, weights
    above = w00 * _byte(p00, shifts[0]) + w01 * _byte(p01, shifts[1])
    return above + w10 * _byte(p10, shifts[0]) + w11 * _byte(p11, shifts[1])


@njit(cache=True, inline="always")
def _byte(word, shift):  # type: ignore[no-untyped-def]
    """Eight bits from a shift on. Numba takes sums of integers for 64 bits: told that they have 32, the compiler turns
    twice as many to floats at once.
    """
    return np.float32(np.int32(word >> np.int32(shift) & np.int32(255)))


@njit(cache=True)
def _cells(blue, green, red, out):  # type: ignore[no-untyped-def]
    """Where the colours stand in a table of 64³ cells laid flat."""
    two, six, twelve = np.int32(2), np.int32(6), np.int32(12)
    for k in range(len(blue)):
        out[k] = np.int32(blue[k]) >> two << twelve | np.int32(green[k]) >> two << six | np.int32(red[k]) >> two
