"""Roll and pitch of a camera of which nobody knows them well: where a fit begins, and what the lines of one image tell.

Two degrees move a line 5 m before a camera at half a metre by two metres, farther than a registration reaches. So it
begins at each of a grid of attitudes, or at those at which the lines that are seen are parallel or at right angles.
"""

import math

import numpy as np
from numba import njit

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
KNOWN_RAD = 0.015  # standard deviation of roll or pitch below which no other attitude is searched or tried
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
    sees, whose attitude is not known well, the likeliest that fits from other attitudes come to.
    """
    fit = registration.fit_state(seen, start, expected, plan, response)
    if fit.explained >= GOOD or not isinstance(response, PerspectiveResponse):
        return fit
    deviations = attitude_deviations(expected)
    if deviations.max() < KNOWN_RAD:
        return fit
    tried = [fit]
    for offset in attitude_offsets(deviations)[1:]:
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
    offsets = attitude_offsets(deviations)
    errors = np.tile(mean, (len(offsets), 1))
    errors[:, :2] += offsets
    ends, sigmas = np.ascontiguousarray(lines.ends_m.reshape(-1, 2)), np.maximum(lines.own_sigmas[:, 1], MIN_SIGMA_RAD)
    scores = _squareness(ends, sigmas, errors, response) - 0.5 * ((offsets / deviations) ** 2).sum(axis=1)
    return list(errors[np.argsort(-scores, kind="stable")[:count]])


@njit(cache=True)
def _squareness(ends, sigmas, errors, response):  # type: ignore[no-untyped-def]
    """Log-likelihoods (A,) of the directions of lines, ends (2 L, 2), if they are parallel or at right angles, at each
    of errors (A, K) of the camera. sigmas (L,): of the directions.

    An arc or an edge of a shadow among them is none of the field's lines, whatever the attitude: it costs a constant.
    """
    scores, turns = np.zeros(len(errors)), np.empty(len(sigmas))
    for a in range(len(errors)):
        placed = placed_points(ends, errors[a], response)
        for k in range(len(turns)):
            turns[k] = math.atan2(placed[2 * k + 1, 1] - placed[2 * k, 1], placed[2 * k + 1, 0] - placed[2 * k, 0])
        for i in range(len(turns)):
            total = 0.0
            for k in range(len(turns)):
                off = math.sin(2.0 * (turns[k] - turns[i])) / (2.0 * math.hypot(sigmas[i], sigmas[k]))
                total += math.log(STRAY + (1.0 - STRAY) * math.exp(-0.5 * off**2))
            scores[a] = total if i == 0 else max(scores[a], total)
    return scores
