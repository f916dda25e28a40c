"""Distances of seen line points to the field's lines, and how they change with the mirror and the pose.

A point at the pixel (u, v) lies rho from the centre, in the direction e. The mirror puts it at the range
r = a tan(b rho) exp(s(rho)), s a cubic spline on even knots, zero to begin with: p = r e. What leans moves it to
(p + h² g) / (1 - g·p) (see `localization/camera_errors/mirror_response`). The pose puts it on the field.

A distance counts in standard deviations: one pixel, seen through the mirror across the line, and the ground's own
uncertainty. Measured in metres alone, a mirror that shrinks the field to a point would fit best.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.field.distance_map import MapTable, lookup
from touchline.field.distances import LineTables, nearest_line_point
from touchline.geometry import FloatArray

CENTER_U, CENTER_V, LOG_SCALE, PER_PX, BEND_X, BEND_Y = range(6)
SHAPE = 6  # parameters of a mirror before the spline's coefficients; a pose's three follow those
HEIGHT_M = 0.75  # of the mirror: MSL robots may be 0.8 m high
STEEPEST_RAD = 1.53  # b rho beyond which the mirror looks at the horizon: 24 times the range at 45 degrees
MIN_DEPTH = 0.2  # of 1 - g·p: beyond it is the horizon
WIDTHS = (20.0, 6.0, 2.5)  # of the robust error (px), one after the other: the first reaches from line to line
GROUND_M = 0.01  # carpets and tape measures
_COARSEST_PX_M = 0.5  # a pixel never counts as more: far points must not be at peace with every line


class Lines(NamedTuple):
    """The field as the loops take it: distances by look-up (the search), or exact (the rest)."""

    exact: bool
    map: MapTable
    tables: LineTables


class Seen(NamedTuple):
    """Line points of one image: pixels (N, 2) u, v; handedness 1 or -1; knot_px: spacing of the spline's knots."""

    pixels: FloatArray
    handedness: float
    knot_px: float


class Noise(NamedTuple):
    """Standard deviation of a point on the ground (m) that comes from no pixel, and the residual (in standard
    deviations) at which a point has lost three quarters of its weight.
    """

    ground_m: float
    width: float


@njit(cache=True)
def spline_weights(radius_px, knot_px, knots, weights):  # type: ignore[no-untyped-def]
    """Fill weights (4,) of the cubic B-spline at a radius; returns the first of the four coefficients."""
    t = radius_px / knot_px
    first = min(max(int(t), 0), knots - 4)
    f = min(max(t - first, 0.0), 1.0)
    weights[0] = (1.0 - f) ** 3 / 6.0
    weights[1] = (3.0 * f**3 - 6.0 * f * f + 4.0) / 6.0
    weights[2] = (-3.0 * f**3 + 3.0 * f * f + 3.0 * f + 1.0) / 6.0
    weights[3] = f**3 / 6.0
    return first


@njit(cache=True)
def spline_slopes(radius_px, knot_px, knots, slopes):  # type: ignore[no-untyped-def]
    """As `spline_weights`, of the derivative by the radius (1/px)."""
    t = radius_px / knot_px
    first = min(max(int(t), 0), knots - 4)
    f = min(max(t - first, 0.0), 1.0)
    slopes[0] = -((1.0 - f) ** 2) / 2.0 / knot_px
    slopes[1] = (9.0 * f * f - 12.0 * f) / 6.0 / knot_px
    slopes[2] = (-9.0 * f * f + 6.0 * f + 3.0) / 6.0 / knot_px
    slopes[3] = f * f / 2.0 / knot_px
    return first


@njit(cache=True)
def equations(seen, states, lines, noise):  # type: ignore[no-untyped-def]
    """Of states (S, P) and one image: mean robust errors (S,), 0 to 1, matrices (S, P, P) and vectors (S, P) of
    Gauss-Newton steps.

    A state: the mirror's parameters, K spline coefficients, the pose x, y (m), heading (rad). The error is Geman's and
    McClure's e²/(width² + e²); matrix and vector are those of half its sum, times width²: one pixel counts 1.
    """
    pixels, handedness, knot_px = seen
    count, size = states.shape
    errors, matrices, vectors = np.zeros(count), np.zeros((count, size, size)), np.zeros((count, size))
    row = np.zeros(size)
    weights, slopes = np.zeros(4), np.zeros(4)
    for j in range(count):
        matrix, vector = matrices[j], vectors[j]
        for i in range(len(pixels)):
            d, sigma, _, _ = residual(pixels[i], handedness, knot_px, states[j], lines, noise, (row, weights, slopes))
            share = 0.0
            if sigma > 0.0:
                share = 1.0 / (1.0 + (d / (sigma * noise.width)) ** 2)
                weight = (share / sigma) ** 2
                for k in range(size):
                    if row[k] != 0.0:
                        part = weight * row[k]
                        vector[k] += part * d
                        for m in range(k + 1):
                            matrix[k, m] += part * row[m]
            errors[j] += (1.0 - share) / len(pixels)
        for k in range(size):
            for m in range(k):
                matrix[m, k] = matrix[k, m]
    return errors, matrices, vectors


@njit(cache=True)
def residual(pixel, handedness, knot_px, state, lines, noise, work):  # type: ignore[no-untyped-def]
    """Distance (m) of a point to the nearest line, its standard deviation (m), and where the point lies (m, field
    frame). Beyond the horizon the deviation is -1. Fills work[0] (P,), the distance's derivative by the state.
    """
    row, weights, slopes = work
    knots = len(row) - SHAPE - 3
    du, dv = pixel[0] - state[CENTER_U], pixel[1] - state[CENTER_V]
    rho = math.sqrt(du * du + dv * dv) + 1e-9
    turn = state[PER_PX] * rho
    if turn > STEEPEST_RAD:
        return 0.0, -1.0, 0.0, 0.0
    tangent = math.tan(turn)
    steep = 1.0 + tangent * tangent
    r = math.exp(state[LOG_SCALE]) * tangent
    growth = state[PER_PX] * steep / tangent  # of log r with rho
    if knots > 0:
        first = spline_weights(rho, knot_px, knots, weights)
        spline_slopes(rho, knot_px, knots, slopes)
        bulge = 0.0
        for k in range(4):
            bulge += weights[k] * state[SHAPE + first + k]
            growth += slopes[k] * state[SHAPE + first + k]
        r *= math.exp(bulge)
    eu, ev = du / rho, dv / rho
    px, py = r * eu, handedness * r * ev
    gx, gy = state[BEND_X], state[BEND_Y]
    depth = 1.0 - gx * px - gy * py
    if depth < MIN_DEPTH:
        return 0.0, -1.0, 0.0, 0.0
    x = (px + HEIGHT_M * HEIGHT_M * gx) / depth
    y = (py + HEIGHT_M * HEIGHT_M * gy) / depth
    c, s = math.cos(state[-1]), math.sin(state[-1])
    field_x, field_y = state[-3] + c * x - s * y, state[-2] + s * x + c * y
    d, nx, ny = _nearest(lines, field_x, field_y)
    mx, my = c * nx + s * ny, c * ny - s * nx  # the line's normal in the robot frame
    along = x * mx + y * my
    ax, ay = (mx + along * gx) / depth, (my + along * gy) / depth  # ... before the bend
    outward = eu * ax + ev * handedness * ay
    qu = r * growth * eu * outward + r / rho * (ax - eu * outward)
    qv = r * growth * ev * outward + r / rho * (handedness * ay - ev * outward)
    row[CENTER_U], row[CENTER_V] = -qu, -qv
    row[LOG_SCALE] = r * outward
    row[PER_PX] = r * outward * rho * steep / tangent
    row[BEND_X] = (along * px + HEIGHT_M * HEIGHT_M * mx) / depth
    row[BEND_Y] = (along * py + HEIGHT_M * HEIGHT_M * my) / depth
    row[SHAPE:] = 0.0
    if knots > 0:
        for k in range(4):
            row[SHAPE + first + k] = weights[k] * r * outward
    row[-3], row[-2] = nx, ny
    row[-1] = nx * (-s * x - c * y) + ny * (c * x - s * y)
    pixel_m = math.sqrt(qu * qu + qv * qv) / max(math.sqrt(nx * nx + ny * ny), 1e-6)
    return d, math.sqrt(min(pixel_m, _COARSEST_PX_M) ** 2 + noise.ground_m**2), field_x, field_y


@njit(cache=True)
def _nearest(lines, x, y):  # type: ignore[no-untyped-def]
    """Distance (m) to the nearest line and the direction away from it."""
    if not lines.exact:
        return lookup(lines.map, x, y)
    d, line_x, line_y = nearest_line_point(lines.tables, x, y)
    if d < 1e-9:
        return 0.0, 0.0, 0.0
    return d, (x - line_x) / d, (y - line_y) / d


@njit(cache=True)
def linearised(seen, state, lines, noise):  # type: ignore[no-untyped-def]
    """Distances (N,) of points to the nearest line (m), their derivatives (N, P) by the state, standard deviations (N,)
    (m), and places (N, 2) (m, field frame). Beyond the horizon the deviation is infinite.
    """
    pixels, handedness, knot_px = seen
    row = np.zeros(len(state))
    weights, slopes = np.zeros(4), np.zeros(4)
    rows, places = np.zeros((len(pixels), len(state))), np.zeros((len(pixels), 2))
    distances, sigmas = np.zeros(len(pixels)), np.full(len(pixels), np.inf)
    for i in range(len(pixels)):
        d, sigma, x, y = residual(pixels[i], handedness, knot_px, state, lines, noise, (row, weights, slopes))
        if sigma < 0.0:
            continue
        rows[i], distances[i], sigmas[i] = row, d, sigma
        places[i, 0], places[i, 1] = x, y
    return distances, rows, sigmas, places
