"""The arms of a crossing: where they meet, and which kind of crossing their directions make."""

import math

import numpy as np
from numba import njit

from touchline.geometry import FloatArray
from touchline.perception.sorting import order_of

STRAIGHT_RAD = math.radians(24.0)
"""Two arms in the whole image that go straight on, or stand at right angles, do so to within this."""


@njit(cache=True, error_model="numpy")
def arms_meet(inner: FloatArray, outer: FloatArray) -> tuple[float, float]:
    """Where the arms of a crossing meet, by least squares: their places on both circles (K, 3: angle, x, y).

    Two arms that lie opposite are one line, which may bend as the centre circle does: a parabola through all four of
    its places leads it past the circles' middle. An arm without an opposite is straight.
    """
    a, b, c, p, q = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(len(inner)):
        other = _opposite(inner, k)
        x, y, dx, dy = inner[k, 1], inner[k, 2], outer[k, 1] - inner[k, 1], outer[k, 2] - inner[k, 2]
        if other >= 0:
            dx, dy = inner[other, 1] - x, inner[other, 2] - y
            near, far = dx**2 + dy**2, (outer[other, 1] - outer[k, 1]) ** 2 + (outer[other, 2] - outer[k, 2]) ** 2
            share = near / (far - near)
            x = 0.5 * ((1.0 + share) * (x + inner[other, 1]) - share * (outer[k, 1] + outer[other, 1]))
            y = 0.5 * ((1.0 + share) * (y + inner[other, 2]) - share * (outer[k, 2] + outer[other, 2]))
        length = math.hypot(dx, dy)
        nx, ny = -dy / length, dx / length
        off = nx * x + ny * y
        a, b, c = a + nx * nx, b + nx * ny, c + ny * ny
        p, q = p + nx * off, q + ny * off
    det = a * c - b * b
    return (c * p - b * q) / det, (a * q - b * p) / det


@njit(cache=True, error_model="numpy")
def _opposite(arms: FloatArray, k: int) -> int:
    """The arm (of K, 3: angle, x, y) that leaves opposite to one of them, -1 without any."""
    found, least = -1, -math.cos(2.0 * STRAIGHT_RAD)
    for m in range(len(arms)):
        cosine = math.cos(arms[m, 0] - arms[k, 0])
        if cosine < least:
            found, least = m, cosine
    return found


@njit(cache=True, error_model="numpy")
def judge_arms(angles_rad: FloatArray, straight_rad: float) -> tuple[int, float]:
    """How many arms (2: L, 3: T, 4: X) the crossing has that leave at these angles, and its orientation (rad).

    straight_rad: to within which they go straight on or stand at right angles. No arms where it is none. Orientation as
    `Crossings` has it: of L the bisector, of T the stem, of X an arm modulo pi/2.
    """
    n = len(angles_rad)
    if n < 2 or n > 4:
        return 0, np.nan
    angles, gaps = np.empty(n), np.empty(n)
    for k in range(n):
        angles[k] = math.atan2(math.sin(angles_rad[k]), math.cos(angles_rad[k]))
    order = order_of(angles)
    smallest, largest = 0, 0
    for k in range(n):
        last = k == n - 1
        gaps[k] = angles[order[0 if last else k + 1]] - angles[order[k]] + (2.0 * math.pi if last else 0.0)
        smallest = k if gaps[k] < gaps[smallest] else smallest
        largest = k if gaps[k] > gaps[largest] else largest
    quarter = 0.5 * math.pi
    if n == 2 and abs(gaps[smallest] - quarter) < straight_rad:
        bisector = angles[order[smallest]] + 0.5 * gaps[smallest]
        return 2, math.atan2(math.sin(bisector), math.cos(bisector))
    if n == 3 and abs(gaps[largest] - math.pi) < straight_rad and gaps[smallest] > quarter - straight_rad:
        return 3, angles[order[(largest + 2) % 3]]  # the stem is the arm between the two small gaps
    if n == 4 and abs(gaps[smallest] - quarter) < straight_rad and abs(gaps[largest] - quarter) < straight_rad:
        s, c = 0.0, 0.0
        for angle in angles:
            s, c = s + math.sin(4.0 * angle), c + math.cos(4.0 * angle)
        return 4, math.atan2(s, c) / 4.0 % quarter
    return 0, np.nan
