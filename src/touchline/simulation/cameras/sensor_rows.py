"""The loops of the image sensor: from linear radiance to the picture, row by row.

So what lies between the two stays in the fastest cache. Rows are split into halves, the pixels of even and those of odd
columns: half a row of the mosaic has one colour, and every step but the last, the response table, is plain arithmetic
on neighbouring numbers, of which the processor does many at once.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit


@njit(cache=True, error_model="numpy")
def develop_rows(
    radiance: npt.NDArray[np.float32],
    weights: npt.NDArray[np.float32],
    noise: npt.NDArray[np.float32],
    scale: npt.NDArray[np.float32],
    shot: np.float32,
    read_variance: np.float32,
    response: npt.NDArray[np.uint8],
    picture: npt.NDArray[np.uint8],
) -> None:
    """Fill the picture (H, W, 3), blue green red, from radiance (H, W, 3), red green blue, both contiguous.

    weights (R + 1,): the blur's, from its middle on. noise (H W,) of variance 1, or empty; scale (3,): value per
    radiance; shot: variance per value; response (65536,): the picture's code of each 16-bit value. A picture with a
    side below 3 pixels is black: such a mosaic has no pixel with neighbours all around, and OpenCV leaves it empty too.
    """
    height, width, _ = radiance.shape
    if height < 3 or width < 3:
        picture[:] = 0
        return
    flat, out = radiance.reshape(-1), picture.reshape(-1)
    radius, half = len(weights) - 1, (width + 1) // 2
    pitch = half + 2  # of a half row of 16-bit values: one at either end may be read, only to be overwritten later
    line = np.zeros(6 * (half + 2 * _margin(radius)), dtype=np.float32)
    kept, ring = 2 * radius + 1, np.empty((2 * radius + 1) * 4 * half, dtype=np.float32)
    values, codes = np.empty(2 * half, dtype=np.float32), np.zeros(10 * pitch, dtype=np.uint16)
    for ahead in range(height + radius):
        if ahead < height:
            _split(flat, ahead, width, line, radius)
            _blur_along(line, weights, ring, ahead % kept * 4 * half, half)
        v = ahead - radius
        if v < 0:
            continue
        _blur_across(ring, v, weights, height, half, values)
        even, odd = scale[v & 1], scale[(v & 1) + 1]
        _expose(values, noise, v * width, even, odd, shot, read_variance, codes, v % 3 * 2 * pitch + 1, width)
        if v > 1:
            _demosaic(codes, v - 1, pitch, response, out, width)
    row = 3 * width
    out[:row] = out[row : 2 * row]
    out[(height - 1) * row :] = out[(height - 2) * row : (height - 1) * row]


@njit(cache=True, error_model="numpy")
def _reflected(place: int, count: int) -> int:
    """The place from 0 to count - 1 that stands for one outside: the border itself is not repeated. count > 1."""
    while place < 0 or place >= count:
        place = -place if place < 0 else 2 * count - 2 - place
    return place


@njit(cache=True, error_model="numpy")
def _split(flat: npt.NDArray[np.float32], v: int, width: int, line: npt.NDArray[np.float32], radius: int) -> None:
    """Row v of the radiance (3 H W,) to line (3, 2, pitch): colours, their halves, R columns outside at either end."""
    margin, pitch = _margin(radius), len(line) // 6
    start = 3 * v * width
    for i in range(np.uint32(width // 2)):
        first, to = np.uint32(start) + np.uint32(6) * i, np.uint32(margin) + i
        line[to] = flat[first]
        line[to + np.uint32(pitch)] = flat[first + np.uint32(3)]
        line[to + np.uint32(2 * pitch)] = flat[first + np.uint32(1)]
        line[to + np.uint32(3 * pitch)] = flat[first + np.uint32(4)]
        line[to + np.uint32(4 * pitch)] = flat[first + np.uint32(2)]
        line[to + np.uint32(5 * pitch)] = flat[first + np.uint32(5)]
    for channel in range(3):
        at = 2 * channel * pitch + margin
        if width & 1:
            line[at + width // 2] = flat[start + 3 * (width - 1) + channel]
        for k in range(1, radius + 1):
            left, right = _reflected(-k, width), _reflected(width - 1 + k, width)
            line[at + _halved(-k, pitch)] = line[at + _halved(left, pitch)]
            line[at + _halved(width - 1 + k, pitch)] = line[at + _halved(right, pitch)]


@njit(cache=True, error_model="numpy")
def _margin(radius: int) -> int:
    """Room in a half row for R columns outside and what stands between them."""
    return radius // 2 + 1


@njit(cache=True, error_model="numpy")
def _halved(u: int, pitch: int) -> int:
    """The place of a column where the half of even columns is followed, pitch on, by that of odd ones."""
    return (u & 1) * pitch + (u >> 1)


@njit(cache=True, error_model="numpy")
def _blur_along(
    line: npt.NDArray[np.float32], weights: npt.NDArray[np.float32], ring: npt.NDArray[np.float32], to: int, half: int
) -> None:
    """What the mosaic asks for of a split row, blurred along it, to four halves (4, half) from ring[to] on: red of
    even and green of odd columns, as used in even rows; green of even and blue of odd columns."""
    radius, pitch = len(weights) - 1, len(line) // 6
    for part in range(4):
        odd, channel = part & 1, (part + 1) // 2
        out = to + part * half
        same = (2 * channel + odd) * pitch + _margin(radius)
        left = (2 * channel + 1 - odd) * pitch + _margin(radius) + odd - 1  # the column before, in the other half
        if radius == 0:
            _copy(line, same, ring, out, half)
            continue
        _weigh_five(line, same - 1, left, same, left + 1, same + 1, weights, ring, out, half)
        for k in range(3, radius + 1):
            m = k // 2
            if k & 1:
                _weigh_two(line, left - m, left + 1 + m, weights[k], ring, out, half)
            else:
                _weigh_two(line, same - m, same + m, weights[k], ring, out, half)


@njit(cache=True, error_model="numpy")
def _blur_across(
    ring: npt.NDArray[np.float32],
    v: int,
    weights: npt.NDArray[np.float32],
    height: int,
    half: int,
    values: npt.NDArray[np.float32],
) -> None:
    """Row v, blurred across rows, to values (2, half). ring (2 R + 1, 4, half): row i is in place i mod 2 R + 1."""
    radius, count, pitch = len(weights) - 1, 2 * half, 4 * half
    kept, side = 2 * radius + 1, (v & 1) * count
    at = v % kept * pitch + side
    if radius == 0:
        _copy(ring, at, values, 0, count)
        return
    above, below = _reflected(v - 1, height) % kept * pitch + side, _reflected(v + 1, height) % kept * pitch + side
    higher, lower = _reflected(v - 2, height) % kept * pitch + side, _reflected(v + 2, height) % kept * pitch + side
    _weigh_five(ring, higher, above, at, below, lower, weights, values, 0, count)
    for k in range(3, radius + 1):
        above, below = _reflected(v - k, height) % kept * pitch + side, _reflected(v + k, height) % kept * pitch + side
        _weigh_two(ring, above, below, weights[k], values, 0, count)


@njit(cache=True, error_model="numpy")
def _expose(
    values: npt.NDArray[np.float32],
    noise: npt.NDArray[np.float32],
    start: int,
    even: np.float32,
    odd: np.float32,
    shot: np.float32,
    read_variance: np.float32,
    codes: npt.NDArray[np.uint16],
    to: int,
    width: int,
) -> None:
    """A row of the mosaic, from radiance (2, half) and noise[start : start + W], to codes from `to` on: (2, half + 2).
    even and odd: value per radiance of the two halves."""
    half = len(values) // 2
    pitch = half + 2
    if len(noise) > 0:
        for i in range(np.uint32(width // 2)):
            pair = np.uint32(start) + np.uint32(2) * i
            first, second = values[i] * even, values[np.uint32(half) + i] * odd
            codes[np.uint32(to) + i] = _code(_noisy(first, noise[pair], shot, read_variance))
            second = _noisy(second, noise[pair + np.uint32(1)], shot, read_variance)
            codes[np.uint32(to + pitch) + i] = _code(second)
        if width & 1:
            last = _noisy(values[half - 1] * even, noise[start + width - 1], shot, read_variance)
            codes[to + half - 1] = _code(last)
    else:
        for i in range(np.uint32(half)):
            codes[np.uint32(to) + i] = _code(values[i] * even)
            codes[np.uint32(to + pitch) + i] = _code(values[np.uint32(half) + i] * odd)


@njit(cache=True, error_model="numpy")
def _noisy(value: np.float32, normal: np.float32, shot: np.float32, read_variance: np.float32) -> np.float32:
    """A value with its noise, of which a normal number of variance 1 is given."""
    deviation: np.float32 = np.sqrt(max(value * shot + read_variance, np.float32(0.0)))
    return value + normal * deviation


@njit(cache=True, error_model="numpy")
def _code(value: np.float32) -> np.uint16:
    """The 16-bit code of a value; 1 and above are clipped."""
    clipped = min(max(value, np.float32(0.0)), np.float32(1.0))
    return np.uint16(np.int32(clipped * np.float32(65535.0) + np.float32(0.5)))


@njit(cache=True, error_model="numpy")
def _demosaic(
    codes: npt.NDArray[np.uint16],
    v: int,
    pitch: int,
    response: npt.NDArray[np.uint8],
    out: npt.NDArray[np.uint8],
    width: int,
) -> None:
    """Row v of the picture, not its first or last. codes (10, pitch): mosaic rows v - 1 to v + 1, row i in places
    2 (i mod 3) and the next, then four halves of work space.

    A row has its own colour, red in even rows and blue in odd ones, and green. Own pixels are in columns of the row's
    parity; the other colour is in the rows above and below, where they have green.
    """
    odd, count = v & 1, width // 2
    half = pitch - 2
    own, green = odd * pitch + 1, (1 - odd) * pitch + 1
    above, row, below = (v - 1) % 3 * 2 * pitch, v % 3 * 2 * pitch, (v + 1) % 3 * 2 * pitch
    left = green + odd - 1  # of an own pixel; its neighbour to the right is the next number
    before = own - odd  # of a green pixel
    green_there, other_there, own_here, other_here = 6 * pitch, 7 * pitch, 8 * pitch, 9 * pitch
    _mean_four(codes, above + own, below + own, row + left, row + left + 1, green_there, half)
    _mean_four(codes, above + left, above + left + 1, below + left, below + left + 1, other_there, half)
    _mean_two(codes, row + before, row + before + 1, own_here, half)
    _mean_two(codes, above + green, below + green, other_here, half)
    first = 3 * v * width
    if odd:
        _respond(
            codes, own_here, row + green, other_here, row + own, green_there, other_there, response, out, first, count
        )
    else:
        _respond(
            codes, other_there, green_there, row + own, other_here, row + green, own_here, response, out, first, count
        )
    last = first + 3 * (width - 1)
    for channel in range(3):
        out[first + channel] = out[first + 3 + channel]
        out[last + channel] = out[last - 3 + channel]


# Below: loops over neighbouring numbers. They get whole arrays and places in them, as parts of arrays would have their
# references counted, and unsigned ones, as Numba looks whether others count from the end.


@njit(cache=True, error_model="numpy")
def _copy(x: npt.NDArray[np.float32], at: int, out: npt.NDArray[np.float32], to: int, count: int) -> None:
    """x[at : at + count] to out[to : to + count]."""
    for i in range(np.uint32(count)):
        out[np.uint32(to) + i] = x[np.uint32(at) + i]


@njit(cache=True, error_model="numpy")
def _weigh_five(
    x: npt.NDArray[np.float32],
    a: int,
    b: int,
    c: int,
    d: int,
    e: int,
    weights: npt.NDArray[np.float32],
    out: npt.NDArray[np.float32],
    to: int,
    count: int,
) -> None:
    """The blur's middle five numbers, x[c + i] that in the middle, to out[to + i]."""
    w, w1, w2 = weights[0], weights[1], weights[2]
    for i in range(np.uint32(count)):
        near, far = x[np.uint32(b) + i] + x[np.uint32(d) + i], x[np.uint32(a) + i] + x[np.uint32(e) + i]
        out[np.uint32(to) + i] = w * x[np.uint32(c) + i] + w1 * near + w2 * far


@njit(cache=True, error_model="numpy")
def _weigh_two(
    x: npt.NDArray[np.float32], a: int, b: int, weight: np.float32, out: npt.NDArray[np.float32], to: int, count: int
) -> None:
    """Two more numbers of the blur, at the same distance on either side."""
    for i in range(np.uint32(count)):
        out[np.uint32(to) + i] += weight * (x[np.uint32(a) + i] + x[np.uint32(b) + i])


@njit(cache=True, error_model="numpy")
def _mean_two(x: npt.NDArray[np.uint16], a: int, b: int, to: int, count: int) -> None:
    """Means of as many codes from each place on, halves rounded up as OpenCV does, to x[to : to + count]."""
    for i in range(np.uint32(count)):
        total = np.uint32(x[np.uint32(a) + i]) + np.uint32(x[np.uint32(b) + i])
        x[np.uint32(to) + i] = np.uint16((total + np.uint32(1)) >> np.uint32(1))


@njit(cache=True, error_model="numpy")
def _mean_four(x: npt.NDArray[np.uint16], a: int, b: int, c: int, d: int, to: int, count: int) -> None:
    """Means of as many codes from each place on, halves rounded up as OpenCV does, to x[to : to + count]."""
    for i in range(np.uint32(count)):
        total = np.uint32(x[np.uint32(a) + i]) + np.uint32(x[np.uint32(b) + i])
        total += np.uint32(x[np.uint32(c) + i]) + np.uint32(x[np.uint32(d) + i])
        x[np.uint32(to) + i] = np.uint16((total + np.uint32(2)) >> np.uint32(2))


@njit(cache=True, error_model="numpy")
def _respond(
    x: npt.NDArray[np.uint16],
    b: int,
    g: int,
    r: int,
    next_b: int,
    next_g: int,
    next_r: int,
    response: npt.NDArray[np.uint8],
    out: npt.NDArray[np.uint8],
    to: int,
    count: int,
) -> None:
    """Pairs of pixels of even and odd columns through the response, to out[to : to + 6 * count]."""
    for i in range(np.uint32(count)):
        first = np.uint32(to) + np.uint32(6) * i
        out[first] = response[x[np.uint32(b) + i]]
        out[first + np.uint32(1)] = response[x[np.uint32(g) + i]]
        out[first + np.uint32(2)] = response[x[np.uint32(r) + i]]
        out[first + np.uint32(3)] = response[x[np.uint32(next_b) + i]]
        out[first + np.uint32(4)] = response[x[np.uint32(next_g) + i]]
        out[first + np.uint32(5)] = response[x[np.uint32(next_r) + i]]
