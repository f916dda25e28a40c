"""The green-white-green profile test: where a scan line crosses a painted line, to a fraction of a pixel.

Both edges of the paint are found on the scan line and taken to the ground; the point midway between them lies on the
line's centre at any angle of crossing, because the two edges of a straight line are parallel.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.camera.omni import ground_from_pixel
from touchline.perception.colour import GREEN
from touchline.types import ImageArray

BODY = 3  # a fourth class of samples: the robot itself
COLUMNS = 7  # of a crossing: x, y (m), u, v (px), contrast (share of green to white), chord (m), path


@njit(cache=True)
def sample_paths(
    image: ImageArray,
    corners: npt.NDArray[np.int32],
    shares: npt.NDArray[np.float32],
    masked: npt.NDArray[np.bool_],
    signal: npt.NDArray[np.float32],
    table: npt.NDArray[np.uint8],
    colours: npt.NDArray[np.float32],
    levels: npt.NDArray[np.float32],
    classes: npt.NDArray[np.uint8],
) -> None:
    """Look up the N samples of ScanLines (corners (N,), shares (N, 2)) in an image (H, W, 3), contiguous.

    Fills colours (N, 3), B, G, R, bilinear; levels (N,), `signal` (3,) of the colour; classes (N,) by the table
    (64, 64, 64), or BODY where masked (N,) says that it is the robot itself.
    """
    flat, below, cells = image.reshape(-1), 3 * image.shape[1], table.reshape(-1)
    for k in range(len(corners)):
        near, fu, fv = corners[k], shares[k, 0], shares[k, 1]
        far = near + below
        w11 = fu * fv
        w01, w10 = fu - w11, fv - w11
        w00 = np.float32(1.0) - fu - w10
        b = w00 * flat[near] + w01 * flat[near + 3] + w10 * flat[far] + w11 * flat[far + 3]
        g = w00 * flat[near + 1] + w01 * flat[near + 4] + w10 * flat[far + 1] + w11 * flat[far + 4]
        r = w00 * flat[near + 2] + w01 * flat[near + 5] + w10 * flat[far + 2] + w11 * flat[far + 5]
        colours[k, 0], colours[k, 1], colours[k, 2] = b, g, r
        levels[k] = signal[0] * b + signal[1] * g + signal[2] * r
        cell = (np.int32(b) >> 2) << 12 | (np.int32(g) >> 2) << 6 | np.int32(r) >> 2
        classes[k] = BODY if masked[k] else cells[cell]


@njit(cache=True)
def _flank(samples, first, step, count, low, high, mean):  # type: ignore[no-untyped-def]
    """Mean level of `count` samples from `first` on, walking by `step`; NaN unless three quarters of them are green.

    A flank that holds an edge between light and dark is none, either: beside a dark thing even green looks whitish.
    mean (3,) is filled with the green samples' mean colour.
    """
    colours, levels, classes = samples
    last = first + step * (count - 1)
    if min(first, last) < low or max(first, last) >= high:
        return np.nan
    green, level, darkest, brightest = 0, 0.0, np.inf, 0.0
    for c in range(3):
        mean[c] = 0.0
    for m in range(count):
        k = first + step * m
        if classes[k] != GREEN:
            continue
        green += 1
        level += levels[k]
        total = colours[k, 0] + colours[k, 1] + colours[k, 2]
        darkest, brightest = min(darkest, total), max(brightest, total)
        for c in range(3):
            mean[c] += colours[k, c]
    if green * 4 < count * 3 or darkest < 0.7 * brightest:
        return np.nan
    for c in range(3):
        mean[c] /= green
    return level / green


@njit(cache=True)
def _foot(samples, peak, step, count, reach, least, low, high, mean):  # type: ignore[no-untyped-def]
    """Where the green beside a peak begins: (index, level), walking from the peak by `step`; index -1 if nowhere.

    The first flank that lies low enough below the peak, moved on while blur still lets it fall.
    """
    levels = samples[1]
    for m in range(1, reach):
        k = peak + step * m
        if k < low or k >= high:
            break
        if levels[peak] - levels[k] < least:
            continue
        level = _flank(samples, k, step, count, low, high, mean)
        if np.isnan(level) or levels[peak] - level < least:
            continue
        for _ in range(2):
            further = _flank(samples, k + step, step, count, low, high, mean)
            if np.isnan(further) or further >= level:
                break
            k, level = k + step, further
        _flank(samples, k, step, count, low, high, mean)
        return k, level
    return -1, 0.0


@njit(cache=True)
def _falls(levels, peak, step, reach, low, high, least):  # type: ignore[no-untyped-def]
    """Whether the level falls by `least` on that side, tried at a few distances: most maxima are noise of the green."""
    distance = 2
    while distance < reach:
        k = peak + step * distance
        if k < low or k >= high:
            return False
        if levels[peak] - levels[k] >= least:
            return True
        distance += distance // 3 + 1
    return False


@njit(cache=True)
def _edge(levels, foot, base, peak, step):  # type: ignore[no-untyped-def]
    """Position (samples) at half height between the green from `foot` on (level `base`) and the paint at `peak`.

    `step` leads from the foot to the peak. The paint's height is that near this edge: its light may vary along the way.
    """
    k, m = foot, foot
    while m != peak and abs(m - foot) < 8:
        m += step
        if levels[m] > levels[k]:
            k = m
    if levels[k] <= base:
        return -1.0
    half = 0.5 * (base + levels[k])
    for _ in range(12):
        k -= step
        if levels[k] <= half:
            return k + step * (half - levels[k]) / (levels[k + step] - levels[k])
    return -1.0


@njit(cache=True)
def _looks_white(colours, middle, left, right, toward, least, cosine):  # type: ignore[no-untyped-def]
    """Whether what is added to the green beside it (left, right: (3,)) is paint, not a ball's or a marker's colour."""
    k = int(middle)
    dot, size, toward_size = 0.0, 0.0, 0.0
    for c in range(3):
        excess = 0.5 * (colours[k, c] + colours[k + 1, c]) - max(left[c], right[c])
        dot += excess * toward[c]
        size += excess * excess
        toward_size += toward[c] * toward[c]
    return dot >= cosine * np.sqrt(size * toward_size) and dot >= least * toward_size


@njit(cache=True)
def _at(path, position):  # type: ignore[no-untyped-def]
    k = int(position)
    f = position - k
    return path[k, 0] + f * (path[k + 1, 0] - path[k, 0]), path[k, 1] + f * (path[k + 1, 1] - path[k, 1])


@njit(cache=True)
def find_line_profiles(path, starts, closed, samples, paint, limits, camera, out):  # type: ignore[no-untyped-def]
    """Green-white-green profiles of all scan lines into out (M, COLUMNS); returns how many.

    path (N, 2), starts, closed: ScanLines. samples: colours (N, 3), levels (N,), classes (N,) of `sample_paths`.
    paint: green and white (3,), learned. limits: least contrast (share of green to white), flank (samples), longest
    run (samples), least and greatest chord (m), blur (px), least cosine of the excess. camera: constants, bearings,
    ranges of the OmniCamera's look-up.
    """
    colours, levels, classes = samples
    green, white = paint
    contrast, count, reach = limits[0], int(limits[1]), int(limits[2])
    least_chord, greatest_chord, blur_px, cosine = limits[3], limits[4], limits[5], limits[6]
    constants, bearings, ranges = camera
    left_mean, right_mean, toward = np.zeros(3), np.zeros(3), white - green
    inward, outward = np.int64(-1), np.int64(1)  # as literals, they would have each of the functions compiled twice
    found = 0
    for p in range(len(starts) - 1):
        low, high = starts[p], starts[p + 1]
        k = low + count
        while k < high - count and found < len(out):
            peak = k
            k += 1
            if levels[peak] < levels[peak - 1] or levels[peak] < levels[peak + 1] or classes[peak] == BODY:
                continue
            if not (_falls(levels, peak, inward, reach, low, high, 0.5 * contrast)
                    and _falls(levels, peak, outward, reach, low, high, 0.5 * contrast)):  # fmt: skip
                continue
            left, left_level = _foot(samples, peak, inward, count, reach, 0.5 * contrast, low, high, left_mean)
            if left < 0:
                continue
            right, right_level = _foot(samples, peak, outward, count, reach, 0.5 * contrast, low, high, right_mean)
            if right < 0 or right - left > reach:
                continue
            brightness = np.sqrt(max(np.sum(left_mean**2), np.sum(right_mean**2)) / np.sum(green**2))
            height = levels[peak] - max(left_level, right_level)
            if height < contrast * brightness:
                continue
            a = _edge(levels, left, left_level, peak, outward)
            b = _edge(levels, right, right_level, peak, inward)
            if a < 0.0 or b <= a:
                continue
            middle = 0.5 * (a + b)
            k = max(k, int(b) + 1)
            if closed[p] > 0 and not low + count <= middle < low + count + closed[p]:
                continue
            least = 0.7 * contrast * brightness
            if not _looks_white(colours, middle, left_mean, right_mean, toward, least, cosine):
                continue
            (ua, va), (ub, vb) = _at(path, a), _at(path, b)
            xa, ya = ground_from_pixel(ua, va, constants, bearings, ranges)
            xb, yb = ground_from_pixel(ub, vb, constants, bearings, ranges)
            chord = np.hypot(xa - xb, ya - yb)
            blur = blur_px * chord / (b - a)
            if not max(least_chord - blur, 0.5 * least_chord) <= chord <= greatest_chord + blur:
                continue
            row = out[found]
            row[0], row[1], row[2], row[3] = 0.5 * (xa + xb), 0.5 * (ya + yb), 0.5 * (ua + ub), 0.5 * (va + vb)
            row[4], row[5], row[6] = height / brightness, chord, p
            found += 1
    return found
