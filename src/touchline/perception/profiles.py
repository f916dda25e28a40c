"""The green-white-green profile test: where a scan line crosses a painted line, to a fraction of a pixel.

Both edges of the paint are found on the scan line and taken to the ground; the point midway between them lies on the
line's centre at any angle of crossing, because the two edges of a straight line are parallel.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.camera.omni import ground_from_pixel
from touchline.perception.colour import DARKEST_GREEN, GREEN, ColourModel, chromaticity
from touchline.types import ImageArray

BODY = 3  # a fourth class of samples: the robot itself
DIMMEST_SUM = 10.0  # of B, G and R of carpet in the dark, in the mean of a flank: below, its hue is noise
BLOCK = 16  # samples that share one bound: few enough to be passed over where there is a line beyond their neighbours
COLUMNS = 7  # of a crossing: x, y (m), u, v (px), contrast (share of green to white), chord (m), path


class PathSamples(NamedTuple):
    """What an image shows at the N samples of ScanLines.

    colours: (N, 3), B, G, R. levels: (N,), the colours' signal, higher by 1 on paint than on carpet. classes: (N,).
    """

    colours: npt.NDArray[np.float32]
    levels: npt.NDArray[np.float32]
    classes: npt.NDArray[np.uint8]


class DimCarpet(NamedTuple):
    """Carpet in the dark: its shares of blue and red, how far from them another dark green may lie, and the sums of
    B, G and R between which a flank counts as dark.
    """

    blue: float
    red: float
    reach: float
    min_sum: float
    max_sum: float


def dim_carpet(model: ColourModel) -> DimCarpet:
    """What a carpet of these colours looks like in the dark: nearer to its own hue than to grey."""
    blue, red = chromaticity(model.green)
    usual, grey = float(model.green.sum()), 1.0 / 3.0
    reach = 0.5 * float(np.hypot(blue - grey, red - grey))
    return DimCarpet(float(blue), float(red), reach, DIMMEST_SUM, 1.2 * DARKEST_GREEN * usual)


class ProfileLimits(NamedTuple):
    """What the profile of a line has to be like: `LinePointSettings` for this paint and this noise.

    min_contrast: height as a share of white over green. flank_px: green on each side. max_run_px: from green to green.
    min_chord_m, max_chord_m: way through the paint, which blur_px may make longer. min_cosine: of the excess to white.
    carpet: its green, to know carpet that is too dark for the colour classes.
    """

    min_contrast: float
    flank_px: int
    max_run_px: int
    min_chord_m: float
    max_chord_m: float
    blur_px: float
    min_cosine: float
    carpet: DimCarpet


@njit(cache=True)
def sample_paths(
    image: ImageArray,
    corners: npt.NDArray[np.int32],
    shares: npt.NDArray[np.float32],
    masked: npt.NDArray[np.bool_],
    signal: npt.NDArray[np.float32],
    table: npt.NDArray[np.uint8],
    samples: PathSamples,
) -> None:
    """Look up the N samples of ScanLines (corners (N,), shares (N, 2)) in an image (H, W, 3), contiguous.

    Fills `samples`: colours bilinear, levels by `signal` (3,), classes by the table (64, 64, 64), or BODY where masked
    (N,) says that it is the robot itself.
    """
    colours, levels, classes = samples
    flat, cells = image.reshape(-1), table.reshape(-1)
    blue, green, red = flat, flat[1:], flat[2:]
    beside, below = np.uint64(3), np.uint64(3 * image.shape[1])  # unsigned: none can count from the end
    for k in range(len(corners)):
        here, fu, fv = np.uint64(corners[k]), shares[k, 0], shares[k, 1]
        right, under = here + beside, here + below
        across = under + beside
        w11 = fu * fv
        w01, w10 = fu - w11, fv - w11
        w00 = np.float32(1.0) - fu - w10
        b = w00 * blue[here] + w01 * blue[right] + w10 * blue[under] + w11 * blue[across]
        g = w00 * green[here] + w01 * green[right] + w10 * green[under] + w11 * green[across]
        r = w00 * red[here] + w01 * red[right] + w10 * red[under] + w11 * red[across]
        colours[k, 0], colours[k, 1], colours[k, 2] = b, g, r
        levels[k] = signal[0] * b + signal[1] * g + signal[2] * r
        cell = (np.int32(b) >> 2) << 12 | (np.int32(g) >> 2) << 6 | np.int32(r) >> 2
        classes[k] = BODY if masked[k] else cells[cell]


@njit(cache=True)
def _dim_flank(samples, first, step, limits):  # type: ignore[no-untyped-def]
    """As `_flank` for carpet in the dark, by the colour of all samples together: one alone is too coarse to tell."""
    colours, levels, count, carpet = samples.colours, samples.levels, limits.flank_px, limits.carpet
    level = blue = green = red = 0.0
    for m in range(count):
        k = first + step * m
        level += levels[k] / count
        blue += colours[k, 0] / count
        green += colours[k, 1] / count
        red += colours[k, 2] / count
    total = blue + green + red
    is_carpet = carpet.min_sum <= total <= carpet.max_sum
    if is_carpet:
        is_carpet = np.hypot(blue / total - carpet.blue, red / total - carpet.red) <= carpet.reach
    return level if is_carpet else np.nan, blue, green, red


@njit(cache=True, inline="always")  # to count the references to the arrays of a call takes longer than all the rest
def _flank(colours, levels, classes, first, step, count):  # type: ignore[no-untyped-def]
    """Of `count` samples from `first` on, walking by `step`: how many are green, their mean level and B, G, R.

    A flank that holds an edge between light and dark has no level (NaN): beside a dark thing even green looks whitish.
    """
    number, level, darkest, brightest = 0, 0.0, np.inf, 0.0
    blue = green = red = 0.0
    for m in range(count):
        k = first + step * m
        if classes[k] != GREEN:
            continue
        number += 1
        level += levels[k]
        total = colours[k, 0] + colours[k, 1] + colours[k, 2]
        darkest, brightest = min(darkest, total), max(brightest, total)
        blue += colours[k, 0]
        green += colours[k, 1]
        red += colours[k, 2]
    n = max(number, 1)
    return number, level / n if darkest >= 0.7 * brightest else np.nan, blue / n, green / n, red / n


@njit(cache=True)
def _foot(samples, peak, step, limits, span, mean):  # type: ignore[no-untyped-def]
    """Where the green beside a peak begins: (index, level), walking from the peak by `step`; index -1 if nowhere.

    The first flank that lies low enough below the peak, moved on while blur still lets it fall. In a flank of
    `flank_px` samples three quarters are green, or all of them together are carpet in the dark. span: first sample of
    the scan line, and the first beyond it. mean (3,) is filled with the flank's colour.
    """
    colours, levels, classes = samples
    count, least, dim = limits.flank_px, 0.5 * limits.min_contrast, 2.0 * limits.carpet.max_sum
    foot, base, steps = -1, np.inf, 0
    for m in range(1, limits.max_run_px + 2):
        k = peak + step * m
        last = k + step * (count - 1)
        if min(k, last) < span[0] or max(k, last) >= span[1] or (foot < 0 and m >= limits.max_run_px):
            break
        if foot < 0 and levels[peak] - levels[k] < least:
            continue
        number, level, blue, green, red = _flank(colours, levels, classes, k, step, count)
        if number * 4 < count * 3:
            level = np.nan
            if colours[k, 0] + colours[k, 1] + colours[k, 2] <= dim:  # hardly ever
                level, blue, green, red = _dim_flank(samples, k, step, limits)
        if foot < 0 and not levels[peak] - level >= least:
            continue
        if foot >= 0 and not level < base:
            break
        foot, base, steps = k, level, steps + 1
        mean[0], mean[1], mean[2] = blue, green, red
        if steps == 3:
            break
    return foot, base


@njit(cache=True)
def _floors(levels, reach):  # type: ignore[no-untyped-def]
    """For each block of samples a level that lies no higher than what all its peaks have on one of their sides.

    The higher of the lowest levels of `reach` samples on either side: what hardly rises above it never passes `_falls`.
    """
    blocks, around = (len(levels) + BLOCK - 1) // BLOCK, (reach + BLOCK - 1) // BLOCK
    lowest, floors = np.empty(blocks, np.float32), np.empty(blocks, np.float32)
    for block in range(blocks):
        low = levels[block * BLOCK]
        for k in range(block * BLOCK + 1, min((block + 1) * BLOCK, len(levels))):
            low = min(low, levels[k])
        lowest[block] = low
    for block in range(blocks):
        before = after = lowest[block]
        for step in range(1, around + 1):
            before, after = min(before, lowest[max(block - step, 0)]), min(after, lowest[min(block + step, blocks - 1)])
        floors[block] = max(before, after)
    return floors


@njit(cache=True)
def _falls(levels, peak, limits, span):  # type: ignore[no-untyped-def]
    """Whether the level falls on both sides, tried at a few distances: most maxima are noise of the green."""
    least = 0.5 * limits.min_contrast
    for side in range(2):
        step, distance, fallen = 2 * side - 1, 2, False
        while not fallen and distance < limits.max_run_px:
            k = peak + step * distance
            if k < span[0] or k >= span[1]:
                return False
            fallen = levels[peak] - levels[k] >= least
            distance += distance // 3 + 1
        if not fallen:
            return False
    return True


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
def _edges(samples, peak, limits, span, means, edges):  # type: ignore[no-untyped-def]
    """Height of a peak above the green on both sides; 0 where there is no such green or no edge towards it.

    means (2, 3), edges (2,) are filled with the mean colour of the green and the position of the edge on each side.
    """
    levels = samples.levels
    feet, bases = (0, 0), (0.0, 0.0)
    for side in range(2):
        foot, base = _foot(samples, peak, 2 * side - 1, limits, span, means[side])
        if foot < 0:
            return 0.0
        feet, bases = (feet[1], foot), (bases[1], base)
    if feet[1] - feet[0] > limits.max_run_px:
        return 0.0
    if max(means[0].sum(), means[1].sum()) <= limits.carpet.max_sum:  # dark on both sides: robots wear white, too
        return 0.0
    for side in range(2):
        edges[side] = _edge(levels, feet[side], bases[side], peak, 1 - 2 * side)
    if edges[0] < 0.0 or edges[1] <= edges[0]:
        return 0.0
    return levels[peak] - max(bases[0], bases[1])


@njit(cache=True)
def _looks_white(colours, middle, means, toward, least, cosine):  # type: ignore[no-untyped-def]
    """Whether what is added to the green beside it (means (2, 3)) is paint, not a ball's or a marker's colour."""
    k = int(middle)
    dot, size, toward_size = 0.0, 0.0, 0.0
    for c in range(3):
        excess = 0.5 * (colours[k, c] + colours[k + 1, c]) - max(means[0, c], means[1, c])
        dot += excess * toward[c]
        size += excess * excess
        toward_size += toward[c] * toward[c]
    return dot >= cosine * np.sqrt(size * toward_size) and dot >= least * toward_size


@njit(cache=True)
def _size2(colour):  # type: ignore[no-untyped-def]
    return colour[0] * colour[0] + colour[1] * colour[1] + colour[2] * colour[2]


@njit(cache=True)
def find_line_profiles(path, starts, closed, samples, paint, limits, camera, out):  # type: ignore[no-untyped-def]
    """Green-white-green profiles of all scan lines into out (M, COLUMNS); returns how many.

    path (N, 2), starts, closed: ScanLines. samples: PathSamples. paint: green and white (3,), learned. limits:
    ProfileLimits. camera: constants, bearings, ranges of the OmniCamera's look-up.
    """
    levels, classes, count = samples.levels, samples.classes, limits.flank_px
    green, white = paint
    toward = white - green
    constants, bearings, ranges = camera
    means, edges, ends = np.zeros((2, 3)), np.zeros(2), np.zeros((2, 4))
    floors, rise = _floors(levels, limits.max_run_px), 0.5 * limits.min_contrast
    found = 0
    for p in range(len(starts) - 1):
        span = (starts[p], starts[p + 1])
        first, last = span[0] + count, span[1] - count
        k = first
        while k < last and found < len(out):
            peak = k
            k += 1
            if levels[peak] - floors[peak // BLOCK] < rise:  # nearly always
                continue
            if levels[peak] < levels[peak - 1] or levels[peak] < levels[peak + 1] or classes[peak] == BODY:
                continue
            if not _falls(levels, peak, limits, span):
                continue
            height = _edges(samples, peak, limits, span, means, edges)
            if height <= 0.0:
                continue
            brightness = np.sqrt(max(_size2(means[0]), _size2(means[1])) / _size2(green))
            if height < limits.min_contrast * brightness:
                continue
            middle = 0.5 * (edges[0] + edges[1])
            k = max(k, int(edges[1]) + 1)
            if closed[p] > 0 and not first <= middle < first + closed[p]:
                continue
            least = 0.7 * limits.min_contrast * brightness
            if not _looks_white(samples.colours, middle, means, toward, least, limits.min_cosine):
                continue
            for side in range(2):
                m = int(edges[side])
                f = edges[side] - m
                u, v = path[m, 0] + f * (path[m + 1, 0] - path[m, 0]), path[m, 1] + f * (path[m + 1, 1] - path[m, 1])
                x, y = ground_from_pixel(u, v, constants, bearings, ranges)
                ends[side, 0], ends[side, 1], ends[side, 2], ends[side, 3] = x, y, u, v
            chord = np.hypot(ends[0, 0] - ends[1, 0], ends[0, 1] - ends[1, 1])
            blur = limits.blur_px * chord / (edges[1] - edges[0])
            if not max(limits.min_chord_m - blur, 0.5 * limits.min_chord_m) <= chord <= limits.max_chord_m + blur:
                continue
            for column in range(4):
                out[found, column] = 0.5 * (ends[0, column] + ends[1, column])
            out[found, 4], out[found, 5], out[found, 6] = height / brightness, chord, p
            found += 1
    return found
