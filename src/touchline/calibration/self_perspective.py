"""`touchline calibrate self` of a perspective camera: roll, pitch, height and focal length from the lines seen in play.

Bundle adjustment (`calibration/bundle.py`): the pose and the lean of every image and the four numbers that all images
share. Each image is registered (`registration/joint.py`), which gives its normal equations; those of all images are
solved together, and all is done again from there. The poses of a run of the system are where it begins.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from touchline.calibration.bundle import Block, NormalEquations, entries, prior_block
from touchline.calibration.self_calibration import SelfCalibration, require_views
from touchline.camera import PerspectiveCamera
from touchline.geometry import FloatArray
from touchline.localization.camera_errors.base import placed_points
from touchline.localization.camera_errors.perspective import PerspectiveResponse
from touchline.localization.registration.joint import Seen, StateFit, StatePrior
from touchline.localization.registration.registration import TRACKING, Registration
from touchline.localization.registration.seen import seen_of
from touchline.localization.search.feature_search import distinct
from touchline.systems.touchline import Touchline
from touchline.types import Estimate, Frame

SHARED = ("roll", "pitch", "height", "focal length")
PRIOR = np.array([0.05, 0.05, 0.05, 0.05])  # standard deviations before: rad, rad, ratios
LEAN_RAD, MIN_LEAN_RAD = 0.008, 0.002  # standard deviation of an image's own lean: at first, and at least
POSE = np.array([0.3, 0.3, 0.2])  # how far a run's poses are off at most (m, m, rad)
ROUNDS = 8
MAX_IMAGES, MIN_SEEN = 300, 4.0  # images that are fitted; how much one of them must show, in line points' shares
REPEATED = 3.0  # so many images err together at least, and all those of one place
PLACE_M, PLACE_RAD = 0.3, 0.2  # nearer images are of one place
FIXED = 1e-6  # standard deviation of what is not fitted
_STATES = 7  # of a registration
_OWN = 5  # entries of an image: its pose and its own lean
_ERRS_BY = np.array([0, 1, 2, 3, 4, 3, 4, 5, 6])  # of those and the shared: by what of a registration's state each errs
MAX_DEVIATIONS = np.array([math.radians(0.3), math.radians(0.3), 0.01, 0.01])  # of what is written
MAX_ERRORS = np.array([0.15, 0.15, 0.15, 0.15])  # by which a camera is off at most; more is another camera


class PerspectiveView(NamedTuple):
    """One image: what it shows of the field, where the camera looked, and the pose (3,) that a system has found."""

    seen: Seen
    response: PerspectiveResponse
    pose: FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class PerspectiveSelfCalibration(SelfCalibration[PerspectiveCamera]):
    """shared (4,): roll and pitch (rad) by which the old camera leans more than it says, relative errors of its height
    and of the tangents (of a fisheye: the angles) that it sees. lean_rad: by which roll and pitch err in one image.
    """

    lean_rad: float


def perspective_view(system: Touchline, frame: Frame, estimate: Estimate) -> PerspectiveView | None:
    """An image that the system has just taken; None where its pose is not known, or it shows too little."""
    if not estimate.explains_image or estimate.observation is None:
        return None
    seen = seen_of(estimate.observation, system.features, 1.0)
    if seen.shares.sum() < MIN_SEEN:
        return None
    return PerspectiveView(seen, system.errors.response(frame), estimate.pose.as_array())


def evenly(views: Sequence[PerspectiveView]) -> tuple[PerspectiveView, ...]:
    """So many views as are fitted at most, evenly over time."""
    chosen = np.unique(np.linspace(0, len(views) - 1, min(MAX_IMAGES, len(views))).astype(int))
    return tuple(views[k] for k in chosen)


def calibrate_self_perspective(
    views: Sequence[PerspectiveView], camera: PerspectiveCamera, registration: Registration
) -> PerspectiveSelfCalibration:
    """The camera that puts what all views show where it is on the field. Raises NoFitError with the reason."""
    require_views(len(views))
    shared_at, own = entries(len(SHARED), len(views), _OWN)
    state, lean_rad = np.zeros(own[-1, -1] + 1), LEAN_RAD
    state[own[:, :3]] = [one.pose for one in views]

    def placed(state: FloatArray) -> list[StateFit]:
        states = [np.concatenate((state[mine[:3]], state[shared_at])) for mine in own]
        return [_registered(one, registration, each, POSE) for one, each in zip(views, states, strict=True)]

    fits_before = placed(state)
    for _ in range(ROUNDS):
        state, covariance, lean_rad = _round(views, registration, state, lean_rad)
    shared, fits = state[shared_at], placed(state)
    seen = tuple(np.concatenate((one.seen.positions_m, one.seen.raw_m)) for one in views)
    right = tuple(placed_points(each, shared, one.response) for each, one in zip(seen, views, strict=True))
    angles = np.concatenate([_angles(each, one.response) for each, one in zip(seen, views, strict=True)])
    found = PerspectiveSelfCalibration(
        camera.corrected(shared, angles), shared, covariance, (seen, right),
        (np.array([fit.state[:3] for fit in fits_before]), np.array([fit.state[:3] for fit in fits])),
        _quality(fits_before), _quality(fits), lean_rad,
    )  # fmt: skip
    names, scales = [f"the camera's {name}" for name in SHARED], np.array([*np.degrees([1.0, 1.0]), 100.0, 100.0])
    bounds = zip(names, scales * found.deviations, scales * MAX_DEVIATIONS, ("°", "°", " %", " %"), strict=True)
    found.check("what was seen lies on the field with the best camera", "camera", tuple(bounds))
    return found


def _angles(ground: FloatArray, response: PerspectiveResponse) -> FloatArray:
    """(N,) between rays to ground points (N, 2) and the optical axis (rad)."""
    rays = np.column_stack((ground, np.zeros(len(ground)))) - response.eye
    cosines: FloatArray = rays @ response.axis / np.linalg.norm(rays, axis=1)
    return np.arccos(np.clip(cosines, -1.0, 1.0))


def _round(
    views: Sequence[PerspectiveView], registration: Registration, state: FloatArray, lean_rad: float
) -> tuple[FloatArray, FloatArray, float]:
    """Register every view from a state and solve: the next state, covariance of what is shared, the images' lean."""
    shared, own = entries(len(SHARED), len(views), _OWN)
    deviations = np.array([*POSE, lean_rad, lean_rad])
    repeated = max(REPEATED, len(views) / len(distinct(state[own[:, :3]], len(views), PLACE_M, PLACE_RAD)))
    blocks, squares, state = [prior_block(shared, PRIOR**-2.0, state[shared])], [], state.copy()
    for view, mine in zip(views, own, strict=True):
        place, block = _block(view, registration, np.concatenate((state[mine[:3]], state[shared])), deviations)
        state[mine] = place
        squares.append(np.square(place[3:]) + np.diag(np.linalg.inv(block.information[:_OWN, :_OWN]))[3:])
        blocks.append(block._replace(at=np.concatenate((mine, shared))).divided(repeated))
    equations = NormalEquations(blocks)
    state[shared] = np.clip(state[shared] + equations.step()[shared], -MAX_ERRORS, MAX_ERRORS)
    return state, equations.covariance(shared), max(math.sqrt(float(np.mean(squares))), MIN_LEAN_RAD)


def _block(
    view: PerspectiveView, registration: Registration, mean: FloatArray, deviations: FloatArray
) -> tuple[FloatArray, Block]:
    """Where a view is registered beside pose and shared errors (7,): pose and own lean (5,), and its normal equations.

    Those are of pose, own lean and what is shared, with what is known of the first two: there, these pull no more.
    """
    fit = _registered(view, registration, mean, deviations)
    pull = np.concatenate((deviations, np.full(_STATES - _OWN, FIXED))) ** -2.0 * (fit.state - mean)
    information = fit.information[np.ix_(_ERRS_BY, _ERRS_BY)]
    information[range(_OWN), range(_OWN)] += deviations**-2.0
    place = fit.state[:_OWN] - np.array([0.0, 0.0, 0.0, *mean[3:_OWN]])
    return place, Block(np.empty(0, np.intp), information, np.concatenate((np.zeros(_OWN), pull[3:])))


def _registered(
    view: PerspectiveView, registration: Registration, mean: FloatArray, deviations: FloatArray
) -> StateFit:
    """A view registered from a state (7,) that is known to within deviations (K,) of its first entries; others are
    taken for true.
    """
    known = np.concatenate((deviations, np.full(_STATES - len(deviations), FIXED)))
    prior = StatePrior(mean, np.diag(known**-2.0))
    return registration.fit_state(view.seen, mean, prior, TRACKING, view.response)


def _quality(fits: Sequence[StateFit]) -> tuple[float, float]:
    of = np.array([fit.of for fit in fits])
    explained = np.array([fit.explained for fit in fits])
    residuals = np.nan_to_num([fit.residual_m for fit in fits])
    return float(of @ explained / of.sum()), float((of * explained) @ residuals / max(float(of @ explained), 1e-9))
