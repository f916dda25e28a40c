"""Numba loops of the joint fit: the pose and the errors of the camera that put what one image shows where it belongs.

Line points go to the nearest line, crossings and landmarks to the nearest one of their kind, each with a robust kernel
that begins wide and narrows (as in `kernels`). All of an image shares the errors of its camera, so that they are found
next to the pose, with what was known of both as a prior (an iterated extended Kalman filter: Bell and Cathey 1993).

A state (S,) is x, y (m), heading (rad) in the field frame and the camera's errors (S - 3,); `camera_errors` says
what these do, for the type of `response`. Each thing that is seen gives rows, a derivative by the state, a distance
and a weight: a line point one, a point feature two.
"""

import math
from typing import NamedTuple

import numba
import numpy as np

from touchline.field.association import AssociationTables
from touchline.field.offset_map import OffsetTable, look_up_offset
from touchline.geometry import FloatArray
from touchline.localization.camera_errors.base import fill_rows, place, prepare, terms_at
from touchline.localization.registration.feature_model import PointFeatures, best_place
from touchline.matrices import applied, inverse, log_determinant

_EXPLAINED2 = 9.0  # squared standard deviations within which a point is one of its line
_MIN_RANGE2_M2 = 0.01
_TINY2_M2 = 1e-12
_MAX_STEP = 0.5  # of the pose in one Gauss-Newton step (m, m, rad)


class Seen(NamedTuple):
    """What an image shows, robot frame: line points positions_m (N, 2), covariances_m2 (N, 2, 2), and shares (N,): as
    how many independent ones each counts; noise: ratio of their variances to those that they state. features:
    crossings and landmarks, whose `positions_m` are overwritten by every fit; raw_m (M, 2): those as seen;
    feature_share: of each. line_ratio: share of the points, thinned to cells, that lies on lines of whatever kind;
    crude: whether the others were left out (`line_likeness`).
    """

    positions_m: FloatArray
    covariances_m2: FloatArray
    shares: FloatArray
    noise: float
    features: PointFeatures
    raw_m: FloatArray
    feature_share: float
    line_ratio: float
    crude: bool


class Ground(NamedTuple):
    """What lies where on a field: its lines and its point features."""

    lines: OffsetTable
    places: AssociationTables


class StatePrior(NamedTuple):
    """What is known of a state before an image: mean (S,) and inverse covariance (S, S)."""

    mean: FloatArray
    information: FloatArray


class StateFit(NamedTuple):
    """state (S,) most probable of image and prior; information (S, S), gradient (S,): of the image alone there.

    explained: share of what is seen that lies where it should, of so much: `of`. noise: mean square of the line points'
    residuals in units of their own noise, clutter left out. residual_m: mean distance of what is seen from where it
    belongs. log_likelihood: of all that is seen. contradiction: how much the prior contradicts it, logarithm of a
    likelihood ratio, by Laplace's approximation: who expects less, and is right, gains by it.
    """

    state: FloatArray
    information: FloatArray
    gradient: FloatArray
    explained: float
    of: float
    noise: float
    residual_m: float
    log_likelihood: float
    contradiction: float


class _Sums(NamedTuple):
    """information (S, S): sum of w u uᵀ over the rows, u a derivative by the state; gradient (S,): that of -w u d.
    rows (S + 3, R): of each u, d, w, and room for their product.
    """

    information: FloatArray
    gradient: FloatArray
    rows: FloatArray


# what is counted at the state that is come to
_EXPLAINED, _OF, _SQUARES, _KEPT, _DISTANCE, _LOG_LIKELIHOOD = range(6)


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})  # a product and its sum are one instruction
def _add_points(seen, lines, pose, camera, plan, width_m, rows, counts):  # type: ignore[no-untyped-def]
    """Rows of the line points; counts (6,) or, on the way there, none (0,). camera: its `terms_at` the state, and what
    `prepare` has made of the points.
    """
    terms, prepared = camera
    points, c, width2 = seen.positions_m, seen.covariances_m2, width_m * width_m
    distance_row, weight_row = rows.shape[0] - 3, rows.shape[0] - 2
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    for i in range(points.shape[0]):
        px, py = points[i, 0], points[i, 1]
        bx, by = place(px, py, terms, prepared, i)
        ox, oy = look_up_offset(lines, pose[0] + cosine * bx - sine * by, pose[1] + sine * bx + cosine * by)
        d2 = ox * ox + oy * oy + _TINY2_M2
        distance = math.sqrt(d2)
        nx, ny = ox / distance, oy / distance
        rx, ry = cosine * nx + sine * ny, cosine * ny - sine * nx  # the normal in the robot frame
        # noise that grows with the range is that of where the line lies: a point that seems nearer by its noise would
        # else weigh more, and shorten every range
        lx, ly = bx - rx * distance, by - ry * distance
        ratio = (lx * lx + ly * ly + _MIN_RANGE2_M2) / (px * px + py * py + _MIN_RANGE2_M2)
        spread = rx * rx * c[i, 0, 0] + 2.0 * rx * ry * c[i, 0, 1] + ry * ry * c[i, 1, 1]
        variance = min(max(ratio, 0.5), 2.0) * spread + plan.floor_m2
        # derivatives are those of the line: off it, noise would tell errors that leave every line where it is
        fill_rows(rows, i, i, (rx, ry), ((px, py), (lx, ly)), terms, prepared)
        rows[0, i], rows[1, i], rows[2, i] = nx, ny, ry * bx - rx * by
        reach = width2 + plan.gate2 * variance
        kept = reach / (reach + d2)
        kept *= kept
        rows[distance_row, i], rows[weight_row, i] = distance, seen.shares[i] * kept / (seen.noise * variance)
        if len(counts) == 0:  # on the way there nobody asks how likely it is
            continue
        z2, share = d2 / variance, seen.shares[i]
        counts[_EXPLAINED] += share * (z2 < _EXPLAINED2)
        counts[_OF] += share
        counts[_SQUARES] += kept * z2
        counts[_KEPT] += kept
        counts[_DISTANCE] += share * distance
        density = math.exp(-0.5 * z2) / math.sqrt(2.0 * math.pi * variance)
        counts[_LOG_LIKELIHOOD] += share * math.log(plan.clutter_per_m + density)


@numba.njit(cache=True, error_model="numpy")
def _add_features(seen, tables, pose, camera, width_m, rows, counts):  # type: ignore[no-untyped-def]
    """Rows of crossings and landmarks, each taken for the nearest of its kind; arguments as of `_add_points`."""
    terms, prepared = camera
    points, places, first = seen.features, tables.places_m, seen.positions_m.shape[0]
    distance_row, weight_row = rows.shape[0] - 3, rows.shape[0] - 2
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    turned = (pose[0], pose[1], pose[2], cosine, sine)
    for i in range(seen.raw_m.shape[0]):
        px, py = seen.raw_m[i, 0], seen.raw_m[i, 1]
        bx, by = place(px, py, terms, prepared, i)
        points.positions_m[i, 0], points.positions_m[i, 1] = bx, by
        nearest, least, total = best_place(points, i, tables, False, turned)
        likely, weight, lx, ly, w = 0.0, 0.0, bx, by, points.own_information[i]
        if nearest >= 0:
            dx, dy = places[nearest, 0] - pose[0], places[nearest, 1] - pose[1]
            lx, ly = cosine * dx + sine * dy, cosine * dy - sine * dx
            soft = 1.0 + width_m * width_m * 0.5 * (w[0, 0] + w[1, 1])  # of a wide kernel
            likely = points.peaks[i] * math.exp(-least / soft)
            other = points.peaks[i] * max(total - math.exp(-least), 0.0)
            weight = seen.feature_share * likely / (likely + other + points.floors[i]) / soft
        l00 = math.sqrt(w[0, 0])  # Cholesky's factors whiten both errors
        l10 = w[0, 1] / l00
        for half in range(2):
            row = first + 2 * i + half
            rx, ry = (l00, l10) if half == 0 else (0.0, math.sqrt(max(w[1, 1] - l10 * l10, 0.0)))
            rows[0, row], rows[1, row] = cosine * rx - sine * ry, sine * rx + cosine * ry
            rows[2, row] = ry * lx - rx * ly
            fill_rows(rows, row, i, (rx, ry), ((px, py), (lx, ly)), terms, prepared)
            rows[distance_row, row], rows[weight_row, row] = rx * (bx - lx) + ry * (by - ly), weight
        if len(counts) == 0:
            continue
        right = points.trust[i] * likely / (likely + points.floors[i])
        counts[_EXPLAINED] += right
        counts[_OF] += points.trust[i]
        counts[_DISTANCE] += right * math.hypot(bx - lx, by - ly)
        counts[_LOG_LIKELIHOOD] += seen.feature_share * math.log(points.floors[i] + likely)


@numba.njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
def _add_up(sums):  # type: ignore[no-untyped-def]
    """Matrix and gradient of the rows; any order of adding up will do, that of SIMD instructions, too."""
    matrix, gradient, rows = sums
    states, count = len(gradient), rows.shape[1]
    both = rows[states + 2]
    for a in range(states):
        for i in range(count):
            both[i] = rows[states + 1, i] * rows[a, i]
        for b in range(a + 1):
            total = 0.0
            for i in range(count):
                total += both[i] * rows[b, i]
            matrix[a, b] = matrix[b, a] = total
        total = 0.0
        for i in range(count):
            total -= both[i] * rows[states, i]
        gradient[a] = total


@numba.njit(cache=True, error_model="numpy")
def fit_state(seen, ground, start, prior, response, plan):  # type: ignore[no-untyped-def]
    """The `StateFit` that a plan's steps come to from a start (S,)."""
    states, state, counts = len(start), start.copy(), np.zeros(6)
    of_points, of_features = prepare(seen.positions_m, start[3:], response), prepare(seen.raw_m, start[3:], response)
    count = seen.positions_m.shape[0] + 2 * seen.raw_m.shape[0]
    sums = _Sums(np.empty((states, states)), np.empty(states), np.empty((states + 3, count)))
    matrix, gradient = sums.information, sums.gradient
    for k in range(plan.widths_m.shape[0] + 1):
        last = k == plan.widths_m.shape[0]
        width_m = 0.0 if last else plan.widths_m[k]
        counted = counts if last else counts[:0]
        terms = terms_at(state[3:], response)
        _add_points(seen, ground.lines, state, (terms, of_points), plan, width_m, sums.rows, counted)
        _add_features(seen, ground.places, state, (terms, of_features), width_m, sums.rows, counted)
        _add_up(sums)
        if last:
            break
        pull = gradient + applied(prior.information, prior.mean - state)
        step = applied(inverse(matrix + prior.information), pull)
        step[:3] = np.minimum(np.maximum(step[:3], -_MAX_STEP), _MAX_STEP)
        state += step
    strain = state - prior.mean
    strain2 = (strain * applied(prior.information, strain)).sum()
    narrowed = log_determinant(prior.information + matrix) - log_determinant(prior.information)
    of = max(counts[_OF], 1e-9)
    return StateFit(
        state, matrix, gradient, counts[_EXPLAINED] / of, counts[_OF], counts[_SQUARES] / max(counts[_KEPT], 1e-9),
        counts[_DISTANCE] / of, counts[_LOG_LIKELIHOOD], 0.5 * (strain2 + narrowed),
    )  # fmt: skip
