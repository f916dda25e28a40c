"""What an image shows along the scan lines: colours between its pixels, how white each is, and its colour class."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.perception.scan_lines import ScanLines
from touchline.types import ImageArray

BODY = 3  # a fourth class of samples: the robot itself
LEVEL = 3  # row of the values


class PathSamples(NamedTuple):
    """What an image shows at the N samples of ScanLines.

    values: (4, N), B, G, R and the level: the colours' signal, higher by 1 on paint than on carpet. classes: (N,).
    pixels: (4, N), what the kernels work with: the upper two and the lower two pixels about each sample, four bytes of
    the image each.
    """

    values: npt.NDArray[np.float32]
    classes: npt.NDArray[np.uint8]
    pixels: npt.NDArray[np.uint32]


def no_samples(count: int) -> PathSamples:
    """Room for `count` samples."""
    return PathSamples(np.zeros((4, count), np.float32), np.zeros(count, np.uint8), np.zeros((4, count), np.uint32))


def sample_paths(
    image: ImageArray,
    lines: ScanLines,
    masked: npt.NDArray[np.bool_],
    signal: npt.NDArray[np.float32],
    table: npt.NDArray[np.uint8],
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
    beside, below = np.uint64(3), np.uint64(width)  # unsigned: none can count from the end
    for k in range(len(corners)):
        here = np.uint64(corners[k])
        pixels[0, k], pixels[1, k] = words[here], words[here + beside]
        pixels[2, k], pixels[3, k] = words[here + below], words[here + below + beside]
    for channel in range(3):
        _blend(pixels, shares, np.uint32(8 * channel), values[channel])
    _mix(values, signal[0], signal[1], signal[2], values[LEVEL])
    cells = table.reshape(-1)
    place = pixels[0].view(np.int32)
    _cells(values, place)
    for k in range(len(classes)):
        classes[k] = BODY if masked[k] else cells[np.uint64(place[k])]


@njit(cache=True)
def _blend(pixels, shares, shift, out):  # type: ignore[no-untyped-def]
    """One channel, bilinear: the eight bits of the pixels (4, N) from `shift` on, by the samples' shares (2, N)."""
    one, byte = np.float32(1.0), np.uint32(255)
    p00, p01, p10, p11 = pixels[0], pixels[1], pixels[2], pixels[3]
    right, down = shares[0], shares[1]
    for k in range(len(out)):
        w11 = right[k] * down[k]
        w01, w10 = right[k] - w11, down[k] - w11
        upper = (one - right[k] - w10) * np.float32(p00[k] >> shift & byte) + w01 * np.float32(p01[k] >> shift & byte)
        out[k] = upper + w10 * np.float32(p10[k] >> shift & byte) + w11 * np.float32(p11[k] >> shift & byte)


@njit(cache=True)
def _mix(values, blue, green, red, out):  # type: ignore[no-untyped-def]
    b, g, r = values[0], values[1], values[2]
    for k in range(len(out)):
        out[k] = blue * b[k] + green * g[k] + red * r[k]


@njit(cache=True)
def _cells(values, out):  # type: ignore[no-untyped-def]
    """Where the colours stand in a table of 64³ cells laid flat."""
    b, g, r = values[0], values[1], values[2]
    two, six, twelve = np.int32(2), np.int32(6), np.int32(12)
    for k in range(len(out)):
        out[k] = np.int32(b[k]) >> two << twelve | np.int32(g[k]) >> two << six | np.int32(r[k]) >> two
