"""White runs along rays: the distance list of figure 7, each distance to a fraction of a pixel."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.camera.omni import ground_from_pixel
from touchline.geometry import FloatArray
from touchline.types import ImageArray

RUN_COLUMNS = 7  # of a run: x, y (m), u, v (px), rise (grey levels), length on the ground (m), ray
_NEAR_END_PX = 6  # paint's light may vary along a long run: its height is taken near each end


@njit(cache=True)
def _sample_ray(pictures, u0, v0, first_px, du, dv, white, is_green, levels):  # type: ignore[no-untyped-def]
    """Look up one ray, a sample per pixel: masks at the nearest pixel, lightness bilinear; how many are in the image.

    pictures: lines, green, lightness (H, W).
    """
    lines, green, lightness = pictures
    height, width = lines.shape
    for n in range(len(levels)):
        u, v = u0 + (first_px + n) * du, v0 + (first_px + n) * dv
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
def _edge(is_green, levels, end, step, reach, n, inside):  # type: ignore[no-untyped-def]
    """One end of a run: (position of half the height, height, green samples beyond); position -1 if there is none.

    step leads out of the run, whose last `inside` samples tell the paint's level. The level beyond is the darkest of
    `reach` samples.
    """
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
    pictures: tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8], ImageArray],
    rays: FloatArray,
    geometry: FloatArray,
    limits: FloatArray,
    camera: tuple[FloatArray, FloatArray, FloatArray],
    out: FloatArray,
) -> int:
    """Runs of white along rays into out (M, RUN_COLUMNS); returns how many.

    pictures: lines and green (H, W), 0 where there is none; lightness (H, W) uint8. rays (R, 2): unit directions in
    the image. geometry: u0, v0, first and last radius (px). limits: samples beyond a run that are looked at, gap
    within a run (samples), longest run (m), least green samples on each side. camera: constants, bearings, ranges of
    the OmniCamera's look-up.

    A run ends where the lightness falls half way from the paint to the darkest sample beside it, on each side for
    itself. Both ends are taken to the ground, and the point lies midway between them there.
    """
    constants, bearings, ranges = camera
    u0, v0, first_px = geometry[0], geometry[1], geometry[2]
    count = int(geometry[3] - geometry[2]) + 1
    reach, gap, longest_m, least_green = int(limits[0]), int(limits[1]), limits[2], int(limits[3])
    white, is_green, levels = np.zeros(count, np.bool_), np.zeros(count, np.bool_), np.zeros(count)
    inward, outward = np.int64(-1), np.int64(1)  # as literals, they would have `_edge` compiled once for each
    found = 0
    for ray in range(len(rays)):
        du, dv = rays[ray, 0], rays[ray, 1]
        n = _sample_ray(pictures, u0, v0, first_px, du, dv, white, is_green, levels)
        k = 1
        while k < n - 1 and found < len(out):
            if not white[k] or white[k - 1]:  # a run that touches the robot's body has no inner end
                k += 1
                continue
            start, end = k, _end_of_run(white, k, n, gap)
            k = end + 1
            a, rise_a, green_a = _edge(is_green, levels, start, inward, reach, n, end - start + 1)
            b, rise_b, green_b = _edge(is_green, levels, end, outward, reach, n, end - start + 1)
            if a < 0.0 or b <= a or min(green_a, green_b) < least_green:
                continue
            near_px, far_px = first_px + a, first_px + b
            xa, ya = ground_from_pixel(u0 + near_px * du, v0 + near_px * dv, constants, bearings, ranges)
            xb, yb = ground_from_pixel(u0 + far_px * du, v0 + far_px * dv, constants, bearings, ranges)
            length_m = np.hypot(xa - xb, ya - yb)
            if not length_m <= longest_m:  # NaN, too: an end that has no place on the ground
                continue
            middle_px = 0.5 * (near_px + far_px)
            row = out[found]
            row[0], row[1], row[2], row[3] = 0.5 * (xa + xb), 0.5 * (ya + yb), u0 + middle_px * du, v0 + middle_px * dv
            row[4], row[5], row[6] = min(rise_a, rise_b), length_m, ray
            found += 1
    return found
