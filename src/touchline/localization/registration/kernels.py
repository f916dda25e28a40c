"""Numba loops of registration: Gauss-Newton steps that put line points on the field's lines.

Everywhere: points (N, 2) robot frame in m, covariances (N, 2, 2) of them in m²; table: the `OffsetTable` of a field;
poses (3,) as x, y (m), heading (rad) in the field frame.
"""

import math
from typing import NamedTuple

import numba
import numpy as np

from touchline.field.offset_map import CHUNK, Lookup, look_up_offsets, lookup_of
from touchline.geometry import FloatArray
from touchline.localization.camera_errors.base import placed_points
from touchline.matrices import copy_row, uncounted

_DAMPING = 1.0  # 1/m²: a step along what no line observes; a single point at 0.1 m weighs a hundred times as much
MIN_RANGE2_M2 = 0.01  # added to squared ranges: beside the robot they are no measure of noise
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


# rows of CHUNK numbers: of points x, y, covariances, squared distance from the robot
X, Y, XX, XY, YY, RANGE2 = (k * CHUNK for k in range(6))
# and at a pose: place in the field (on the way to it), offset from the line, what turning moves along it, d², d² σ²
_OX, _OY, _TURN, _D2, _SPREAD, _ROOM = (k * CHUNK for k in range(2, 8))


class Points(NamedTuple):
    """rows (C, 6 CHUNK) of size points, and room for what is worked out of one chunk of them."""

    rows: FloatArray
    size: int
    lookup: Lookup
    room: FloatArray


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def points_of(points, covariances, table, room):  # type: ignore[no-untyped-def]
    """Points number by number; what fills the last chunk up lies at the robot and is not counted."""
    count = points.shape[0]
    rows = np.zeros(((count + CHUNK - 1) // CHUNK, 6 * CHUNK))
    for k in range(count, rows.size // 6):  # a slice would take two seconds to compile
        rows[k // CHUNK, RANGE2 + k % CHUNK] = 1.0
    for i in range(count):
        row, k, px, py = rows[i // CHUNK], i % CHUNK, points[i, 0], points[i, 1]
        row[X + k], row[Y + k], row[RANGE2 + k] = px, py, px * px + py * py + MIN_RANGE2_M2
        row[XX + k], row[XY + k], row[YY + k] = covariances[i, 0, 0], covariances[i, 0, 1], covariances[i, 1, 1]
    return Points(rows, count, lookup_of(table), room)


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})  # a product and its sum are one instruction
def _see(row, lookup, room, place, floor_m2):  # type: ignore[no-untyped-def]
    """Fill `room` with a chunk's points at a place (x, y, cosine, sine), in loops that become SIMD instructions.

    σ² is the variance across the line. Noise that grows with the range is that of where the line lies: a point that
    seems nearer by its noise would else weigh more, and shorten every range.
    """
    x, y, cosine, sine = place
    for i in range(CHUNK):
        px, py = row[X + i], row[Y + i]
        room[i], room[CHUNK + i] = x + (cosine * px - sine * py), y + (sine * px + cosine * py)
    look_up_offsets(lookup, room)
    for i in range(CHUNK):
        px, py, ox, oy = row[X + i], row[Y + i], room[_OX + i], room[_OY + i]
        turned_x, turned_y = cosine * px - sine * py, sine * px + cosine * py
        d2 = ox * ox + oy * oy + _TINY2_M2
        rx, ry = cosine * ox + sine * oy, cosine * oy - sine * ox  # the offset in the robot frame
        lx, ly = px - rx, py - ry
        ratio = (lx * lx + ly * ly + MIN_RANGE2_M2) / row[RANGE2 + i]
        spread = rx * rx * row[XX + i] + 2.0 * rx * ry * row[XY + i] + ry * ry * row[YY + i]
        room[_TURN + i], room[_D2 + i] = oy * turned_x - ox * turned_y, d2
        room[_SPREAD + i] = min(max(ratio, 0.5), 2.0) * spread + floor_m2 * d2


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def _step(points, pose, plan, width_m):  # type: ignore[no-untyped-def]
    """The Gauss-Newton step (3,) from a pose, each point weighed by (g / (g + d²))² / variance, g = w² + gate² σ²."""
    place = (pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2]))
    width2, room = width_m * width_m, points.room
    a00, a01, a02, a11, a12, a22 = _DAMPING, 0.0, 0.0, _DAMPING, 0.0, _DAMPING
    b0 = b1 = b2 = 0.0
    for chunk in range(points.rows.shape[0]):
        _see(points.rows[chunk], points.lookup, room, place, plan.floor_m2)
        for i in range(CHUNK):
            d2, spread = room[_D2 + i], room[_SPREAD + i]
            reach = width2 * d2 + plan.gate2 * spread  # g d²: one division is enough for the whole weight
            every = reach + d2 * d2
            room[_SPREAD + i] = reach * reach / (every * every * spread)
        for i in range(min(CHUNK, points.size - chunk * CHUNK)):  # in order: a sum's last bits depend on it
            ox, oy, turn, weight = room[_OX + i], room[_OY + i], room[_TURN + i], room[_SPREAD + i]
            a00 += weight * ox * ox
            a01 += weight * ox * oy
            a02 += weight * ox * turn
            a11 += weight * oy * oy
            a12 += weight * oy * turn
            a22 += weight * turn * turn
            weight *= room[_D2 + i]
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
def _descend(points, pose, plan):  # type: ignore[no-untyped-def]
    """Move a pose (3,), in place, by one step of each width."""
    points, pose = uncounted((points, pose))
    for k in range(plan.widths_m.shape[0]):
        dx, dy, dh = _step(points, pose, plan, plan.widths_m[k])
        pose[0] += dx
        pose[1] += dy
        pose[2] += dh


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def _judged(points, pose, plan):  # type: ignore[no-untyped-def]
    """The `Fit` at a pose."""
    points = uncounted(points)
    information, room = np.zeros((3, 3)), points.room
    place = (pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2]))
    explained = squares = total = log_likelihood = 0.0
    for chunk in range(points.rows.shape[0]):
        _see(points.rows[chunk], points.lookup, room, place, plan.floor_m2)
        for i in range(min(CHUNK, points.size - chunk * CHUNK)):
            ox, oy, turn, d2, spread = room[_OX + i], room[_OY + i], room[_TURN + i], room[_D2 + i], room[_SPREAD + i]
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
            density = math.exp(-0.5 * z2) / math.sqrt(2.0 * math.pi * variance)
            log_likelihood += math.log(plan.clutter_per_m + density)
    information[1, 0], information[2, 0], information[2, 1] = information[0, 1], information[0, 2], information[1, 2]
    count = max(points.size, 1)
    return Fit(pose, information, explained / count, squares / max(total, 1e-9), log_likelihood)


@numba.njit(cache=True, error_model="numpy")
def register(points, covariances, table, start, plan):  # type: ignore[no-untyped-def]
    """The `Fit` that a plan's steps come to from a start (3,)."""
    pose, seen = start.copy(), points_of(points, covariances, table, np.empty(_ROOM))
    _descend(seen, pose, plan)
    return _judged(seen, pose, plan)


@numba.njit(cache=True, error_model="numpy")
def register_placed(points, covariances, errors, response, table, pose, plan):  # type: ignore[no-untyped-def]
    """Move a pose (3,), in place, as `register` does by points as they were seen by a camera with errors (K,); their
    log-likelihood there.
    """
    seen = points_of(placed_points(points, errors, response), covariances, table, np.empty(_ROOM))
    _descend(seen, pose, plan)
    return _judged(seen, pose, plan).log_likelihood


@numba.njit(cache=True, error_model="numpy")
def descend_all(points, covariances, table, starts, plan):  # type: ignore[no-untyped-def]
    """The poses alone (K, 3) that `register` comes to from each of starts (K, 3)."""
    poses, seen = starts.copy(), points_of(points, covariances, table, np.empty(_ROOM))
    for k in range(starts.shape[0]):
        _descend(seen, poses[k], plan)
    return poses


@numba.njit(cache=True, error_model="numpy")
def register_all(points, covariances, table, starts, plan):  # type: ignore[no-untyped-def]
    """`register` from each of starts (K, 3): `Fits`."""
    count, seen = starts.shape[0], points_of(points, covariances, table, np.empty(_ROOM))
    fits = Fits(starts.copy(), np.empty((count, 3, 3)), np.empty(count), np.empty(count), np.empty(count))
    for k in range(count):
        _descend(seen, fits.poses[k], plan)
        one = _judged(seen, fits.poses[k], plan)
        for i in range(3):
            copy_row(one.information[i], fits.information[k, i])
        fits.explained[k], fits.noise[k], fits.log_likelihoods[k] = one.explained, one.noise, one.log_likelihood
    return fits
