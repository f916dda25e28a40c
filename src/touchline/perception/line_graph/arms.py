"""The arms of a crossing: where they meet, and which kind of crossing their directions make."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from touchline.geometry import FloatArray
from touchline.perception.line_graph.sorting import order_of

_STRAIGHT_RAD = math.radians(24.0)  # two arms that go straight on, or stand at right angles, do so to within this


@njit(cache=True, error_model="numpy")
def arms_meet(inner: FloatArray, outer: FloatArray) -> tuple[float, float]:
    """Where the lines through each arm's places on both circles (K, 3: angle, x, y) meet, by least squares."""
    a, b, c, p, q = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(len(inner)):
        dx, dy = outer[k, 1] - inner[k, 1], outer[k, 2] - inner[k, 2]
        length = math.hypot(dx, dy)
        nx, ny = -dy / length, dx / length
        off = nx * inner[k, 1] + ny * inner[k, 2]
        a, b, c = a + nx * nx, b + nx * ny, c + ny * ny
        p, q = p + nx * off, q + ny * off
    det = a * c - b * b
    return (c * p - b * q) / det, (a * q - b * p) / det


@njit(cache=True, error_model="numpy")
def judge_arms(angles_rad: FloatArray) -> tuple[int, float]:
    """How many arms (2: L, 3: T, 4: X) the crossing has that leave at these angles, and its orientation (rad).

    No arms where it is none. Orientation as `Crossings` has it: of L the bisector, of T the stem, of X an arm modulo
    pi/2.
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
    if n == 2 and abs(gaps[smallest] - quarter) < _STRAIGHT_RAD:
        bisector = angles[order[smallest]] + 0.5 * gaps[smallest]
        return 2, math.atan2(math.sin(bisector), math.cos(bisector))
    if n == 3 and abs(gaps[largest] - math.pi) < _STRAIGHT_RAD and gaps[smallest] > quarter - _STRAIGHT_RAD:
        return 3, angles[order[(largest + 2) % 3]]  # the stem is the arm between the two small gaps
    if n == 4 and abs(gaps[smallest] - quarter) < _STRAIGHT_RAD and abs(gaps[largest] - quarter) < _STRAIGHT_RAD:
        s, c = 0.0, 0.0
        for angle in angles:
            s, c = s + math.sin(4.0 * angle), c + math.cos(4.0 * angle)
        return 4, math.atan2(s, c) / 4.0 % quarter
    return 0, np.nan
