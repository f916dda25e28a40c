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
from touchline.field.offset_map import CHUNK, OFFSETS, OffsetTable, look_up_offsets
from touchline.geometry import FloatArray
from touchline.localization.camera_errors.base import (
    COLUMNS,
    MAX_STATES,
    NORMAL,
    PLACED,
    chunks_of,
    fill_all,
    place_all,
    prepare,
    terms_at,
)
from touchline.localization.registration.feature_model import PointFeatures, best_place
from touchline.localization.registration.kernels import MIN_RANGE2_M2, RANGE2, XX, XY, YY, points_of
from touchline.matrices import applied, inverse, log_determinant, uncounted

_EXPLAINED2 = 9.0  # squared standard deviations within which a point is one of its line
_TINY2_M2 = 1e-12
_MAX_STEP = 0.5  # of the pose in one Gauss-Newton step (m, m, rad)


class Seen(NamedTuple):
    """What an image shows, robot frame: line points positions_m (N, 2), covariances_m2 (N, 2, 2), and shares (N,): as
    how many independent ones each counts; noise: ratio of their variances to those that they state. features:
    crossings and landmarks, whose `positions_m` are overwritten by every fit; raw_m (M, 2): those as seen;
    feature_share: of each. crude: whether points that lie on no line of whatever kind were left out
    (`line_likeness`).
    """

    positions_m: FloatArray
    covariances_m2: FloatArray
    shares: FloatArray
    noise: float
    features: PointFeatures
    raw_m: FloatArray
    feature_share: float
    crude: bool

    @property
    def is_one_thing(self) -> bool:
        """Whether it is a crossing or a landmark and nothing else, which may be a false one."""
        return not len(self.positions_m) and len(self.raw_m) == 1


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
_EXPLAINED, _OF, _SQUARES, _KEPT_SUM, _DISTANCE, _LOG_LIKELIHOOD = range(6)


# and of one chunk of points behind what `camera_errors` knows of it: d², σ², what the kernel leaves of each, d
_D2, _VARIANCE, _KEPT, _APART = (COLUMNS + (MAX_STATES + k) * CHUNK for k in range(4))
_L11, _ROOM = _D2, _APART + CHUNK


@numba.njit(
    cache=True, forceinline=True, error_model="numpy", fastmath={"contract"}
)  # a product and its sum are one instruction
def _see(row, lookup, room, pose, camera, plan, width2):  # type: ignore[no-untyped-def]
    """Fill `room` with a chunk of line points, in loops that become SIMD instructions."""
    terms, prepared = camera
    x, y, cosine, sine = pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2])
    place_all(row, room, terms, prepared)
    for i in range(CHUNK):
        bx, by = room[PLACED + i], room[PLACED + CHUNK + i]
        room[i], room[CHUNK + i] = x + cosine * bx - sine * by, y + sine * bx + cosine * by
    look_up_offsets(lookup, room)
    for i in range(CHUNK):
        bx, by, ox, oy = room[PLACED + i], room[PLACED + CHUNK + i], room[OFFSETS + i], room[OFFSETS + CHUNK + i]
        d2 = ox * ox + oy * oy + _TINY2_M2
        distance = math.sqrt(d2)
        nx, ny = ox / distance, oy / distance
        rx, ry = cosine * nx + sine * ny, cosine * ny - sine * nx  # the normal in the robot frame
        # noise that grows with the range is that of where the line lies: a point that seems nearer by its noise would
        # else weigh more, and shorten every range
        lx, ly = bx - rx * distance, by - ry * distance
        ratio = (lx * lx + ly * ly + MIN_RANGE2_M2) / row[RANGE2 + i]
        spread = rx * rx * row[XX + i] + 2.0 * rx * ry * row[XY + i] + ry * ry * row[YY + i]
        variance = min(max(ratio, 0.5), 2.0) * spread + plan.floor_m2
        room[NORMAL + i], room[NORMAL + CHUNK + i] = rx, ry
        # derivatives are those of the line: off it, noise would tell errors that leave every line where it is
        room[PLACED + i], room[PLACED + CHUNK + i] = lx, ly
        room[COLUMNS + i], room[COLUMNS + CHUNK + i], room[COLUMNS + 2 * CHUNK + i] = nx, ny, ry * bx - rx * by
        reach = width2 + plan.gate2 * variance
        kept = reach / (reach + d2)
        room[_D2 + i], room[_VARIANCE + i], room[_KEPT + i], room[_APART + i] = d2, variance, kept * kept, distance
    fill_all(row, room, terms, prepared)


@numba.njit(cache=True, forceinline=True, error_model="numpy", fastmath={"contract"})
def _add_points(seen, points, pose, camera, plan, width_m, rows, counts):  # type: ignore[no-untyped-def]
    """Rows of the line points; counts (6,) or, on the way there, none (0,). camera: its `terms_at` the state, and what
    `prepare` has made of the points.
    """
    seen, points, pose, camera, rows, counts = uncounted((seen, points, pose, camera, rows, counts))
    terms, prepared = camera
    states, room = rows.shape[0] - 3, points.room
    for chunk in range(points.rows.shape[0]):
        first = chunk * CHUNK
        _see(points.rows[chunk], points.lookup, room, pose, (terms, prepared[chunk]), plan, width_m * width_m)
        count = min(CHUNK, points.size - first)
        for a in range(states):
            for i in range(count):
                rows[a, first + i] = room[COLUMNS + a * CHUNK + i]
        for i in range(count):
            rows[states, first + i] = room[_APART + i]
            rows[states + 1, first + i] = seen.shares[first + i] * room[_KEPT + i] / (seen.noise * room[_VARIANCE + i])
        for i in range(count if len(counts) else 0):  # on the way there nobody asks how likely it is
            variance, share, kept = room[_VARIANCE + i], seen.shares[first + i], room[_KEPT + i]
            z2 = room[_D2 + i] / variance
            counts[_EXPLAINED] += share * (z2 < _EXPLAINED2)
            counts[_OF] += share
            counts[_SQUARES] += kept * z2
            counts[_KEPT_SUM] += kept
            counts[_DISTANCE] += share * room[_APART + i]
            density = math.exp(-0.5 * z2) / math.sqrt(2.0 * math.pi * variance)
            counts[_LOG_LIKELIHOOD] += share * math.log(plan.clutter_per_m + density)


@numba.njit(cache=True, error_model="numpy")
def _add_features(seen, tables, room, pose, camera, width_m, rows, counts):  # type: ignore[no-untyped-def]
    """Rows of crossings and landmarks, each taken for the nearest of its kind; arguments as of `_add_points`, and
    `chunks_of` them with the camera.
    """
    seen, tables, room, pose, camera, rows = uncounted((seen, tables, room, pose, camera, rows))
    terms, prepared, chunks = camera
    points, first, states = seen.features, seen.positions_m.shape[0], rows.shape[0] - 3
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    turned = (pose[0], pose[1], pose[2], cosine, sine)
    for chunk in range(chunks.shape[0]):
        begin, row = chunk * CHUNK, first + 2 * chunk * CHUNK
        count = min(CHUNK, seen.raw_m.shape[0] - begin)
        place_all(chunks[chunk], room, terms, prepared[chunk])
        for k in range(count):
            i, bx, by = begin + k, room[PLACED + k], room[PLACED + CHUNK + k]
            points.positions_m[i, 0], points.positions_m[i, 1] = bx, by
            nearest, least, total = best_place(points, i, tables, False, turned)
            likely, weight, lx, ly, w = 0.0, 0.0, bx, by, points.own_information[i]
            if nearest >= 0:
                dx, dy = tables.places_m[nearest, 0] - pose[0], tables.places_m[nearest, 1] - pose[1]
                lx, ly = cosine * dx + sine * dy, cosine * dy - sine * dx
                soft = 1.0 + width_m * width_m * 0.5 * (w[0, 0] + w[1, 1])  # of a wide kernel
                likely = points.peaks[i] * math.exp(-least / soft)
                other = points.peaks[i] * max(total - math.exp(-least), 0.0)
                weight = seen.feature_share * likely / (likely + other + points.floors[i]) / soft
            l00 = math.sqrt(w[0, 0])  # Cholesky's factors whiten both errors
            l10 = w[0, 1] / l00
            l11 = math.sqrt(max(w[1, 1] - l10 * l10, 0.0))
            off_x, off_y = bx - lx, by - ly
            rows[states, row + 2 * k], rows[states, row + 2 * k + 1] = l00 * off_x + l10 * off_y, l11 * off_y
            rows[states + 1, row + 2 * k] = rows[states + 1, row + 2 * k + 1] = weight
            room[PLACED + k], room[PLACED + CHUNK + k] = lx, ly
            room[NORMAL + k], room[NORMAL + CHUNK + k], room[_L11 + k] = l00, l10, l11
            if len(counts):
                right = points.trust[i] * likely / (likely + points.floors[i])
                counts[_EXPLAINED] += right
                counts[_OF] += points.trust[i]
                counts[_DISTANCE] += right * math.hypot(off_x, off_y)
                counts[_LOG_LIKELIHOOD] += seen.feature_share * math.log(points.floors[i] + likely)
        for half in range(2):
            for k in range(count if half else 0):
                room[NORMAL + k], room[NORMAL + CHUNK + k] = 0.0, room[_L11 + k]
            fill_all(chunks[chunk], room, terms, prepared[chunk])
            for k in range(count):
                rx, ry, at = room[NORMAL + k], room[NORMAL + CHUNK + k], row + 2 * k + half
                rows[0, at], rows[1, at] = cosine * rx - sine * ry, sine * rx + cosine * ry
                rows[2, at] = ry * room[PLACED + k] - rx * room[PLACED + CHUNK + k]
                for a in range(3, states):
                    rows[a, at] = room[COLUMNS + a * CHUNK + k]


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
def fit_state(seen, ground, prior, response, plan, state, matrix, gradient):  # type: ignore[no-untyped-def]
    """Move a state (S,), in place, by a plan's steps, and find its information (S, S) and gradient (S,); the rest of
    its `StateFit`.
    """
    states, counts, start = len(state), np.zeros(6), state[3:].copy()
    of_points, of_features = prepare(seen.positions_m, start, response), prepare(seen.raw_m, start, response)
    count = seen.positions_m.shape[0] + 2 * seen.raw_m.shape[0]
    sums = _Sums(matrix, gradient, np.empty((states + 3, count)))
    points = points_of(seen.positions_m, seen.covariances_m2, ground.lines, np.zeros(_ROOM))
    chunks = chunks_of(seen.raw_m)
    for k in range(plan.widths_m.shape[0] + 1):
        last = k == plan.widths_m.shape[0]
        width_m = 0.0 if last else plan.widths_m[k]
        counted = counts if last else counts[:0]
        terms = terms_at(state[3:], response)
        _add_points(seen, points, state, (terms, of_points), plan, width_m, sums.rows, counted)
        _add_features(
            seen, ground.places, points.room, state, (terms, of_features, chunks), width_m, sums.rows, counted
        )
        _add_up(sums)
        if last:
            break
        pull = gradient + applied(prior.information, prior.mean - state)
        step = applied(inverse(matrix + prior.information), pull)
        for i in range(states):
            state[i] += np.minimum(np.maximum(step[i], -_MAX_STEP), _MAX_STEP) if i < 3 else step[i]  # NaN stays
    strain = state - prior.mean
    strain2 = (strain * applied(prior.information, strain)).sum()
    narrowed = log_determinant(prior.information + matrix) - log_determinant(prior.information)
    of = max(counts[_OF], 1e-9)
    noise = counts[_SQUARES] / max(counts[_KEPT_SUM], 1e-9)
    explained, likelihood = counts[_EXPLAINED] / of, counts[_LOG_LIKELIHOOD]
    return explained, counts[_OF], noise, counts[_DISTANCE] / of, likelihood, 0.5 * (strain2 + narrowed)
