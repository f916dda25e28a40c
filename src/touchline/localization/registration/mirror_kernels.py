"""Numba loops of the joint fit: pose and mirror errors that put the points of one image on the field's lines.

Everywhere: points (N, 2) as seen, robot frame (m), covariances (N, 2, 2) of them; table: the `OffsetTable` of a field;
state (8,): x, y (m), heading (rad) in the field frame, and the five errors of `published/nubot/mirror_fit.py`.

A point p, seen through a mirror with the errors g, c and s of `mirror_fit`, belongs at

    p' = (1 + s) p + C c + G g,     p" = (p' + h² g) / (1 - g·p')

C: what a displaced mirror does, G: what a leaning one does by its surface that moves, both from the `Response` of the
mirror's own shape; as mirrors bend they are taken half way between p and p', with errors that are about right.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from touchline.field.distance_map import lookup
from touchline.field.offset_map import look_up_offset
from touchline.geometry import FloatArray
from touchline.localization.published.nubot.mirror_fit import MIN_DEPTH, SCALE_STEP_M, STATE, inverse

_EXPLAINED2 = 9.0  # squared standard deviations within which a point is one of its line
_MIN_RANGE2_M2 = 0.01
_TINY2_M2 = 1e-12


class StatePrior(NamedTuple):
    """What is known of a state before an image: mean (8,) and inverse covariance (8, 8)."""

    mean: FloatArray
    information: FloatArray


class StateFit(NamedTuple):
    """state (8,) most probable of points and prior; information (8, 8), gradient (8,): of the points alone there.

    explained, noise, log_likelihood: as of `kernels.Fit`, with the image's own errors taken out. contradiction: what
    the prior says against it, in logarithm of a likelihood ratio, by Laplace's approximation: who expects less, and is
    right, gains by it.
    """

    state: FloatArray
    information: FloatArray
    gradient: FloatArray
    explained: float
    noise: float
    log_likelihood: float
    contradiction: float


class _Seen(NamedTuple):
    """An image: points (N, 2), covariances (N, 2, 2), and `_shape` at each (6, N), which is the same in every step."""

    points: FloatArray
    covariances: FloatArray
    shapes: FloatArray


class _Sums(NamedTuple):
    """information (8, 8): sum of u uᵀ / σ² over the points, u the derivative of a point's distance d from its line by
    the state; gradient (8,): that of -u d / σ². rows (11, N): of each point u, d, its weight, and room for its product.
    """

    information: FloatArray
    gradient: FloatArray
    rows: FloatArray


_DISTANCE, _WEIGHT, _BOTH = STATE, STATE + 1, STATE + 2  # of the rows


@numba.njit(cache=True, error_model="numpy", inline="always")
def _parts(px, py, parts):  # type: ignore[no-untyped-def]
    """C and G where the mirror shows a point: xx, xy, yy of either."""
    reach2 = max(px * px + py * py, 1e-9)
    place = min(math.sqrt(reach2) / SCALE_STEP_M, parts.shape[0] - 1.000001)
    i = int(place)
    f = place - i
    across = (1.0 - f) * parts[i, 1] + f * parts[i + 1, 1]
    sideways = (1.0 - f) * parts[i, 3] + f * parts[i + 1, 3]
    oblong = ((1.0 - f) * parts[i, 0] + f * parts[i + 1, 0] - across) / reach2
    bulge = ((1.0 - f) * parts[i, 2] + f * parts[i + 1, 2] - sideways) / reach2
    xx, xy, yy = px * px, px * py, py * py
    return (
        across + oblong * xx, oblong * xy, across + oblong * yy,
        sideways + bulge * xx, bulge * xy, sideways + bulge * yy,
    )  # fmt: skip


@numba.njit(cache=True, error_model="numpy", inline="always")
def _aside(shape, state):  # type: ignore[no-untyped-def]
    """C c + G g."""
    cxx, cxy, cyy, gxx, gxy, gyy = shape
    x = cxx * state[5] + cxy * state[6] + gxx * state[3] + gxy * state[4]
    y = cxy * state[5] + cyy * state[6] + gxy * state[3] + gyy * state[4]
    return x, y


@numba.njit(cache=True, error_model="numpy", inline="always")
def _shape(px, py, state, mirror):  # type: ignore[no-untyped-def]
    """`_parts` half way to where a point belongs by a state (8,)."""
    x, y = _aside(_parts(px, py, mirror.parts), state)
    return _parts(px + 0.5 * x, py + 0.5 * y, mirror.parts)


@numba.njit(cache=True, error_model="numpy", inline="always")
def _upright(px, py, state, shape, square):  # type: ignore[no-untyped-def]
    """A point as a perfect mirror would have seen it, and what its derivatives need; square: of the mirror's height."""
    x, y = _aside(shape, state)
    qx, qy = (1.0 + state[7]) * px + x, (1.0 + state[7]) * py + y
    nearer = 1.0 / max(1.0 - state[3] * qx - state[4] * qy, MIN_DEPTH)
    return (nearer * (qx + square * state[3]), nearer * (qy + square * state[4])), (qx, qy), nearer


@numba.njit(cache=True, error_model="numpy")
def upright_points(points, errors, mirror):  # type: ignore[no-untyped-def]
    """Points (N, 2) as a mirror without errors (5,) would have seen them."""
    state = np.zeros(STATE)
    state[3:] = errors
    out, square = np.empty_like(points), mirror.height_m * mirror.height_m
    for i in range(points.shape[0]):
        px, py = points[i, 0], points[i, 1]
        place, _, _ = _upright(px, py, state, _shape(px, py, state, mirror), square)
        out[i, 0], out[i, 1] = place
    return out


@numba.njit(cache=True, error_model="numpy")
def mean_distance(points, errors, mirror, lines, pose):  # type: ignore[no-untyped-def]
    """Of the points without errors (5,), seen from a pose (x, y, heading), from the lines (m); lines: MapTable."""
    state, square, total = np.zeros(STATE), mirror.height_m * mirror.height_m, 0.0
    state[3:] = errors
    x, y, cosine, sine = pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2])
    for i in range(points.shape[0]):
        px, py = points[i, 0], points[i, 1]
        (bx, by), _, _ = _upright(px, py, state, _shape(px, py, state, mirror), square)
        distance, _, _ = lookup(lines, x + cosine * bx - sine * by, y + sine * bx + cosine * by)
        total += distance
    return total / points.shape[0]


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})  # a product and its sum are one instruction
def _equations(seen, table, state, square, plan, width_m, sums):  # type: ignore[no-untyped-def]
    """`_Sums` at a state, into sums; each point weighs as in `kernels`. Returns explained, noise, log-likelihood,
    those at a width of zero alone.
    """
    points, covariances, shapes = seen
    rows, width2 = sums.rows, width_m * width_m
    cosine, sine = math.cos(state[2]), math.sin(state[2])
    explained = squares = total = log_likelihood = 0.0
    for i in range(points.shape[0]):
        cxx, cxy, cyy = shapes[0, i], shapes[1, i], shapes[2, i]
        gxx, gxy, gyy = shapes[3, i], shapes[4, i], shapes[5, i]
        px, py = points[i, 0], points[i, 1]
        (bx, by), (qx, qy), nearer = _upright(px, py, state, (cxx, cxy, cyy, gxx, gxy, gyy), square)
        ox, oy = look_up_offset(table, state[0] + cosine * bx - sine * by, state[1] + sine * bx + cosine * by)
        d2 = ox * ox + oy * oy + _TINY2_M2
        distance = math.sqrt(d2)
        nx, ny = ox / distance, oy / distance
        rx, ry = cosine * nx + sine * ny, cosine * ny - sine * nx  # the normal in the robot frame
        lx, ly = bx - rx * distance, by - ry * distance
        ratio = (lx * lx + ly * ly + _MIN_RANGE2_M2) / (px * px + py * py + _MIN_RANGE2_M2)
        spread = rx * rx * covariances[i, 0, 0] + 2.0 * rx * ry * covariances[i, 0, 1] + ry * ry * covariances[i, 1, 1]
        variance = min(max(ratio, 0.5), 2.0) * spread + plan.floor_m2
        rows[0, i], rows[1, i], rows[2, i] = nx, ny, ry * bx - rx * by
        outward = rx * bx + ry * by
        mx, my = nearer * (rx + outward * state[3]), nearer * (ry + outward * state[4])  # before the tilt
        rows[3, i] = nearer * (outward * qx + square * rx) + gxx * mx + gxy * my
        rows[4, i] = nearer * (outward * qy + square * ry) + gxy * mx + gyy * my
        rows[5, i] = cxx * mx + cxy * my
        rows[6, i] = cxy * mx + cyy * my
        rows[7, i] = px * mx + py * my
        reach = width2 + plan.gate2 * variance
        kept = reach / (reach + d2)
        kept *= kept
        rows[_DISTANCE, i], rows[_WEIGHT, i] = distance, kept / variance
        if width_m > 0.0:  # on the way there nobody asks how likely it is
            continue
        z2 = d2 / variance
        explained += z2 < _EXPLAINED2
        squares += kept * z2
        total += kept
        log_likelihood += math.log(plan.clutter_per_m + math.exp(-0.5 * z2) / math.sqrt(2.0 * math.pi * variance))
    _add_up(sums)
    return explained / max(points.shape[0], 1), squares / max(total, 1e-9), log_likelihood


@numba.njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
def _add_up(sums):  # type: ignore[no-untyped-def]
    """Matrix and gradient of the rows; any order of adding up will do, that of SIMD instructions, too."""
    matrix, gradient, rows = sums
    both, count = rows[_BOTH], rows.shape[1]
    for a in range(STATE):
        for i in range(count):
            both[i] = rows[_WEIGHT, i] * rows[a, i]
        for b in range(a + 1):
            total = 0.0
            for i in range(count):
                total += both[i] * rows[b, i]
            matrix[a, b] = matrix[b, a] = total
        total = 0.0
        for i in range(count):
            total -= both[i] * rows[_DISTANCE, i]
        gradient[a] = total


@numba.njit(cache=True, error_model="numpy")
def log_determinant(matrix):  # type: ignore[no-untyped-def]
    """Logarithm of the determinant of a positive definite matrix, by elimination."""
    left, log = matrix.copy(), 0.0
    for k in range(len(left)):
        log += math.log(abs(left[k, k]))
        for i in range(k + 1, len(left)):
            factor = left[i, k] / left[k, k]
            for j in range(k + 1, len(left)):
                left[i, j] -= factor * left[k, j]
    return log


@numba.njit(cache=True, error_model="numpy")
def fit_state(points, covariances, table, start, prior, mirror, plan, repeated):  # type: ignore[no-untyped-def]
    """The `StateFit` that a plan's steps come to from a start (8,); so many points (repeated) tell as one."""
    count, square = points.shape[0], mirror.height_m * mirror.height_m
    shapes = np.empty((6, count))
    for i in range(count):
        cxx, cxy, cyy, gxx, gxy, gyy = _shape(points[i, 0], points[i, 1], start, mirror)
        shapes[0, i], shapes[1, i], shapes[2, i] = cxx, cxy, cyy
        shapes[3, i], shapes[4, i], shapes[5, i] = gxx, gxy, gyy
    seen, state = _Seen(points, covariances, shapes), start.copy()
    sums = _Sums(np.empty((STATE, STATE)), np.empty(STATE), np.empty((STATE + 3, count)))
    matrix, gradient, pull = sums.information, sums.gradient, np.empty(STATE)
    for k in range(plan.widths_m.shape[0]):
        _equations(seen, table, state, square, plan, plan.widths_m[k], sums)
        for a in range(STATE):
            pull[a] = gradient[a] / repeated
            for b in range(STATE):
                pull[a] += prior.information[a, b] * (prior.mean[b] - state[b])
        back = inverse(matrix / repeated + prior.information)
        for a in range(STATE):
            for b in range(STATE):
                state[a] += back[a, b] * pull[b]
    explained, noise, log_likelihood = _equations(seen, table, state, square, plan, 0.0, sums)
    information, strain2 = matrix / repeated, 0.0
    for a in range(STATE):
        for b in range(STATE):
            strain2 += prior.information[a, b] * (state[a] - prior.mean[a]) * (state[b] - prior.mean[b])
    narrowed = log_determinant(prior.information + information) - log_determinant(prior.information)
    contradiction = 0.5 * (strain2 + narrowed)
    return StateFit(state, information, gradient / repeated, explained, noise, log_likelihood, contradiction)
