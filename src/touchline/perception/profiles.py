"""The green-white-green profile test: where a scan line crosses a painted line, to a fraction of a pixel.

Both edges of the paint are found on the scan line and taken to the ground; the point midway between them lies on the
line's centre at any angle of crossing, because the two edges of a straight line are parallel.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.camera.omni import shifted_ground
from touchline.matrices import copy_row, uncounted
from touchline.perception.colour import DARKEST_GREEN, GREEN, ColourModel, chromaticity
from touchline.perception.path_samples import BODY, LEVEL

FLANK = 4  # samples of the green wanted on both sides of a line: averages noise, fits between two lines
DIMMEST_SUM = 10.0  # of B, G and R of carpet in the dark, in the mean of a flank: below, its hue is noise
BLOCK = 16  # samples that are looked at together by SIMD instructions
FALLS = 2, 3, 5, 7, 10, 14, 19, 26, 35  # samples from a peak, below `max_run`, at which its level is tried
GREEN_FLANK, BARE_FLANK = np.uint8(16), np.uint8(32)  # three quarters of its samples are green; none is, nor the robot
COLUMNS = 8  # of a crossing: x, y (m), u, v (px), contrast (share of green to white), chord (m), path, px beside floor
ROW_M, ROW_ASIDE_M, ROW_POINTS = 1.5, 0.05, 4  # points beside a floor count where so many more lie on a line with them
_PALEST = 0.7  # of the way from carpet to grey: so far may be what is green, and as far as carpet in its usual light is
_DUSK = 1.6  # times the sum that counts as dark: below three quarters of the usual carpet's
_DARK = 0.8  # of the carpet's brightness, at most, has a floor beside it that is no carpet


class DimCarpet(NamedTuple):
    """Carpet in the dark: its shares of blue and red, how far from them another dark green may lie, and another green
    at all, and the sums of B, G and R between which a flank counts as dark.
    """

    blue: float
    red: float
    reach: float
    palest: float
    min_sum: float
    max_sum: float


@lru_cache(maxsize=1)  # of the model that is in use
def dim_carpet(model: ColourModel) -> DimCarpet:
    """What a carpet of these colours looks like in the dark: nearer to its own hue than to grey."""
    blue, red = chromaticity(model.green)
    usual, grey = float(model.green.sum()), 1.0 / 3.0
    to_grey = float(np.hypot(blue - grey, red - grey))
    paler = model.green + np.linspace(_PALEST, 2.0, 14)[:, np.newaxis] * (usual / 3.0 - model.green)
    is_green = model.classify(np.clip(paler, 0.0, 255.0).astype(np.uint8)[np.newaxis])[0] == GREEN
    palest = to_grey * (_PALEST + 0.1 * float(np.argmin(np.append(is_green, False))))
    return DimCarpet(float(blue), float(red), 0.5 * to_grey, palest, DIMMEST_SUM, 1.2 * DARKEST_GREEN * usual)


class ProfileLimits(NamedTuple):
    """What the profile of a line has to be like: `LinePointSettings` for this paint and this noise.

    min_contrast: height as a share of white over green. max_run: samples from green to green.
    min_chord_m, max_chord_m: way through the paint, which blur_px may make longer. min_cosine: of the excess to white.
    carpet: its green, to know carpet that is too dark for the colour classes. dark_floor: whether a line may have
    darker floor instead of carpet on one side.
    """

    min_contrast: float
    max_run: int
    min_chord_m: float
    max_chord_m: float
    blur_px: float
    min_cosine: float
    carpet: DimCarpet
    dark_floor: bool


@njit(cache=True, error_model="numpy", inline="always")
def _dim_level(values, classes, first, step, limits):  # type: ignore[no-untyped-def]
    """As `_level` for carpet in the dark, by the colour of all samples together: one alone is too coarse to tell."""
    carpet, level = limits.carpet, 0.0
    for m in range(FLANK):
        level += values[LEVEL, first + step * np.uint64(m)]
    blue, green, red = _colour(values, classes, first, step, FLANK)
    total = blue + green + red
    is_carpet = carpet.min_sum <= total <= carpet.max_sum
    if is_carpet:
        is_carpet = np.hypot(blue / total - carpet.blue, red / total - carpet.red) <= carpet.reach
    return level / FLANK if is_carpet else np.nan


@njit(cache=True, error_model="numpy", inline="always")
def _level(values, classes, first, step, number, limits):  # type: ignore[no-untyped-def]
    """Mean level of those of `FLANK` samples from `first` on, walking by `step`, that are green: number.

    A flank that holds an edge between light and dark has no level (NaN): beside a dark thing even green looks whitish.
    Nor has one in the dusk that is paler than carpet: in little light the noise makes single greys green.
    """
    level, light, darkest, brightest, is_whole = 0.0, 0.0, np.float32(np.inf), np.float32(0.0), number == FLANK
    for m in range(FLANK):  # without branches: which sample is not green nobody foresees
        k = first + step * np.uint64(m)
        counts = is_whole | (classes[k] == GREEN)
        total = values[0, k] + values[1, k] + values[2, k]
        level += values[LEVEL, k] if counts else 0.0
        light += total if counts else 0.0
        darkest = total if counts & (total < darkest) else darkest
        brightest = total if counts & (total > brightest) else brightest
    carpet = limits.carpet
    if darkest < 0.7 * brightest:
        return np.nan
    if light < number * (_DUSK * 2.0 * carpet.max_sum):
        blue, green, red = _colour(values, classes, first, step, number)
        total = blue + green + red
        if np.hypot(blue / total - carpet.blue, red / total - carpet.red) > carpet.palest:
            return np.nan
    return level / number


@njit(cache=True, error_model="numpy", inline="always")
def _colour(values, classes, first, step, number):  # type: ignore[no-untyped-def]
    """Mean B, G, R of the same samples as `_level`, or of all `FLANK`."""
    blue, green, red, is_whole = 0.0, 0.0, 0.0, number == FLANK
    for m in range(FLANK):
        k = first + step * np.uint64(m)
        counts = is_whole | (classes[k] == GREEN)
        blue += values[0, k] if counts else 0.0
        green += values[1, k] if counts else 0.0
        red += values[2, k] if counts else 0.0
    return blue / number, green / number, red / number


@njit(cache=True)
def _flanks_of(classes):  # type: ignore[no-untyped-def]
    """(N,) of the `FLANK` samples from each on: how many are green, with `GREEN_FLANK`, `BARE_FLANK`."""
    count, many = len(classes), np.uint8(16)
    own, flanks = np.empty(count, np.uint8), np.zeros(count, np.uint8)
    for k in range(count):
        own[k] = np.uint8((classes[k] == GREEN) + np.uint8((classes[k] == BODY) * np.uint8(8)))
    for k in range(count - 1):
        own[k] = np.uint8(own[k] + own[k + 1])
    for k in range(count - FLANK + 1):
        found = np.uint8(own[k] + own[k + 2])
        greens = np.uint8(found & np.uint8(7))
        is_green, is_bare = np.uint8(greens * 4 >= FLANK * 3), np.uint8(found == 0)
        flanks[k] = np.uint8(greens + is_green * many + is_bare * many * 2)
    return flanks


@njit(cache=True, error_model="numpy")
def _nearest(values, flanks, peak, step, most, kind, limits):  # type: ignore[no-untyped-def]
    """How many samples from a peak, by `step`, the first is that lies low enough for a flank of a kind to begin there,
    or for `GREEN_FLANK` is as dark as carpet in the dark; 0 where `most` is too few. A block at once, by SIMD
    instructions.
    """
    darkest = 2.0 * limits.carpet.max_sum if kind == GREEN_FLANK else -1.0
    blues, greens, reds, levels = values[0], values[1], values[2], values[LEVEL]
    size, dark, none = np.int32(BLOCK), np.float32(darkest), np.uint8(0)
    if len(levels) < BLOCK + FLANK:
        return 1 if most > 0 else 0
    ceiling = levels[np.uint64(peak)], np.float32(0.5 * limits.min_contrast)
    near = 1
    while near <= most:
        first = size
        if step > 0:
            at = min(peak + near, len(levels) - BLOCK)
            passed = np.int32(peak + near - at)  # the last block overlaps what was looked at
            for m in range(BLOCK):
                k = np.uint64(at) + np.uint64(m)
                may = ((flanks[k] & kind) != none) | (blues[k] + greens[k] + reds[k] <= dark)
                may = may & (ceiling[0] - levels[k] >= ceiling[1]) & (np.int32(m) >= passed)
                first = min(first, np.int32(np.int32(m) - passed) if may else size)
        else:
            at = max(peak - near - (BLOCK - 1), FLANK - 1)
            last = np.int32(peak - near - at)
            for m in range(BLOCK):
                k = np.uint64(at) + np.uint64(m)
                may = ((flanks[k - np.uint64(FLANK - 1)] & kind) != none) | (blues[k] + greens[k] + reds[k] <= dark)
                may = may & (ceiling[0] - levels[k] >= ceiling[1]) & (np.int32(m) <= last)
                first = min(first, np.int32(last - np.int32(m)) if may else size)
        if first < size:
            return near + first if near + first <= most else 0
        near += BLOCK
    return 0


@njit(cache=True, error_model="numpy")
def _foot(values, classes, flanks, peak, step, limits, span):  # type: ignore[no-untyped-def]
    """Where the green beside a peak begins, walking from the peak by `step`: index, level, B, G, R; index -1: nowhere.

    The first flank that lies low enough below the peak, moved on while blur still lets it fall. In a flank of
    `FLANK` samples three quarters are green, or all of them together are carpet in the dark. span: first sample of
    the scan line, and the first beyond it.
    """
    # unsigned places, here and in what these call: none counts from the end, for which each look-up would be tested. A
    # step back is 2^64 - 1 then, and adding it wraps; `room` keeps all of a flank in the scan line
    top, count, leap = values[LEVEL, np.uint64(peak)], FLANK, np.uint64(step)
    least, dim = 0.5 * limits.min_contrast, 2.0 * limits.carpet.max_sum
    room = (span[1] - peak if step > 0 else peak - span[0] + 1) - count
    foot, base, steps, greens = -1, np.inf, 0, np.int64(0)
    back = np.uint64(0 if step > 0 else count - 1)  # to the first sample of a flank
    near = _nearest(values, flanks, peak, step, min(limits.max_run - 1, room), GREEN_FLANK, limits)
    for m in range(near, min(limits.max_run + 1, room) + 1 if near > 0 else 0):
        k = np.uint64(peak + step * m)
        if foot < 0 and m >= limits.max_run:
            break
        if foot < 0 and top - values[LEVEL, k] < least:
            continue
        flank, number, level = flanks[k - back], np.int64(count), np.nan
        if flank & GREEN_FLANK:
            number = np.int64(flank & np.uint8(7))
            level = _level(values, classes, k, leap, number, limits)
        elif values[0, k] + values[1, k] + values[2, k] <= dim:  # hardly ever
            level = _dim_level(values, classes, k, leap, limits)
        if foot < 0 and not top - level >= least:
            continue
        if foot >= 0 and not level < base:
            break
        foot, base, steps, greens = peak + step * m, level, steps + 1, number
        if steps == 3:
            break
    if foot < 0:
        return foot, base, 0.0, 0.0, 0.0
    blue, green, red = _colour(values, classes, np.uint64(foot), leap, greens)
    return foot, base, blue, green, red


@njit(cache=True, error_model="numpy")
def _floor(values, flanks, peak, step, limits, span, beside):  # type: ignore[no-untyped-def]
    """As `_foot`, where the carpet ends at the line: an even floor, darker than the carpet (3,) on its other side.

    What contrasts with both is a line: the level of its foot is that of the darkest of three flanks.
    """
    top, count, leap = values[LEVEL, np.uint64(peak)], FLANK, np.uint64(step)
    carpet = beside[0] + beside[1] + beside[2]
    foot, base, steps = -1, np.inf, 0
    blue = green = red = 0.0
    room = (span[1] - peak if step > 0 else peak - span[0] + 1) - count
    back, most = np.uint64(0 if step > 0 else count - 1), min(limits.max_run, room)
    near = _nearest(values, flanks, peak, step, most, BARE_FLANK, limits)
    for m in range(near, most + 1 if near > 0 else 0):
        k = np.uint64(peak + step * m)
        if top - values[LEVEL, k] < 0.5 * limits.min_contrast:
            continue
        dark = (flanks[k - back] & BARE_FLANK) != np.uint8(0)
        darkest, brightest = np.inf, 0.0
        for n in range(count if dark else 0):
            j = k + leap * np.uint64(n)
            total = values[0, j] + values[1, j] + values[2, j]
            darkest, brightest = min(darkest, total), max(brightest, total)
        even = darkest >= 0.6 * brightest or brightest < 0.2 * carpet
        dark = dark and even and brightest <= _DARK * carpet
        level = mean_blue = mean_green = mean_red = 0.0
        for n in range(count if dark else 0):
            j = k + leap * np.uint64(n)
            level += values[LEVEL, j] / count
            mean_blue += values[0, j] / count
            mean_green += values[1, j] / count
            mean_red += values[2, j] / count
        if not dark or mean_green > _DARK * beside[1]:
            if foot >= 0:
                break
            continue
        if not level < base or top - level < 0.5 * limits.min_contrast:
            break
        foot, base, steps = peak + step * m, level, steps + 1
        blue, green, red = mean_blue, mean_green, mean_red
        if steps == 3:
            break
    return foot, base, blue, green, red


@njit(cache=True, error_model="numpy", fastmath={"nnan"}, forceinline=True)
def _lowest(levels, k, side):  # type: ignore[no-untyped-def]
    """The lowest level at the distances `FALLS` from a sample, on the side 1 or -1; none is NaN."""
    lowest = levels[np.uint64(k + side * FALLS[0])]
    for distance in FALLS:
        lowest = min(lowest, levels[np.uint64(k + side * distance)])
    return lowest


@njit(cache=True, error_model="numpy")
def _peaks(levels, least, peaks):  # type: ignore[no-untyped-def]
    """Samples that are no lower than their neighbours, and from which the level falls by `least` on both sides, into
    peaks (N,), in order; returns how many. Those within `FALLS` of the ends of all samples are not asked how it falls.

    Noise makes every third sample of the green higher than its neighbours, and where the level falls no processor
    foresees: without branches, by SIMD instructions.
    """
    reach, last, count = FALLS[-1], len(levels) - 1, np.int64(0)
    marks = np.zeros(len(levels) // 8 * 8 + 8, np.uint8)
    for low, high in ((1, min(reach, last)), (max(last - reach, 1), last)):
        for k in range(low, high):
            marks[k] = levels[k] >= max(levels[k - 1], levels[k + 1])
    inner = marks[reach:]
    for i in range(len(levels) - 2 * reach):
        at = np.uint64(i + reach)
        here, floor = levels[at], max(_lowest(levels, i + reach, -1), _lowest(levels, i + reach, 1))
        is_highest = (here >= levels[at - np.uint64(1)]) & (here >= levels[at + np.uint64(1)])
        inner[i] = is_highest & (here - floor >= least)
    words, busy, eights = marks.view(np.uint64), np.empty(len(marks) // 8, np.int64), 0
    for k in range(len(words)):
        busy[eights] = 8 * k
        eights += words[k] != np.uint64(0)
    for i in range(eights):
        first = np.uint64(busy[i])
        for k in range(8):
            peaks[count] = busy[i] + k
            count += np.int64(marks[first + np.uint64(k)])
    return count


@njit(cache=True, error_model="numpy")
def _falls(levels, peak, least, span):  # type: ignore[no-untyped-def]
    """Whether the level falls by `least` on both sides of a peak, within its scan line: most maxima are noise of the
    green.
    """
    before, after, top = False, False, levels[np.uint64(peak)]
    for distance in FALLS:
        low, high = peak - distance, peak + distance
        before |= top - levels[np.uint64(low if low >= span[0] else peak)] >= least
        after |= top - levels[np.uint64(high if high < span[1] else peak)] >= least
    return before and after


@njit(cache=True, error_model="numpy")
def _edge(values, foot, base, peak, step):  # type: ignore[no-untyped-def]
    """Position (samples) at half height between the green from `foot` on (level `base`) and the paint at `peak`.

    `step` leads from the foot to the peak. The paint's height is that near this edge: its light may vary along the way.
    """
    levels, k, m = values[LEVEL], foot, foot
    top = levels[np.uint64(foot)]
    while m != peak and abs(m - foot) < 8:
        m += step
        level = levels[np.uint64(m)]
        if level > top:
            k, top = m, level
    if top <= base:
        return -1.0
    half = 0.5 * (base + top)
    # the flank behind the foot has the mean level `base`, below half: one of its samples ends this, so that no place
    # beyond the scan line is asked
    for _ in range(12):
        k -= step
        level = levels[np.uint64(k)]
        if level <= half:
            return k + step * (half - level) / (levels[np.uint64(k + step)] - level)
    return -1.0


@njit(cache=True, error_model="numpy", forceinline=True)
def _edges(values, classes, flanks, peak, limits, span, means, edges):  # type: ignore[no-untyped-def]
    """Height of a peak above the green on both sides, and whether one of them is a dark floor; 0 where there is no
    such green or no edge towards it.

    means (2, 3), edges (2,) are filled with the mean colour of the green and the position of the edge on each side.
    """
    feet, bases, floors = (0, 0), (0.0, 0.0), 0
    for side in range(2):
        foot, base, blue, green, red = _foot(values, classes, flanks, peak, 2 * side - 1, limits, span)
        if foot < 0 and (floors > 0 or not limits.dark_floor):
            return 0.0, False
        floors = floors if foot >= 0 else side + 1
        feet, bases = (feet[1], foot), (bases[1], base)
        means[side, 0], means[side, 1], means[side, 2] = blue, green, red
    if floors > 0:
        side = floors - 1
        foot, base, blue, green, red = _floor(values, flanks, peak, 2 * side - 1, limits, span, means[1 - side])
        if foot < 0:
            return 0.0, False
        feet, bases = ((foot, feet[1]), (base, bases[1])) if side == 0 else ((feet[0], foot), (bases[0], base))
        means[side, 0], means[side, 1], means[side, 2] = blue, green, red
    brighter = max(means[0, 0] + means[0, 1] + means[0, 2], means[1, 0] + means[1, 1] + means[1, 2])
    if feet[1] - feet[0] > limits.max_run:
        return 0.0, False
    if brighter <= limits.carpet.max_sum:  # dark on both sides: robots wear white, too
        return 0.0, False
    for side in range(2):
        edges[side] = _edge(values, feet[side], bases[side], peak, 1 - 2 * side)
    if edges[0] < 0.0 or edges[1] <= edges[0]:
        return 0.0, False
    return values[LEVEL, peak] - max(bases[0], bases[1]), floors > 0


@njit(cache=True, error_model="numpy")
def _looks_white(values, middle, means, toward, least, cosine):  # type: ignore[no-untyped-def]
    """Whether what is added to the green beside it (means (2, 3)) is paint, not a ball's or a marker's colour."""
    k = int(middle)
    dot, size, toward_size = 0.0, 0.0, 0.0
    for c in range(3):
        excess = 0.5 * (values[c, k] + values[c, k + 1]) - max(means[0, c], means[1, c])
        dot += excess * toward[c]
        size += excess * excess
        toward_size += toward[c] * toward[c]
    return dot >= cosine * np.sqrt(size * toward_size) and dot >= least * toward_size


@njit(cache=True, error_model="numpy")
def on_one_line(crossings, reach_m, aside_m, others):  # type: ignore[no-untyped-def]
    """(M,) whether crossings (M, COLUMNS) have carpet on both sides, or lie on one straight line with `others` more
    beside a floor, all within reach_m: a robot's foot does not.
    """
    kept = np.ones(len(crossings), dtype=np.bool_)
    rows = np.flatnonzero(crossings[:, 7] > 0.0)
    for i in rows:
        best = 0
        for j in rows:
            dx, dy = crossings[j, 0] - crossings[i, 0], crossings[j, 1] - crossings[i, 1]
            size = np.hypot(dx, dy)
            if best >= others or not 0.3 * reach_m < size < reach_m:
                continue
            on = 0
            for k in rows:
                ex, ey = crossings[k, 0] - crossings[i, 0], crossings[k, 1] - crossings[i, 1]
                on += k != i and ex * ex + ey * ey < reach_m * reach_m and abs(ex * dy - ey * dx) < aside_m * size
            best = max(best, on)
        kept[i] = best >= others
    return kept


@njit(cache=True)
def keep(rows, kept):  # type: ignore[no-untyped-def]
    """Move the rows (N, C) that are kept (N,) to the front; returns how many there are."""
    count = 0
    for i in range(len(kept)):
        if kept[i]:
            copy_row(rows[i], rows[count])
            count += 1
    return count


@njit(cache=True, error_model="numpy")
def _size2(colour):  # type: ignore[no-untyped-def]
    return colour[0] * colour[0] + colour[1] * colour[1] + colour[2] * colour[2]


@njit(cache=True, error_model="numpy")
def _place(path, found, limits, camera):  # type: ignore[no-untyped-def]
    """Lay profiles on the ground, whose columns 2 and 3 are the edges as samples of the path: fill x, y, u, v and the
    chord of found (M, COLUMNS); (M,) whether a line is so wide.
    """
    pixels, ground, kept = np.empty((2 * len(found), 2)), np.empty((2, 2 * len(found))), np.empty(len(found), np.bool_)
    for i in range(2 * len(found)):
        edge = found[i // 2, 2 + i % 2]
        m = int(edge)
        for a in range(2):
            pixels[i, a] = path[m, a] + (edge - m) * (path[m + 1, a] - path[m, a])
    shifted_ground(pixels, (0.0, 0.0), camera[0], camera[1], camera[2], ground)
    for i in range(len(found)):
        one, other = 2 * i, 2 * i + 1
        chord = np.hypot(ground[0, one] - ground[0, other], ground[1, one] - ground[1, other])
        width_px = np.hypot(pixels[one, 0] - pixels[other, 0], pixels[one, 1] - pixels[other, 1])
        blur = limits.blur_px * chord / width_px
        least = max(limits.min_chord_m - blur, 0.5 * limits.min_chord_m)
        kept[i] = least <= chord <= limits.max_chord_m + blur
        for a in range(2):
            found[i, a] = 0.5 * (ground[a, one] + ground[a, other])
            found[i, 2 + a] = 0.5 * (pixels[one, a] + pixels[other, a])
        found[i, 5] = chord
        found[i, 7] = width_px if found[i, 7] > 0.0 else 0.0
    return kept


@njit(cache=True, error_model="numpy")
def find_line_profiles(path, starts, closed, samples, paint, limits, camera, out):  # type: ignore[no-untyped-def]
    """Green-white-green profiles of all scan lines into out (M, COLUMNS); returns how many.

    path (N, 2), starts, closed: ScanLines. samples: PathSamples. paint: green and white (3,), learned. limits:
    ProfileLimits. camera: constants, bearings, ranges of the OmniCamera's look-up.
    """
    found = _found(starts, closed, samples, _flanks_of(samples.classes), paint, limits, out)
    found = keep(out, _place(path, out[:found], limits, camera))
    return keep(out, on_one_line(out[:found], ROW_M, ROW_ASIDE_M, ROW_POINTS)) if limits.dark_floor else found


@njit(cache=True, error_model="numpy")
def _found(starts, closed, samples, flanks, paint, limits, out):  # type: ignore[no-untyped-def]
    """The profiles, their edges as samples, into columns 2 to 7 of out (M, COLUMNS); returns how many. flanks (N,): as
    of `_flanks_of`, an argument, so that it outlives all that is not counted here.
    """
    values, classes, flanks, count = uncounted(samples.values), uncounted(samples.classes), uncounted(flanks), FLANK
    green, white = paint
    toward = white - green
    means, edges = np.zeros((2, 3)), np.zeros(2)
    levels, fall = values[LEVEL], np.float32(0.5 * limits.min_contrast)
    peaks, found, p, passed = np.empty(len(classes) + 8, np.int32), 0, 0, 0
    for i in range(_peaks(levels, fall, peaks)):
        peak = np.int64(peaks[i])
        while peak >= starts[p + 1]:
            p += 1
        span = (starts[p], starts[p + 1])
        first = span[0] + count
        if peak < max(first, passed) or peak >= span[1] - count or found >= len(out):
            continue
        if classes[peak] == BODY or not _falls(levels, peak, fall, span):
            continue
        height, floor = _edges(values, classes, flanks, peak, limits, span, means, edges)
        if height <= 0.0:
            continue
        brightness = np.sqrt(max(_size2(means[0]), _size2(means[1])) / _size2(green))
        if height < limits.min_contrast * brightness:
            continue
        middle = 0.5 * (edges[0] + edges[1])
        passed = int(edges[1]) + 1
        if closed[p] > 0 and not first <= middle < first + closed[p]:
            continue
        least = 0.7 * limits.min_contrast * brightness
        if not _looks_white(values, middle, means, toward, least, limits.min_cosine):
            continue
        out[found, 2], out[found, 3], out[found, 4] = edges[0], edges[1], height / brightness
        out[found, 6], out[found, 7] = p, edges[1] - edges[0] if floor else 0.0
        found += 1
    return found
