"""Numba loops of registration for a perspective camera: line points and point features, with the camera's lean.

A state (7,) is x, y (m), heading (rad), field frame; by how much roll and pitch of the camera are more than they are
thought to be (rad); the relative errors of its height and of the angles' tangents that it sees, one over its focal
length. What the camera sees is taken as that of a level camera at the height that it has: a ray is bent to the optical
axis, turned back and meets the ground again (exactly: at 6 m and 2° the first order is 1 m off).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from touchline.field.association import AssociationTables
from touchline.field.offset_map import OffsetTable, look_up_offset
from touchline.geometry import FloatArray
from touchline.localization.particles.feature_model import PointFeatures, best_place

STATES = 7
_EXPLAINED2 = 9.0  # squared standard deviations within which a point is one of its line
_TINY2_M2 = 1e-12
_MAX_STEP = 0.5  # of a state in one Gauss-Newton step


class SeenPoints(NamedTuple):
    """Line points, robot frame: positions_m (N, 2), covariances_m2 (N, 2, 2), shares (N,): how much each counts.

    features: crossings and landmarks; their `positions_m` are overwritten by every registration. raw_m (M, 2): those
    as seen. axis (3,): the optical axis, a unit vector; zeros where it is not known.
    """

    positions_m: FloatArray
    covariances_m2: FloatArray
    shares: FloatArray
    features: PointFeatures
    raw_m: FloatArray
    axis: FloatArray


class Ground(NamedTuple):
    """What lies where: the field's lines and its point features. eye (3,): the camera's x, y and height (m)."""

    lines: OffsetTable
    places: AssociationTables
    eye: FloatArray


class LeanPlan(NamedTuple):
    """widths_m (K,), gate2, floor_m2, clutter_per_m: as of `registration.kernels.Plan`. feature_share: how much a
    crossing or a landmark counts beside the line points that run into it.
    """

    widths_m: FloatArray
    gate2: float
    floor_m2: float
    clutter_per_m: float
    feature_share: float


class Known(NamedTuple):
    """What is known of a state beforehand: mean (7,), information (7, 7), its inverse covariance."""

    mean: FloatArray
    information: FloatArray


class LeanFit(NamedTuple):
    """state (7,), heading not wrapped; information (7, 7) by what is seen alone.

    explained: share of it that lies where it should; of: how much there is of it. residual_m: mean distance of what is
    explained. log_likelihood: of all that is seen, without what was known.
    """

    state: FloatArray
    information: FloatArray
    explained: float
    of: float
    residual_m: float
    log_likelihood: float


@numba.njit(cache=True, error_model="numpy", inline="always")
def _levelled(x, y, state, eye, axis):  # type: ignore[no-untyped-def]
    """A ground point as a camera without a state's errors sees it, from the camera's foot (m)."""
    x, y = x - eye[0], y - eye[1]
    along = x * axis[0] + y * axis[1] - eye[2] * axis[2]
    if along > 0.0:
        wide = 1.0 + state[6]
        bent = along * state[6]
        down = (eye[2] * wide + axis[2] * bent) / eye[2]
        x, y = (x * wide - axis[0] * bent) / down, (y * wide - axis[1] * bent) / down
    c, s = math.cos(state[4]), math.sin(state[4])
    depth = eye[2] * c + x * s
    x, y = (x * c - eye[2] * s) * eye[2] / depth, y * eye[2] / depth
    c, s = math.cos(state[3]), math.sin(state[3])
    depth = eye[2] * c - y * s
    stretch = (1.0 + state[5]) * eye[2] / depth
    return x * stretch, (y * c + eye[2] * s) * stretch


@numba.njit(cache=True, error_model="numpy")
def _row_of(row, nx, ny, x, y, eye, axis):  # type: ignore[no-untyped-def]
    """Derivative (7,) of where a point lies along a normal, robot frame, by the state, into `row`.

    x, y: the levelled point, from the camera's foot. The first two are along the robot's axes.
    """
    h = eye[2]
    row[0], row[1] = nx, ny
    row[2] = ny * (x + eye[0]) - nx * (y + eye[1])
    row[3] = (nx * x * y + ny * (h * h + y * y)) / h
    row[4] = -(nx * (h * h + x * x) + ny * x * y) / h
    row[5] = nx * x + ny * y
    along = max(x * axis[0] + y * axis[1] - h * axis[2], 0.0)
    row[6] = -along * (nx * (axis[0] + x * axis[2] / h) + ny * (axis[1] + y * axis[2] / h))


@numba.njit(cache=True, error_model="numpy", inline="always")
def _add(row, off, weight, normal, right):  # type: ignore[no-untyped-def]
    for a in range(STATES):
        right[a] -= weight * row[a] * off
        for b in range(a + 1):
            normal[a, b] += weight * row[a] * row[b]


@numba.njit(cache=True, error_model="numpy")
def _add_lines(seen, ground, state, plan, width_m, normal, right, judged):  # type: ignore[no-untyped-def]
    """Add the line points to the normal equations, whose position is along the robot's axes.

    judged (5,): explained, of how much, weighted distances (m), their weights, log-likelihood.
    """
    row = np.empty(STATES)
    cosine, sine = math.cos(state[2]), math.sin(state[2])
    eye, c = ground.eye, seen.covariances_m2
    for i in range(seen.positions_m.shape[0]):
        x, y = _levelled(seen.positions_m[i, 0], seen.positions_m[i, 1], state, eye, seen.axis)
        px, py = x + eye[0], y + eye[1]
        ox, oy = look_up_offset(ground.lines, state[0] + cosine * px - sine * py, state[1] + sine * px + cosine * py)
        d2 = ox * ox + oy * oy + _TINY2_M2
        d = math.sqrt(d2)
        nx, ny = (cosine * ox + sine * oy) / d, (cosine * oy - sine * ox) / d
        variance = nx * nx * c[i, 0, 0] + 2.0 * nx * ny * c[i, 0, 1] + ny * ny * c[i, 1, 1] + plan.floor_m2
        gate = width_m * width_m + plan.gate2 * variance
        kept = gate / (gate + d2)
        weight = seen.shares[i] * kept * kept / variance
        _row_of(row, nx, ny, x, y, eye, seen.axis)
        _add(row, d, weight, normal, right)
        z2 = d2 / variance
        density = math.exp(-0.5 * z2) / math.sqrt(2.0 * math.pi * variance)
        inside = seen.shares[i] * (z2 < _EXPLAINED2)
        judged[0] += inside
        judged[1] += seen.shares[i]
        judged[2] += inside * d
        judged[3] += inside
        judged[4] += seen.shares[i] * math.log(plan.clutter_per_m + density)


@numba.njit(cache=True, error_model="numpy")
def _add_features(seen, ground, state, plan, width_m, normal, right, judged):  # type: ignore[no-untyped-def]
    """Add crossings and landmarks, each taken for the nearest of its kind; arguments as of `_add_lines`."""
    row = np.empty(STATES)
    cosine, sine = math.cos(state[2]), math.sin(state[2])
    points, eye, places = seen.features, ground.eye, ground.places.places_m
    pose = (state[0], state[1], state[2], cosine, sine)
    for i in range(seen.raw_m.shape[0]):
        x, y = _levelled(seen.raw_m[i, 0], seen.raw_m[i, 1], state, eye, seen.axis)
        px, py = x + eye[0], y + eye[1]
        points.positions_m[i, 0], points.positions_m[i, 1] = px, py
        place, least, total = best_place(points, i, ground.places, False, pose)
        likely = 0.0
        if place >= 0:
            dx, dy = places[place, 0] - state[0], places[place, 1] - state[1]
            off_x, off_y = px - cosine * dx - sine * dy, py - cosine * dy + sine * dx
            w = points.own_information[i]
            soft = 1.0 + width_m * width_m * 0.5 * (w[0, 0] + w[1, 1])  # of a wide kernel
            likely = points.peaks[i] * math.exp(-least / soft)
            other = points.peaks[i] * max(total - math.exp(-least), 0.0)
            weight = plan.feature_share * likely / (likely + other + points.floors[i]) / soft
            l00 = math.sqrt(w[0, 0])  # Cholesky's factors whiten both errors
            l10 = w[0, 1] / l00
            l11 = math.sqrt(max(w[1, 1] - l10 * l10, 0.0))
            _row_of(row, l00, l10, x, y, eye, seen.axis)
            _add(row, l00 * off_x + l10 * off_y, weight, normal, right)
            _row_of(row, 0.0, l11, x, y, eye, seen.axis)
            _add(row, l11 * off_y, weight, normal, right)
            right_one = points.trust[i] * likely / (likely + points.floors[i])
            judged[0] += right_one
            judged[2] += right_one * math.sqrt(off_x * off_x + off_y * off_y)
            judged[3] += right_one
        judged[1] += points.trust[i]
        judged[4] += plan.feature_share * math.log(points.floors[i] + likely)


@numba.njit(cache=True, error_model="numpy")
def _equations(seen, ground, state, plan, width_m, judged):  # type: ignore[no-untyped-def]
    """Normal equations (7, 7), (7,) in the field frame; fills `judged`."""
    normal, right = np.zeros((STATES, STATES)), np.zeros(STATES)
    judged[:] = 0.0
    _add_lines(seen, ground, state, plan, width_m, normal, right, judged)
    _add_features(seen, ground, state, plan, width_m, normal, right, judged)
    for a in range(STATES):
        for b in range(a):
            normal[b, a] = normal[a, b]
    c, s = math.cos(state[2]), math.sin(state[2])
    for k in range(STATES):
        normal[0, k], normal[1, k] = c * normal[0, k] - s * normal[1, k], s * normal[0, k] + c * normal[1, k]
    for k in range(STATES):
        normal[k, 0], normal[k, 1] = c * normal[k, 0] - s * normal[k, 1], s * normal[k, 0] + c * normal[k, 1]
    right[0], right[1] = c * right[0] - s * right[1], s * right[0] + c * right[1]
    return normal, right


@numba.njit(cache=True, error_model="numpy")
def _solve(matrix, right):  # type: ignore[no-untyped-def]
    """Solve a positive definite matrix (7, 7) by Cholesky's factors, in place: right (7,) becomes the solution."""
    for a in range(STATES):
        for b in range(a + 1):
            total = matrix[a, b]
            for k in range(b):
                total -= matrix[a, k] * matrix[b, k]
            matrix[a, b] = math.sqrt(max(total, 1e-12)) if a == b else total / matrix[b, b]
    for a in range(STATES):
        for k in range(a):
            right[a] -= matrix[a, k] * right[k]
        right[a] /= matrix[a, a]
    for a in range(STATES - 1, -1, -1):
        for k in range(a + 1, STATES):
            right[a] -= matrix[k, a] * right[k]
        right[a] /= matrix[a, a]


@numba.njit(cache=True, error_model="numpy")
def register_leaning(seen, ground, start, known, plan):  # type: ignore[no-untyped-def]
    """The `LeanFit` that a plan's steps come to from a start (7,), beside what is `Known`."""
    state, judged = start.copy(), np.zeros(5)
    for k in range(plan.widths_m.shape[0]):
        normal, right = _equations(seen, ground, state, plan, plan.widths_m[k], judged)
        for a in range(STATES):
            for b in range(STATES):
                right[a] += known.information[a, b] * (known.mean[b] - state[b])
                normal[a, b] += known.information[a, b]
        _solve(normal, right)
        for a in range(STATES):
            state[a] += min(max(right[a], -_MAX_STEP), _MAX_STEP)
    normal, _ = _equations(seen, ground, state, plan, 0.0, judged)
    share = judged[0] / judged[1] if judged[1] > 0.0 else 0.0
    residual = judged[2] / judged[3] if judged[3] > 0.0 else np.nan
    return LeanFit(state, normal, share, judged[1], residual, judged[4])
