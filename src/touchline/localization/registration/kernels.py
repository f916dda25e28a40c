"""Numba loops of registration: Gauss-Newton steps that put line points on the field's lines.

Everywhere: points (N, 2) robot frame in m, covariances (N, 2, 2) of them in m²; table: the `OffsetTable` of a field;
poses (3,) as x, y (m), heading (rad) in the field frame.
"""

import math
from typing import NamedTuple

import numba
import numpy as np

from touchline.field.offset_map import look_up_offset
from touchline.geometry import FloatArray

_DAMPING = 1.0  # 1/m²: a step along what no line observes; a single point at 0.1 m weighs a hundred times as much
_MIN_RANGE2_M2 = 0.01
_EXPLAINED2 = 9.0  # squared standard deviations within which a point is one of its line
_TINY2_M2 = 1e-12


class Plan(NamedTuple):
    """How one registration goes.

    widths_m (K,): width of the robust kernel beside the points' own noise, of each Gauss-Newton step: wide ones first.
    gate2: squared standard deviations at which a point has half of its influence left. floor_m2: variance that no
    point is free of. clutter_per_m: density of points that are none of a line, against those across a line.
    """

    widths_m: FloatArray
    gate2: float
    floor_m2: float
    clutter_per_m: float


class Fit(NamedTuple):
    """pose (3,), heading not wrapped; information (3, 3): inverse covariance of it by the points alone.

    explained: share of the points within three standard deviations of a line. noise: mean square of the residuals in
    units of the points' noise, clutter left out; about 0.8 of normal ones. log_likelihood: of the points at the pose.
    """

    pose: FloatArray
    information: FloatArray
    explained: float
    noise: float
    log_likelihood: float


class Fits(NamedTuple):
    """`Fit` from each of K starts: poses (K, 3), information (K, 3, 3), the others (K,)."""

    poses: FloatArray
    information: FloatArray
    explained: FloatArray
    noise: FloatArray
    log_likelihoods: FloatArray


@numba.njit(cache=True, error_model="numpy", inline="always")
def _seen_from(points, covariances, i, table, place, floor_m2):  # type: ignore[no-untyped-def]
    """Point i at a place (x, y, cosine, sine): offset from the line (ox, oy), what turning moves along it, d², d² σ².

    σ² is the variance across the line. Noise that grows with the range is that of where the line lies: a point that
    seems nearer by its noise would else weigh more, and shorten every range.
    """
    x, y, cosine, sine = place
    px, py = points[i, 0], points[i, 1]
    turned_x, turned_y = cosine * px - sine * py, sine * px + cosine * py
    ox, oy = look_up_offset(table, x + turned_x, y + turned_y)
    d2 = ox * ox + oy * oy + _TINY2_M2
    rx, ry = cosine * ox + sine * oy, cosine * oy - sine * ox  # the offset in the robot frame
    lx, ly = px - rx, py - ry
    ratio = (lx * lx + ly * ly + _MIN_RANGE2_M2) / (px * px + py * py + _MIN_RANGE2_M2)
    spread = rx * rx * covariances[i, 0, 0] + 2.0 * rx * ry * covariances[i, 0, 1] + ry * ry * covariances[i, 1, 1]
    return ox, oy, oy * turned_x - ox * turned_y, d2, min(max(ratio, 0.5), 2.0) * spread + floor_m2 * d2


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})  # a product and its sum are one instruction
def _step(points, covariances, table, pose, plan, width_m):  # type: ignore[no-untyped-def]
    """The Gauss-Newton step (3,) from a pose, each point weighed by (g / (g + d²))² / variance, g = w² + gate² σ²."""
    place = (pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2]))
    width2 = width_m * width_m
    a00, a01, a02, a11, a12, a22 = _DAMPING, 0.0, 0.0, _DAMPING, 0.0, _DAMPING
    b0 = b1 = b2 = 0.0
    for i in range(points.shape[0]):
        ox, oy, turn, d2, spread = _seen_from(points, covariances, i, table, place, plan.floor_m2)
        reach = width2 * d2 + plan.gate2 * spread  # g d²: one division is enough for the whole weight
        every = reach + d2 * d2
        weight = reach * reach / (every * every * spread)
        a00 += weight * ox * ox
        a01 += weight * ox * oy
        a02 += weight * ox * turn
        a11 += weight * oy * oy
        a12 += weight * oy * turn
        a22 += weight * turn * turn
        weight *= d2
        b0 -= weight * ox
        b1 -= weight * oy
        b2 -= weight * turn
    l00 = math.sqrt(a00)  # Cholesky's factors
    l10, l20 = a01 / l00, a02 / l00
    l11 = math.sqrt(a11 - l10 * l10)
    l21 = (a12 - l20 * l10) / l11
    l22 = math.sqrt(a22 - l20 * l20 - l21 * l21)
    z0 = b0 / l00
    z1 = (b1 - l10 * z0) / l11
    z2 = (b2 - l20 * z0 - l21 * z1) / l22
    dh = z2 / l22
    dy = (z1 - l21 * dh) / l11
    return (z0 - l10 * dy - l20 * dh) / l00, dy, dh


@numba.njit(cache=True, error_model="numpy")
def _descend(points, covariances, table, pose, plan):  # type: ignore[no-untyped-def]
    """Move a pose (3,), in place, by one step of each width."""
    for k in range(plan.widths_m.shape[0]):
        dx, dy, dh = _step(points, covariances, table, pose, plan, plan.widths_m[k])
        pose[0] += dx
        pose[1] += dy
        pose[2] += dh


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})  # a product and its sum are one instruction
def _judged(points, covariances, table, pose, plan):  # type: ignore[no-untyped-def]
    """The `Fit` at a pose."""
    information = np.zeros((3, 3))
    place = (pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2]))
    explained = squares = total = log_likelihood = 0.0
    for i in range(points.shape[0]):
        ox, oy, turn, d2, spread = _seen_from(points, covariances, i, table, place, plan.floor_m2)
        variance = spread / d2
        z2 = d2 / variance
        kept = plan.gate2 / (plan.gate2 + z2)
        kept *= kept
        weight = kept / spread
        information[0, 0] += weight * ox * ox
        information[0, 1] += weight * ox * oy
        information[0, 2] += weight * ox * turn
        information[1, 1] += weight * oy * oy
        information[1, 2] += weight * oy * turn
        information[2, 2] += weight * turn * turn
        explained += z2 < _EXPLAINED2
        squares += kept * z2
        total += kept
        log_likelihood += math.log(plan.clutter_per_m + math.exp(-0.5 * z2) / math.sqrt(2.0 * math.pi * variance))
    information[1, 0], information[2, 0], information[2, 1] = information[0, 1], information[0, 2], information[1, 2]
    count = max(points.shape[0], 1)
    return Fit(pose, information, explained / count, squares / max(total, 1e-9), log_likelihood)


@numba.njit(cache=True, error_model="numpy")
def register(points, covariances, table, start, plan):  # type: ignore[no-untyped-def]
    """The `Fit` that a plan's steps come to from a start (3,)."""
    pose = start.copy()
    _descend(points, covariances, table, pose, plan)
    return _judged(points, covariances, table, pose, plan)


@numba.njit(cache=True, error_model="numpy")
def register_all(points, covariances, table, starts, plan):  # type: ignore[no-untyped-def]
    """`register` from each of starts (K, 3): `Fits`."""
    count = starts.shape[0]
    fits = Fits(starts.copy(), np.empty((count, 3, 3)), np.empty(count), np.empty(count), np.empty(count))
    for k in range(count):
        _descend(points, covariances, table, fits.poses[k], plan)
        one = _judged(points, covariances, table, fits.poses[k], plan)
        fits.information[k] = one.information
        fits.explained[k], fits.noise[k], fits.log_likelihoods[k] = one.explained, one.noise, one.log_likelihood
    return fits
