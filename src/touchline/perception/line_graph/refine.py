"""Field lines placed by the pixels: profiles across each one, a robust fit through their middles, and its true ends."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from touchline.geometry import FloatArray
from touchline.perception.line_graph.graph import IntArray
from touchline.perception.line_graph.image_plane import ImagePlane, plane_from_pixel, transformed
from touchline.perception.line_graph.lines import fit_line
from touchline.perception.line_graph.profiles import LINE, NO_LINE, OUTSIDE, Pixels, read_profile

_STEP_PX = 6.0  # between profiles
_FEWEST, _MOST = 6, 48
_LEAST_POINTS = 4
_ROUNDS = 3
_OUTLIER_PX = 2.0
_MISSES, _GAP_WIDTHS = 2, 4.0  # so many profiles and line widths in a row without a line: it has ended
_MOST_BEYOND = 60

POINT_COLUMNS = 5
"""Of a point of a line: pixel u, v, the line's number, contrast, width against the expected."""


@njit(cache=True, error_model="numpy")
def refine_line(
    pixels: Pixels, plane: ImagePlane, line: FloatArray, number: int, points: FloatArray, count: int
) -> tuple[float, int]:
    """Place a line (4,) x0, y0, x1, y1 of the image plane by profiles, in place.

    Its points are appended to points (P, POINT_COLUMNS) after `count` rows. Returns the share of profiles that show it,
    0 where it is none, and how many rows there are then.
    """
    focal = plane.lens.pinhole[0]
    length_px = focal * math.hypot(line[2] - line[0], line[3] - line[1])
    steps = min(max(int(length_px / _STEP_PX), _FEWEST), _MOST)
    found, middles = np.empty(5), np.empty((steps + 2 * _MOST_BEYOND, 2))
    pixel = np.empty((len(middles), 4))
    hits, misses, outside = 0, 0, 0
    for k in range(steps):
        share = (k + 0.5) / steps
        shown = _read_at(pixels, plane, line, share, found)
        if shown == LINE:
            middles[hits, 0], middles[hits, 1] = plane_from_pixel(plane.lens, found[0], found[1])
            pixel[hits, 0], pixel[hits, 1], pixel[hits, 2], pixel[hits, 3] = (
                found[0],
                found[1],
                found[4],
                found[2] / found[3],
            )
            hits += 1
        misses += shown == NO_LINE
        outside += shown == OUTSIDE
    if hits < _LEAST_POINTS or hits < misses or hits < 0.4 * steps:
        return 0.0, count
    use = _fit_robustly(middles[:hits], _OUTLIER_PX / focal, line)
    if len(use) < max(_LEAST_POINTS, 0.6 * hits):
        return 0.0, count
    total = hits
    for backward in (True, False):
        total = _extend(pixels, plane, line, length_px, backward, middles, pixel, total)
    use = _fit_robustly(middles[:total], _OUTLIER_PX / focal, line)
    for k in use:
        if count < len(points):
            points[count, 0], points[count, 1] = pixel[k, 0], pixel[k, 1]
            points[count, 2], points[count, 3], points[count, 4] = number, pixel[k, 2], pixel[k, 3]
            count += 1
    return len(use) / (total + misses), count


@njit(cache=True, error_model="numpy")
def _read_at(pixels: Pixels, plane: ImagePlane, line: FloatArray, share: float, found: FloatArray) -> int:
    """The profile at a share of a line's length."""
    dx, dy = line[2] - line[0], line[3] - line[1]
    x, y = line[0] + share * dx, line[1] + share * dy
    gx, gy = transformed(plane.ground, x, y)
    length = math.hypot(dx, dy)
    hx, hy = transformed(plane.ground, x + 1e-3 * dx / length, y + 1e-3 * dy / length)
    tx, ty = hx - gx, hy - gy
    norm = math.hypot(tx, ty)
    if not norm > 0.0:
        return OUTSIDE
    return read_profile(pixels, plane, gx, gy, -ty / norm, tx / norm, found)


@njit(cache=True, error_model="numpy")
def _on_ground(plane: ImagePlane, line: FloatArray, one: float, other: float) -> float:
    """Distance (m) on the ground between two shares of a line's length."""
    dx, dy = line[2] - line[0], line[3] - line[1]
    ax, ay = transformed(plane.ground, line[0] + one * dx, line[1] + one * dy)
    bx, by = transformed(plane.ground, line[0] + other * dx, line[1] + other * dy)
    return math.hypot(bx - ax, by - ay)


@njit(cache=True, error_model="numpy")
def sagitta(points: FloatArray) -> float:
    """By how much points (N, 2) of a line bend, as a share of its length: the middle's distance from the chord."""
    x, y, dx, dy = fit_line(points, np.arange(len(points)))
    along, off = (points[:, 0] - x) * dx + (points[:, 1] - y) * dy, (points[:, 1] - y) * dx - (points[:, 0] - x) * dy
    low, high = along.min(), along.max()
    half = 0.5 * (high - low)
    s = (along - 0.5 * (low + high)) / half
    # least squares of off = a + b (s² - mean s²)
    square = s * s - np.mean(s * s)
    return float(abs(np.sum(square * off) / np.sum(square * square)) / (2.0 * half))


@njit(cache=True, error_model="numpy")
def _fit_robustly(middles: FloatArray, outlier: float, line: FloatArray) -> IntArray:
    """Fit a line to middles (N, 2), those far off left out, into line (4,); returns which were used."""
    use = np.arange(len(middles))
    for _ in range(_ROUNDS):
        x, y, dx, dy = fit_line(middles, use)
        off = np.abs((middles[:, 0] - x) * dy - (middles[:, 1] - y) * dx)
        limit = max(outlier, 2.5 * np.median(off))
        use = np.flatnonzero(off <= limit)
    x, y, dx, dy = fit_line(middles, use)
    if (line[2] - line[0]) * dx + (line[3] - line[1]) * dy < 0.0:
        dx, dy = -dx, -dy
    low, high = np.inf, -np.inf
    for k in use:
        along = (middles[k, 0] - x) * dx + (middles[k, 1] - y) * dy
        low, high = min(low, along), max(high, along)
    line[0], line[1], line[2], line[3] = x + low * dx, y + low * dy, x + high * dx, y + high * dy
    return use


@njit(cache=True, error_model="numpy")
def _extend(pixels, plane, line, length_px, backward, middles, pixel, total):  # type: ignore[no-untyped-def]
    """Profiles beyond an end, until the line has ended; returns how many middles there are then."""
    found = np.empty(5)
    focal, gap_m = plane.lens.pinhole[0], _GAP_WIDTHS * pixels.width_m
    step = _STEP_PX / max(focal * math.hypot(line[2] - line[0], line[3] - line[1]), 1.0)
    missed, hit = 0, 0
    for k in range(1, _MOST_BEYOND):
        shown = _read_at(pixels, plane, line, -k * step if backward else 1.0 + k * step, found)
        if shown == OUTSIDE:
            break
        if shown == LINE:
            missed, hit = 0, k
            middles[total, 0], middles[total, 1] = plane_from_pixel(plane.lens, found[0], found[1])
            pixel[total, 0], pixel[total, 1], pixel[total, 2], pixel[total, 3] = (
                found[0],
                found[1],
                found[4],
                found[2] / found[3],
            )
            total += 1
        else:
            missed += 1
            if (
                missed >= _MISSES
                and _on_ground(
                    plane,
                    line,
                    -hit * step if backward else 1.0 + hit * step,
                    -k * step if backward else 1.0 + k * step,
                )
                > gap_m
            ):
                break
    return total
