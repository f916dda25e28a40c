"""Numba loops of matching: the error function with its derivatives, and RPROP.

Everywhere: points (N, 2) robot frame in m; weights (N,) that sum to 1; table: the `MapTable` of a `DistanceMap`;
poses (3,) as x, y (m), heading (rad) in the field frame; c_m the width of the error function (m).
"""

import math
from typing import NamedTuple

import numba
import numpy as np

from touchline.field.distance_map import lookup
from touchline.geometry import FloatArray


class RpropSchedule(NamedTuple):
    """How RPROP steps: how often, with which first, smallest and largest steps (3,) in m, m, rad, and their factors."""

    iterations: int
    first_steps: FloatArray
    smallest_steps: FloatArray
    largest_steps: FloatArray
    grow: float
    shrink: float


@numba.njit(cache=True)
def error_and_gradient(points, weights, table, pose, c_m):  # type: ignore[no-untyped-def]
    """Mean error of a pose and its derivatives by x, y, heading (Xiong et al., equations 1 and 2).

    e(t) = 1 - c² / (c² + t²), so e'(t) = 2 c² t / (c² + t²)².
    """
    x, y, heading = pose[0], pose[1], pose[2]
    cosine, sine = math.cos(heading), math.sin(heading)
    inverse_c2 = 1.0 / (c_m * c_m)
    error = slope_x = slope_y = slope_heading = 0.0
    for i in range(points.shape[0]):
        px, py = points[i, 0], points[i, 1]
        turned_x = cosine * px - sine * py
        turned_y = sine * px + cosine * py
        d, gx, gy = lookup(table, x + turned_x, y + turned_y)
        k = 1.0 / (1.0 + d * d * inverse_c2)
        slope = weights[i] * k * k * d
        error += weights[i] * (1.0 - k)
        slope_x += slope * gx
        slope_y += slope * gy
        slope_heading += slope * (gy * turned_x - gx * turned_y)
    scale = 2.0 * inverse_c2
    return error, scale * slope_x, scale * slope_y, scale * slope_heading


@numba.njit(cache=True)
def mean_error(points, table, pose, c_m):  # type: ignore[no-untyped-def]
    """Mean error of a pose, all points alike, from the nearest map samples: equation (2), for coarse grids."""
    values, origin_x, origin_y, resolution_m = table
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    inverse_c2 = 1.0 / (c_m * c_m)
    inverse_resolution = 1.0 / resolution_m
    last_x, last_y = float(values.shape[1] - 1), float(values.shape[0] - 1)
    shift_x, shift_y = (pose[0] - origin_x) * inverse_resolution + 0.5, (pose[1] - origin_y) * inverse_resolution + 0.5
    likeness = 0.0
    for i in range(points.shape[0]):
        px, py = points[i, 0] * inverse_resolution, points[i, 1] * inverse_resolution
        fx = shift_x + cosine * px - sine * py
        fy = shift_y + sine * px + cosine * py
        fx = min(fx, last_x) if fx > 0.0 else 0.0  # written so that NaN never becomes an index
        fy = min(fy, last_y) if fy > 0.0 else 0.0
        d = values[np.uint64(int(fy)), np.uint64(int(fx)), 0]
        likeness += 1.0 / (1.0 + d * d * inverse_c2)
    return 1.0 - likeness / points.shape[0]


@numba.njit(cache=True)
def grid_errors(points, table, positions, headings, c_m):  # type: ignore[no-untyped-def]
    """`mean_error` (H, K) of every heading (H,) at every position (K, 2)."""
    errors = np.empty((headings.shape[0], positions.shape[0]))
    pose = np.empty(3)
    for h in range(headings.shape[0]):
        pose[2] = headings[h]
        for k in range(positions.shape[0]):
            pose[0], pose[1] = positions[k, 0], positions[k, 1]
            errors[h, k] = mean_error(points, table, pose, c_m)
    return errors


@numba.njit(cache=True)
def rprop(points, weights, table, start, c_m, schedule, record):  # type: ignore[no-untyped-def]
    """Best pose seen (3,) and its error, of an RPROP descent from start (3,).

    Each parameter has its own step. It moves against the sign of its derivative; the step grows while the sign stays
    and shrinks where it changes (Riedmiller and Braun 1993; Lauer et al. 2006). The variant without a step back
    (Rprop-): on a change of sign the parameter turns round with the shortened step, as in figure 9 of Xiong et al.,
    where the error rises once and the step then shortens. The error comes free with each gradient, so the best pose
    seen is kept, and what a step back would save is not lost.

    schedule: RpropSchedule. record: (iterations + 1, 4), filled with x, y, heading, error of each pose visited, or an
    empty (0, 4) array.
    """
    iterations, first_steps, smallest_steps, largest_steps, grow, shrink = schedule
    pose = start.copy()
    best = start.copy()
    best_error = np.inf
    steps = first_steps.copy()
    before = np.zeros(3)
    gradient = np.zeros(3)
    for iteration in range(iterations + 1):
        error, gradient[0], gradient[1], gradient[2] = error_and_gradient(points, weights, table, pose, c_m)
        if error < best_error:
            best_error = error
            best[0], best[1], best[2] = pose[0], pose[1], pose[2]
        if record.shape[0] > 0:
            record[iteration, 0], record[iteration, 1], record[iteration, 2] = pose[0], pose[1], pose[2]
            record[iteration, 3] = error
        if iteration == iterations:
            break
        for k in range(3):
            agreement = gradient[k] * before[k]
            if agreement > 0.0:
                steps[k] = min(steps[k] * grow, largest_steps[k])
            elif agreement < 0.0:
                steps[k] = max(steps[k] * shrink, smallest_steps[k])
            pose[k] -= np.sign(gradient[k]) * steps[k]
            before[k] = gradient[k]
    return best, best_error
