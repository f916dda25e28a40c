"""White runs along rays: the distance list of figure 7, each distance to a fraction of a pixel."""

from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.camera.omni import ground_from_pixel
from touchline.geometry import BoolArray, ByteArray, FloatArray
from touchline.types import ImageArray

RUN_COLUMNS = 7  # of a run: x, y (m), u, v (px), rise (grey levels), length on the ground (m), ray
_NEAR_END_PX = 6  # paint's light may vary along a long run: its height is taken near each end


class RayPictures(NamedTuple):
    """What the rays are looked up in: lines and green (H, W), 0 where there is none; lightness (H, W)."""

    lines: ByteArray
    green: ByteArray
    lightness: ImageArray


class Rays(NamedTuple):
    """Rays of samples one pixel apart, from first_px to last_px from the image position u0, v0.

    directions: (R, 2) unit vectors in the image.
    """

    directions: FloatArray
    u0: float
    v0: float
    first_px: float
    last_px: float


class RunLimits(NamedTuple):
    """What a run has to be like: `HsvLineSettings` for this width of the lines.

    flank_px: samples beyond a run that are looked at, min_green of which on each side are green. gap_px: gap within a
    run. max_run_m: its length on the ground.
    """

    flank_px: int
    gap_px: int
    max_run_m: float
    min_green: int


class _RaySamples(NamedTuple):
    """What the pictures show along one ray, (S,) each."""

    white: BoolArray
    is_green: BoolArray
    levels: FloatArray


@njit(cache=True)
def _sample_ray(pictures, rays, ray, samples):  # type: ignore[no-untyped-def]
    """Look up one ray, a sample per pixel: masks at the nearest pixel, lightness bilinear; returns how many
    are in the image.
    """
    lines, green, lightness = pictures
    white, is_green, levels = samples
    height, width = lines.shape
    du, dv = rays.directions[ray, 0], rays.directions[ray, 1]
    for n in range(len(levels)):
        u, v = rays.u0 + (rays.first_px + n) * du, rays.v0 + (rays.first_px + n) * dv
        if not (1.0 <= u <= width - 2.0 and 1.0 <= v <= height - 2.0):
            return n
        row, column = int(v + 0.5), int(u + 0.5)
        white[n], is_green[n] = lines[row, column] != 0, green[row, column] != 0
        j, i = int(u), int(v)
        fu, fv = u - j, v - i
        top = (1.0 - fu) * lightness[i, j] + fu * lightness[i, j + 1]
        bottom = (1.0 - fu) * lightness[i + 1, j] + fu * lightness[i + 1, j + 1]
        levels[n] = (1.0 - fv) * top + fv * bottom
    return len(levels)


@njit(cache=True)
def _end_of_run(white, start, n, gap):  # type: ignore[no-untyped-def]
    """Last white sample of the run that begins at `start`; `gap` samples of something else may lie in it."""
    end, missing = start, 0
    for k in range(start + 1, n):
        if white[k]:
            end, missing = k, 0
        else:
            missing += 1
            if missing > gap:
                break
    return end


@njit(cache=True)
def _edge(samples, n, end, step, reach, inside):  # type: ignore[no-untyped-def]
    """One end of a run: (position of half the height, height, green samples beyond); position -1 if there is none.

    n: samples of the ray. step leads out of the run, whose last `inside` samples tell the paint's level. The level
    beyond is the darkest of `reach` samples.
    """
    is_green, levels = samples.is_green, samples.levels
    peak, darkest, greens = end, np.inf, 0
    for m in range(min(inside, _NEAR_END_PX)):
        if levels[end - step * m] > levels[peak]:
            peak = end - step * m
    for m in range(1, reach + 1):
        k = end + step * m
        if k < 0 or k >= n:
            break
        darkest = min(darkest, levels[k])
        greens += is_green[k]
    half = 0.5 * (levels[peak] + darkest)
    k = peak
    while 0 <= k + step < n and k != end + step * reach:
        if levels[k + step] <= half < levels[k]:
            position = k + step * (levels[k] - half) / (levels[k] - levels[k + step])
            return position, levels[peak] - darkest, greens
        k += step
    return -1.0, 0.0, greens


@njit(cache=True)
def white_runs(
    pictures: RayPictures,
    rays: Rays,
    limits: RunLimits,
    camera: tuple[FloatArray, FloatArray, FloatArray],
    out: FloatArray,
) -> int:
    """Runs of white along rays into out (M, RUN_COLUMNS); returns how many.

    camera: constants, bearings, ranges of the OmniCamera's look-up.

    A run ends where the lightness falls half way from the paint to the darkest sample beside it, on each side for
    itself. Both ends are taken to the ground, and the point lies midway between them there.
    """
    constants, bearings, ranges = camera
    count = int(rays.last_px - rays.first_px) + 1
    samples = _RaySamples(np.zeros(count, np.bool_), np.zeros(count, np.bool_), np.zeros(count))
    white, ends = samples.white, np.zeros((2, 3))
    found = 0
    for ray in range(len(rays.directions)):
        du, dv = rays.directions[ray, 0], rays.directions[ray, 1]
        n = _sample_ray(pictures, rays, ray, samples)
        end = 0
        for start in range(1, n - 1):  # a run that touches the robot's body has no inner end
            if start <= end or not white[start] or white[start - 1] or found == len(out):
                continue
            end = _end_of_run(white, start, n, limits.gap_px)
            rise, greens = np.inf, limits.flank_px
            for side in range(2):
                step, last = 2 * side - 1, (start, end)[side]
                position, height, beyond = _edge(samples, n, last, step, limits.flank_px, end - start + 1)
                ends[side, 0], rise, greens = position, min(rise, height), min(greens, beyond)
            if ends[0, 0] < 0.0 or ends[1, 0] <= ends[0, 0] or greens < limits.min_green:
                continue
            for side in range(2):
                px = rays.first_px + ends[side, 0]
                ends[side, 1], ends[side, 2] = ground_from_pixel(
                    rays.u0 + px * du, rays.v0 + px * dv, constants, bearings, ranges
                )
            length_m = np.hypot(ends[0, 1] - ends[1, 1], ends[0, 2] - ends[1, 2])
            if not length_m <= limits.max_run_m:  # NaN, too: an end that has no place on the ground
                continue
            middle_px = 0.5 * ((rays.first_px + ends[0, 0]) + (rays.first_px + ends[1, 0]))
            row = out[found]
            row[0], row[1] = 0.5 * (ends[0, 1] + ends[1, 1]), 0.5 * (ends[0, 2] + ends[1, 2])
            row[2], row[3] = rays.u0 + middle_px * du, rays.v0 + middle_px * dv
            row[4], row[5], row[6] = rise, length_m, ray
            found += 1
    return found
