"""Poses, sizes of the field and what the camera is wrong by, fitted together to the line points of many places.

All sizes and all distances by the same factor look alike: nothing but the camera's ranges tells how long a metre is. So
a common scale is taken as the camera's, and a size counts as otherwise only if the others are not. Most sizes are what
the rules say; a few are decimetres off. That is Cauchy's prior, and it is what parts a wrong size from a wrong scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from touchline.calibration.field_sizes.sizes import FieldSizes, line_velocities, round_lines
from touchline.field import FieldModel
from touchline.field.distances import arc_sweep
from touchline.geometry import FloatArray, wrap_angles

HEIGHT_M = 0.75  # of the mirror: its lean moves the ground by height² times the bend
BEND_PER_M, SHAKE_PER_M = 0.015, 0.005  # standard deviations of the bend: of the head, and from image to image
USUAL_SCALE = 0.01  # of a scale of all ranges, where nobody has said how sure they are
CURVE = 0.005  # of that scale's change from 3 m to 6 m
CURVE_AT_M = 3.0
RULES_M = 0.01  # half of all sizes are this near to the rules, by tape; the tails are long
MAX_M = 0.6  # a size that is farther from the rules is another field's: lines are not told apart beyond
WIDE_M = 0.3  # standard deviation of a size in the first steps
WIDTHS_M = (0.4, 0.4, 0.3, 0.3, 0.2, 0.2, 0.15, 0.15, 0.15, 0.15, 0.15, 0.15)  # of the robust weights, step by step
REPEATED = 3.0  # neighbours on a line err together
FLOOR_M = 0.008  # of a point: carpet and paint
_CAMERA = 4  # common parameters before the sizes: bend (2), scale, curve
_WIDE_STEPS = 4
_SCALES, _ROUNDS, _HELD = 49, 10, 1e11  # scales that are tried, and steps with each of them held
_NOTHING = 1e-3  # share of what is said of a size that is not its prior: less than this is nothing
_OWN = 5  # parameters of a place: x, y, heading, and its own bend


class Place(NamedTuple):
    """Points (N, 2) in m, robot frame, their standard deviations (N,) in m, and the pose (3,) they were seen from."""

    points: FloatArray
    deviations: FloatArray
    pose: FloatArray


class SizeFit(NamedTuple):
    """change_m, deviation_m (J,): by how much each size is larger, what it itself says; infinite where nothing tells.

    scale, scale_deviation: by what share the camera's ranges are too short. poses (M, 3). residuals_m: of all points.
    """

    change_m: FloatArray
    deviation_m: FloatArray
    scale: float
    scale_deviation: float
    poses: FloatArray
    residuals_m: FloatArray


class _Sums(NamedTuple):
    """Normal equations of the common parameters with the places' own eliminated, and each place's part (M, K)."""

    matrix: FloatArray
    vector: FloatArray
    parts: FloatArray
    own_steps: list[tuple[FloatArray, FloatArray]]
    residuals_m: FloatArray


def fit_sizes(places: Sequence[Place], sizes: FieldSizes, scale: float = USUAL_SCALE) -> SizeFit:
    """Fit places and sizes from poses that are close on the field as the rules say.

    scale: standard deviation of a common scale of all ranges.
    """
    camera = np.array([BEND_PER_M, BEND_PER_M, scale, CURVE])
    count = len(sizes.sizes)
    common = np.zeros(_CAMERA + count)
    own = np.array([[*place.pose, 0.0, 0.0] for place in places])
    repeated = REPEATED
    for k, width_m in enumerate((*WIDTHS_M, *WIDTHS_M[-4:])):
        sums = _sums(places, sizes, common, own, width_m)
        if k == len(WIDTHS_M):
            repeated = max(REPEATED, _disagreement(sums, _prior(common, camera, wide=False)))
        step = _best_common(sums, common, camera, repeated, wide=k < _WIDE_STEPS) - common
        step[_CAMERA:] = np.clip(common[_CAMERA:] + step[_CAMERA:], -MAX_M, MAX_M) - common[_CAMERA:]
        common = common + step
        for i, (solved, slope) in enumerate(sums.own_steps):
            own[i] += solved - slope @ step
    sums = _sums(places, sizes, common, own, WIDTHS_M[-1])
    modes = _modes(sums.matrix / repeated, (sums.matrix @ common + sums.vector) / repeated, common, camera)
    chances = np.exp(np.min(modes.costs) - modes.costs)
    chances /= chances.sum()
    change = chances @ modes.change_m
    variances = chances @ (modes.variance_m2 + (modes.change_m - change) ** 2)
    mean = float(chances @ modes.scales)
    mean_deviation = float(np.sqrt(chances @ (modes.scales - mean) ** 2))
    return SizeFit(change, np.sqrt(variances), mean, mean_deviation, own[:, :3], sums.residuals_m)


class _Modes(NamedTuple):
    """For each scale (S,): the cost (S,), and what the sizes (S, J) themselves say there, with variances."""

    scales: FloatArray
    costs: FloatArray
    change_m: FloatArray
    variance_m2: FloatArray
    common: FloatArray


def _modes(matrix: FloatArray, vector: FloatArray, common: FloatArray, camera: FloatArray) -> _Modes:
    """What suits matrix @ common = vector and the prior best, for scales all over what the camera may be wrong by.

    Cauchy's prior has several minima: a wrong scale with many wrong sizes, for one wrong size. Each counts.
    """
    scales = camera[2] * np.linspace(-3.0, 3.0, _SCALES)
    held = np.zeros_like(matrix)
    held[2, 2] = _HELD
    costs, changes, variances, states = [], [], [], []
    for scale in scales:
        found = common.copy()
        found[_CAMERA:] *= 3.0  # a size that is near to the rules would stay there
        for _ in range(_ROUNDS):
            prior = _prior(found, camera, wide=False)
            found = np.linalg.solve(matrix + prior + held, vector + held[:, 2] * scale)
        wrong = found[:_CAMERA] / camera
        cost = 0.5 * found @ matrix @ found - vector @ found + 0.5 * wrong @ wrong
        costs.append(cost + float(np.sum(np.log1p((found[_CAMERA:] / RULES_M) ** 2))))
        prior = _prior(found, camera, wide=False)
        spread = np.diag(np.linalg.inv(matrix + prior + held))
        own_say = np.maximum(1.0 - np.diag(prior) * spread, _NOTHING)[_CAMERA:]  # without a size's own prior
        changes.append(found[_CAMERA:] / own_say)
        variances.append(np.where(own_say > _NOTHING, spread[_CAMERA:] / own_say, np.inf))
        states.append(found)
    return _Modes(scales, np.array(costs), np.array(changes), np.array(variances), np.array(states))


def _best_common(sums: _Sums, common: FloatArray, camera: FloatArray, repeated: float, wide: bool) -> FloatArray:
    """The common parameters that suit the equations and the prior best."""
    matrix = sums.matrix / repeated
    vector = matrix @ common + sums.vector / repeated
    if wide:
        return np.asarray(np.linalg.solve(matrix + _prior(common, camera, wide), vector))
    modes = _modes(matrix, vector, common, camera)
    return np.asarray(modes.common[int(np.argmin(modes.costs))])


def _prior(common: FloatArray, camera: FloatArray, wide: bool) -> FloatArray:
    """Inverse variances of the common parameters, as a matrix: camera's (4,), and Cauchy's for sizes as they are."""
    weights = np.empty(len(common))
    weights[:_CAMERA] = 1.0 / camera**2
    if wide:
        weights[2] = _HELD  # all sizes and the scale together fit as well
    weights[_CAMERA:] = WIDE_M**-2.0 if wide else 2.0 / (RULES_M**2 + common[_CAMERA:] ** 2)
    return np.diag(weights)


def _disagreement(sums: _Sums, prior: FloatArray) -> float:
    """How much more the places' parts differ from each other than their points' noise says: Huber's sandwich."""
    if len(sums.parts) < 4:
        return 2.0 * REPEATED
    inverse = np.linalg.inv(sums.matrix + prior)
    told = inverse @ (sums.parts.T @ sums.parts) @ inverse
    expected = np.maximum(np.diag(inverse @ sums.matrix @ inverse), 1e-12)[_CAMERA:]
    return float(np.max(np.diag(told)[_CAMERA:] / expected))


def _sums(places: Sequence[Place], sizes: FieldSizes, common: FloatArray, own: FloatArray, width_m: float) -> _Sums:
    field = sizes.field(common[_CAMERA:])
    segments, rounds = line_velocities(sizes, common[_CAMERA:])
    size = len(common)
    matrix, vector = np.zeros((size, size)), np.zeros(size)
    parts, own_steps, residuals = [], [], []
    own_prior = np.diag([1e-6, 1e-6, 1e-6, SHAKE_PER_M**-2.0, SHAKE_PER_M**-2.0])
    for place, state in zip(places, own, strict=True):
        rows, distances, on_line = _rows(place, state, common, field, (segments, rounds))
        weights = (width_m**2 / (width_m**2 + distances**2)) ** 2 / (place.deviations**2 + FLOOR_M**2)
        weights[~on_line] = 0.0
        weighted = rows * weights[:, np.newaxis]
        whole, right = weighted.T @ rows, -weighted.T @ distances
        mine = whole[:_OWN, :_OWN] + own_prior
        value = right[:_OWN] - own_prior @ state
        solved = np.linalg.solve(mine, np.column_stack((value, whole[:_OWN, _OWN:])))
        own_steps.append((solved[:, 0], solved[:, 1:]))
        part = right[_OWN:] - whole[_OWN:, :_OWN] @ solved[:, 0]
        matrix += whole[_OWN:, _OWN:] - whole[_OWN:, :_OWN] @ solved[:, 1:]
        vector += part
        parts.append(part)
        residuals.append(np.abs(distances))
    return _Sums(matrix, vector, np.array(parts), own_steps, np.concatenate(residuals))


def _rows(
    place: Place, state: FloatArray, common: FloatArray, field: FieldModel, velocities: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray, npt.NDArray[np.bool_]]:
    """Derivatives (N, 5 + K) of the signed distances (N,) in m, those, and which points have a line at all."""
    seen = place.points
    bend = common[:2] + state[3:]
    far = np.hypot(seen[:, 0], seen[:, 1])
    stretch = 1.0 + common[2] + common[3] * (far / CURVE_AT_M - 1.0) + seen @ bend
    ground = seen * stretch[:, np.newaxis] + HEIGHT_M**2 * bend
    c, s = np.cos(state[2]), np.sin(state[2])
    turn = np.array([[c, -s], [s, c]])
    placed = ground @ turn.T + state[:2]
    distances, normals, moves = nearest_lines(field, placed, velocities)
    inward = normals @ turn  # in the robot frame
    radial = (inward * seen).sum(axis=1)
    by_bend = radial[:, np.newaxis] * seen + HEIGHT_M**2 * inward
    by_heading = inward[:, 1] * ground[:, 0] - inward[:, 0] * ground[:, 1]
    on_line = np.isfinite(distances)
    # a distance counts in the cloud's own measure: a smaller cloud has smaller distances and fits no better
    by_scale = radial - np.where(on_line, distances, 0.0)
    by_curve = by_scale * (far / CURVE_AT_M - 1.0)
    rows = np.column_stack((normals, by_heading, by_bend, by_bend, by_scale, by_curve, -moves))
    return rows, np.where(on_line, distances, 1.0), on_line


def nearest_lines(
    field: FieldModel, placed: FloatArray, velocities: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of points (N, 2) the signed distance (N,) from the nearest line, its normal (N, 2), and how far (N, J) the line

    moves along that normal with each size. Beyond a line's end, and at arcs, which no size
    describes well enough, the distance is NaN.
    """
    a, step = field.segments[:, :2], field.segments[:, 2:] - field.segments[:, :2]
    squares = np.sum(step**2, axis=1)
    share = np.clip(((placed[:, np.newaxis] - a) * step).sum(axis=2) / squares, 0.0, 1.0)
    feet = a + share[..., np.newaxis] * step
    off = placed[:, np.newaxis] - feet
    to_segments = np.hypot(off[..., 0], off[..., 1])
    rounds = round_lines(field)
    outward = placed[:, np.newaxis] - rounds[:, :2]
    reach = np.maximum(np.hypot(outward[..., 0], outward[..., 1]), 1e-9)
    to_rounds = np.where(_beside(field, outward), np.abs(reach - rounds[:, 2]), np.inf)
    best = np.argmin(np.column_stack((to_segments, to_rounds)), axis=1)
    n, rows = len(field.segments), np.arange(len(placed))
    straight = best < n
    k = np.where(straight, best, 0)
    lateral = np.column_stack((-step[k, 1], step[k, 0])) / np.sqrt(squares[k])[:, np.newaxis]
    at = share[rows, k][:, np.newaxis]
    moves = velocities[0][:, k, :2] * (1.0 - at) + velocities[0][:, k, 2:] * at  # (J, N, 2)
    distances, normals = (off[rows, k] * lateral).sum(axis=1), lateral
    moved = np.einsum("jnd,nd->nj", moves, normals)
    if len(rounds):
        m = np.where(straight, 0, best - n)
        away = outward[rows, m] / reach[rows, m][:, np.newaxis]
        turned = np.einsum("jnd,nd->nj", velocities[1][:, m, :2], away) + velocities[1][:, m, 2].T
        distances = np.where(straight, distances, reach[rows, m] - rounds[m, 2])
        normals = np.where(straight[:, np.newaxis], normals, away)
        moved = np.where(straight[:, np.newaxis], moved, turned)
    beyond = straight & (to_segments[rows, k] > np.abs(distances) + 1e-3)  # past an end: of no line's sideways place
    of_arc = best >= n + len(field.circles)
    return np.where(beyond | of_arc, np.nan, distances), normals, moved


def _beside(field: FieldModel, outward: FloatArray) -> npt.NDArray[np.bool_]:
    """(N, R) whether a circle or arc reaches into the direction of a point from its centre."""
    angles = np.arctan2(outward[..., 1], outward[..., 0])
    inside = np.ones(angles.shape, dtype=np.bool_)
    for column, (_, _, _, start, end) in enumerate(field.arcs, start=len(field.circles)):
        sweep = arc_sweep(start, end)
        inside[:, column] = np.abs(wrap_angles(angles[:, column] - start - 0.5 * sweep)) <= 0.5 * sweep
    return inside
