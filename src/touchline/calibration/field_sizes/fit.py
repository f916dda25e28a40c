"""Poses, sizes of the field and what the camera is wrong by, fitted together to the line points of many places.

All sizes and all distances by the same factor look alike: nothing but the camera's ranges tells how long a metre is. So
a common scale is taken as the camera's, and a size counts as otherwise only if the others are not. Most sizes are what
the rules say; a few are decimetres off. That is Cauchy's prior, and it is what parts a wrong size from a wrong scale.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from touchline.calibration.bundle import Block, NormalEquations, entries, marginal, prior_block, residual_block
from touchline.calibration.field_sizes.sizes import FieldSizes, line_velocities
from touchline.calibration.nearest_line import nearest_line
from touchline.field import FieldModel
from touchline.geometry import BoolArray, FloatArray, IndexArray

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
_OWN_PRIOR = np.array([1e-6, 1e-6, 1e-6, SHAKE_PER_M**-2.0, SHAKE_PER_M**-2.0])  # of poses it only damps steps


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


def fit_sizes(places: Sequence[Place], sizes: FieldSizes, scale: float = USUAL_SCALE) -> SizeFit:
    """Fit places and sizes from poses that are close on the field as the rules say.

    scale: standard deviation of a common scale of all ranges.
    """
    camera = np.array([BEND_PER_M, BEND_PER_M, scale, CURVE])
    shared, own = entries(_CAMERA + len(sizes.sizes), len(places), _OWN)
    state = np.zeros(own[-1, -1] + 1)
    state[own[:, :3]] = [place.pose for place in places]
    repeated = REPEATED
    for k, width_m in enumerate((*WIDTHS_M, *WIDTHS_M[-4:])):
        common, blocks = state[shared], _blocks(places, sizes, state, (shared, own), width_m)[0]
        if k == len(WIDTHS_M):
            repeated = max(REPEATED, _disagreement(blocks, shared, _prior(common, camera)))
        blocks = [one.divided(repeated) for one in blocks]
        best = _best_common(blocks, shared, common, camera, wide=k < _WIDE_STEPS)
        best[_CAMERA:] = np.clip(best[_CAMERA:], -MAX_M, MAX_M)
        held = prior_block(shared, np.full(len(shared), _HELD), common - best)
        state = state + NormalEquations([*blocks, held]).step()
    blocks, residuals_m = _blocks(places, sizes, state, (shared, own), WIDTHS_M[-1])
    modes = _modes(*_common_equations([one.divided(repeated) for one in blocks], shared, state[shared], camera), camera)
    chances = np.exp(np.min(modes.costs) - modes.costs)
    chances /= chances.sum()
    change = chances @ modes.change_m
    variances = chances @ (modes.variance_m2 + (modes.change_m - change) ** 2)
    mean = float(chances @ modes.scales)
    mean_deviation = float(np.sqrt(chances @ (modes.scales - mean) ** 2))
    return SizeFit(change, np.sqrt(variances), mean, mean_deviation, state[own[:, :3]], residuals_m)


class _Modes(NamedTuple):
    """For each scale (S,): the cost (S,), and what the sizes (S, J) themselves say there, with variances."""

    scales: FloatArray
    costs: FloatArray
    change_m: FloatArray
    variance_m2: FloatArray
    common: FloatArray


def _common_equations(
    blocks: Sequence[Block], shared: IndexArray, common: FloatArray, camera: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Matrix (K, K) and vector (K,) that the places alone, whatever their poses, give the common parameters (K,)."""
    matrix, gradient = marginal(blocks, shared, _prior(common, camera))
    return matrix, matrix @ common + gradient, common


def _modes(matrix: FloatArray, vector: FloatArray, common: FloatArray, camera: FloatArray) -> _Modes:
    """What suits matrix @ common = vector and the prior best, for scales all over what the camera may be wrong by.

    Cauchy's prior has several minima: a wrong scale with many wrong sizes, for one wrong size. Each counts.
    """
    scales = camera[2] * np.linspace(-3.0, 3.0, _SCALES)
    held, toward = np.zeros_like(matrix), np.tile(vector, (_SCALES, 1))
    held[2, 2] = _HELD
    toward[:, 2] += _HELD * scales
    found = np.tile(common, (_SCALES, 1))
    found[:, _CAMERA:] *= 3.0  # a size that is near to the rules would stay there
    for _ in range(_ROUNDS):
        whole = matrix + held + _diagonals(_prior(found, camera))
        found = np.linalg.solve(whole, toward[..., np.newaxis])[..., 0]
    costs = 0.5 * ((found @ matrix - 2.0 * vector) * found).sum(axis=1)
    costs += 0.5 * np.square(found[:, :_CAMERA] / camera).sum(axis=1)
    costs += np.log1p((found[:, _CAMERA:] / RULES_M) ** 2).sum(axis=1)
    prior = _prior(found, camera)
    spread = np.diagonal(np.linalg.inv(matrix + held + _diagonals(prior)), axis1=1, axis2=2)[:, _CAMERA:]
    own_say = np.maximum(1.0 - prior[:, _CAMERA:] * spread, _NOTHING)  # without a size's own prior
    variances = np.where(own_say > _NOTHING, spread / own_say, np.inf)
    return _Modes(scales, costs, found[:, _CAMERA:] / own_say, variances, found)


def _best_common(
    blocks: Sequence[Block], shared: IndexArray, common: FloatArray, camera: FloatArray, wide: bool
) -> FloatArray:
    """The common parameters that suit the equations and the prior best."""
    if wide:  # all sizes and the scale together fit as well: the scale is held
        prior = np.concatenate((camera**-2.0, np.full(len(common) - _CAMERA, WIDE_M**-2.0)))
        prior[2] = _HELD
        return common + NormalEquations([*blocks, prior_block(shared, prior, common)]).step()[shared]
    modes = _modes(*_common_equations(blocks, shared, common, camera), camera)
    return np.asarray(modes.common[int(np.argmin(modes.costs))])


def _prior(common: FloatArray, camera: FloatArray) -> FloatArray:
    """Inverse variances (..., K) of the common parameters (..., K): the camera's (4,), and Cauchy's for sizes as they
    are.
    """
    sizes = 2.0 / (RULES_M**2 + common[..., _CAMERA:] ** 2)
    return np.concatenate((np.broadcast_to(camera**-2.0, (*common.shape[:-1], _CAMERA)), sizes), axis=-1)


def _diagonals(values: FloatArray) -> FloatArray:
    """Diagonal matrices (..., K, K) of values (..., K)."""
    return values[..., np.newaxis] * np.eye(values.shape[-1])


def _disagreement(blocks: Sequence[Block], shared: IndexArray, prior: FloatArray) -> float:
    """How much more the places' parts differ from each other than their points' noise says: Huber's sandwich."""
    if len(blocks) < 4:
        return 2.0 * REPEATED
    equations = NormalEquations([*blocks, prior_block(shared, prior, np.zeros(len(prior)))])
    covariance = equations.covariance(shared)
    information = np.square(equations.influences(blocks, shared)).sum(axis=0)
    expected = np.maximum(np.diag(covariance) - np.square(covariance) @ prior, 1e-12)
    return float(np.max(information[_CAMERA:] / expected[_CAMERA:]))


def _blocks(
    places: Sequence[Place],
    sizes: FieldSizes,
    state: FloatArray,
    at: tuple[IndexArray, IndexArray],
    width_m: float,
) -> tuple[list[Block], FloatArray]:
    """The normal equations of each place, its own prior included, and all points' distances (N,) from the lines."""
    shared, own = at
    field, velocities = sizes.field(state[shared][_CAMERA:]), line_velocities(sizes, state[shared][_CAMERA:])
    blocks, residuals = [], []
    for place, mine in zip(places, own, strict=True):
        rows, distances, on_line = _rows(place, state[mine], state[shared], field, velocities)
        weights = (width_m**2 / (width_m**2 + distances**2)) ** 2 / (place.deviations**2 + FLOOR_M**2)
        blocks.append(
            residual_block(
                np.concatenate((mine, shared)),
                np.vstack((rows, np.eye(_OWN, rows.shape[1]))),
                np.concatenate((distances, np.where(_OWN_PRIOR > 1.0, state[mine], 0.0))),
                np.concatenate((np.where(on_line, weights, 0.0), _OWN_PRIOR)),
            )
        )
        residuals.append(np.abs(distances))
    return blocks, np.concatenate(residuals)


def _rows(
    place: Place, state: FloatArray, common: FloatArray, field: FieldModel, velocities: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray, BoolArray]:
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
    near, count = nearest_line(field.line_tables, placed), len(field.segments)
    straight, along = near.line < count, near.along[:, np.newaxis]
    ends = velocities[0][:, np.where(straight, near.line, 0)]
    moves = ends[..., :2] * (1.0 - along) + ends[..., 2:] * along  # (J, N, 2)
    grown = np.zeros(moves.shape[:2])
    if velocities[1].shape[1]:
        rounds = velocities[1][:, np.where(straight, 0, near.line - count)]
        moves = np.where(straight[:, np.newaxis], moves, rounds[..., :2])
        grown = np.where(straight, 0.0, rounds[..., 2])
    moved = np.einsum("jnd,nd->nj", moves, near.normal) + grown.T
    of_arc = near.line >= count + len(field.circles)
    return np.where(near.is_beyond | of_arc, np.nan, near.distance_m), near.normal, moved
