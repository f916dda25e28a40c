"""Roll and pitch of a camera of which nobody knows them well: where a fit begins, and what the lines of one image tell.

Two degrees move a line 5 m before a camera at half a metre by two metres, farther than a registration reaches. So it
begins at each of a grid of attitudes, or at those at which the lines that are seen are parallel or at right angles.
"""

import math

import numpy as np

from touchline.geometry import FloatArray
from touchline.localization.camera_errors.base import Response, placed_points
from touchline.localization.camera_errors.perspective import PerspectiveResponse
from touchline.localization.registration.feature_model import LineFeatures
from touchline.localization.registration.joint import Seen, StateFit, StatePrior
from touchline.localization.registration.kernels import Plan
from touchline.localization.registration.registration import Registration
from touchline.matrices import inverse

REACH, STEP_RAD = 1.5, 0.025  # of the grid in standard deviations, and its widest step
GOOD = 0.85  # share explained from which no other attitude is tried
KNOWN_RAD = 0.015  # standard deviation of roll or pitch below which one attitude is searched
LIKELY = 8  # attitudes that are searched in images of a system
MIN_SIGMA_RAD = 0.04  # of a line's direction: cameras have other errors, too
STRAY = 0.02  # probability of a line that is none of the field's straight ones


def attitude_deviations(expected: StatePrior) -> FloatArray:
    """Standard deviations of roll and pitch (2,) in what is expected of an image (rad)."""
    covariance: FloatArray = inverse(expected.information)
    return np.sqrt(np.diag(covariance)[3:5])


def attitude_offsets(deviations: FloatArray) -> FloatArray:
    """Roll and pitch (A, 2) beside those expected to within deviations (2,) (rad), the nearest first: 0, 0."""
    sides = []
    for deviation in deviations.tolist():
        count = max(math.ceil(REACH * deviation / STEP_RAD), 1)
        sides.append(np.linspace(-REACH * deviation, REACH * deviation, 2 * count + 1))
    offsets = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
    order = np.argsort(((offsets / np.maximum(deviations, 1e-9)) ** 2).sum(axis=1), kind="stable")
    return offsets[order]


def fit_leaning(
    registration: Registration, seen: Seen, start: FloatArray, expected: StatePrior, plan: Plan, response: Response
) -> StateFit:
    """Pose and camera errors as of `Registration.fit_state`; where they explain too little of what a perspective camera
    sees, the likeliest that fits from other attitudes come to.
    """
    fit = registration.fit_state(seen, start, expected, plan, response)
    if fit.explained >= GOOD or not isinstance(response, PerspectiveResponse):
        return fit
    tried = [fit]
    for offset in attitude_offsets(attitude_deviations(expected))[1:]:
        leaning = start.copy()
        leaning[3:5] += offset
        tried.append(registration.fit_state(seen, leaning, expected, plan, response))
    return max(tried, key=lambda each: each.log_likelihood - each.contradiction)


def likely_attitudes(lines: LineFeatures, expected: StatePrior, response: Response, count: int) -> list[FloatArray]:
    """Camera errors (K,) at which a search begins, up to a count, the likeliest first: but for roll and pitch those
    that are expected.

    lines: as they were seen. Those of a field are parallel or at right angles; how nearly they are so at an attitude,
    and how far that is from what is expected, makes it likely.
    """
    mean, deviations = expected.mean[3:], attitude_deviations(expected)
    if deviations.max() < KNOWN_RAD:
        return [mean]
    found, scores = [], []
    for offset in attitude_offsets(deviations):
        errors = mean.copy()
        errors[:2] += offset
        scores.append(_squareness(lines, errors, response) - 0.5 * float(((offset / deviations) ** 2).sum()))
        found.append(errors)
    return [found[k] for k in np.argsort(-np.array(scores), kind="stable")[:count]]


def _squareness(lines: LineFeatures, errors: FloatArray, response: Response) -> float:
    """Log-likelihood of the lines' directions if they are parallel or at right angles, at errors (K,) of the camera.

    An arc or an edge of a shadow among them is none of the field's lines, whatever the attitude: it costs a constant.
    """
    ends = placed_points(np.ascontiguousarray(lines.ends_m.reshape(-1, 2)), errors, response).reshape(-1, 2, 2)
    along = ends[:, 1] - ends[:, 0]
    turns = np.arctan2(along[:, 1], along[:, 0])
    sigmas = np.maximum(lines.own_sigmas[:, 1], MIN_SIGMA_RAD)
    off = np.sin(2.0 * (turns - turns[:, np.newaxis])) / (2.0 * np.hypot(sigmas, sigmas[:, np.newaxis]))
    each = np.log(STRAY + (1.0 - STRAY) * np.exp(-0.5 * off**2))
    return float(each.sum(axis=1).max(initial=-np.inf)) if len(each) else 0.0
