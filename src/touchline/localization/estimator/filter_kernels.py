"""Numba loops of the filter: a dozen states, for which NumPy takes longer than their sums.

Everywhere: joint (N, N), covariance of all states; measured (S,), those that a fit measures: x, y, heading and the
camera's errors; per_image (S - 3, S - 3), covariance of what an image's own errors differ by from the camera's;
information (S, S) and gradient (S,) of what an image shows, as of `StateFit`; residual (S,), from what was expected to
where the fit ended.
"""

import numpy as np
from numba import njit

from touchline.localization.registration.covariance import ANYWHERE_INFORMATION
from touchline.matrices import add_to, applied, dot, inverse, plus, symmetrise, times
from touchline.motion.driven import linearise

_EXACT = 1e-14  # variance of what is known exactly


@njit(cache=True)
def measured_covariance(joint, measured, per_image):  # type: ignore[no-untyped-def]
    """Covariance (S, S) of what an image shows, before it is seen."""
    spread = np.empty((len(measured), len(measured)))
    for a in range(len(measured)):
        for b in range(len(measured)):
            spread[a, b] = joint[measured[a], measured[b]]
            if a >= 3 and b >= 3:
                spread[a, b] += per_image[a - 3, b - 3]
    return spread


@njit(cache=True)
def predicted(joint, pose, scales, motion, by_delay, noise, seconds, drift):  # type: ignore[no-untyped-def]
    """Pose (x, y, heading not wrapped), derivative (3,) of it by the delay, what a motion adds to its covariance
    (3, 3), and the covariance (N, N) of all states after it.

    pose, motion, by_delay (3,), noise (3, 3): as of `Filter.predict`; drift (N,): of every variance in a second.
    """
    by_scales, by_state, by_motion, grown = np.empty((6, 6)), np.zeros((8, 8)), np.empty((3, 3)), np.empty(len(drift))
    x, y, heading = linearise(pose, scales, motion, by_scales, by_motion)
    add_to(by_state, by_scales, 1.0)
    by_state[6, 6] = by_state[7, 7] = 1.0
    delayed = applied(by_motion, by_delay)
    for a in range(3):
        by_state[a, 7] = delayed[a]
    by_state[2, 6] = seconds
    added = times(times(by_motion, noise), by_motion.T)
    for k in range(len(drift)):
        grown[k] = seconds * drift[k]
    return (x, y, heading), (delayed[0], delayed[1], delayed[2]), added, propagate(joint, by_state, added, grown)


@njit(cache=True)
def propagate(joint, by_state, noise, drift):  # type: ignore[no-untyped-def]
    """Covariance (N, N) after a motion: by_state (M, M), derivative of the first M states after it by those before;
    noise (3, 3): what the motion adds to that of the pose; drift (N,): to every variance.
    """
    out, moved = joint.copy(), len(by_state)
    block = times(by_state, joint[:moved])
    inner = times(block[:, :moved], by_state.T)
    for a in range(moved):
        for b in range(moved):
            out[a, b] = inner[a, b]
        for b in range(moved, len(out)):
            out[a, b] = out[b, a] = block[a, b]
    for k in range(len(out)):
        out[k, k] += drift[k]
    add_to(out, noise, 1.0)
    return out


@njit(cache=True)
def expected_information(joint, measured, per_image):  # type: ignore[no-untyped-def]
    """Inverse covariance (S, S) of what an image will show."""
    shown = measured_covariance(joint, measured, per_image)
    for a in range(len(measured)):
        shown[a, a] += _EXACT
    return inverse(shown)


@njit(cache=True)
def pose_innovation(joint, measured, per_image, information, gradient, residual):  # type: ignore[no-untyped-def]
    """How far the pose by an image alone lies from the prediction (3,), and its squared Mahalanobis distance."""
    shown = np.empty((3, 3))
    for a in range(3):
        for b in range(3):
            shown[a, b] = information[a, b] + ANYWHERE_INFORMATION[a, b]
    spread = inverse(shown)  # of the pose by the image
    by_state = times(spread, information[:3])  # of that pose by pose and errors
    off, more = applied(spread, gradient[:3]), applied(by_state, residual)
    for a in range(3):
        off[a] += more[a]
    add_to(spread, times(times(by_state, measured_covariance(joint, measured, per_image)), by_state.T), 1.0)
    return off, dot(off, applied(inverse(spread), off))


@njit(cache=True)
def correction(joint, measured, per_image, information, gradient, residual, learned):  # type: ignore[no-untyped-def]
    """Step (N,) of the states, and covariance (N, N) after it; learned (N,): share of its step that each takes."""
    spread, crossed = measured_covariance(joint, measured, per_image), np.empty((len(joint), len(measured)))
    for a in range(len(measured)):
        for k in range(len(joint)):
            crossed[k, a] = joint[k, measured[a]]
    damping = times(information, spread)
    damped = damping.copy()
    for a in range(len(measured)):
        damped[a, a] += 1.0
    gain = times(crossed, inverse(damped))
    for k in range(len(joint)):
        for a in range(len(measured)):
            gain[k, a] *= learned[k]
    spent = times(times(gain, plus(times(damping, information), information, 1.0)), gain.T)
    shared = times(times(gain, information), crossed.T)
    after = plus(plus(joint, spent, 1.0), shared, -1.0)
    add_to(after, shared.T, -1.0)
    symmetrise(after)
    pull = applied(information, residual)
    for a in range(len(pull)):
        pull[a] += gradient[a]
    return applied(gain, pull), after


@njit(cache=True)
def degrees_of_freedom_and_lean(per_image, expected, information, strain):  # type: ignore[no-untyped-def]
    """Effective degrees of freedom of an image, of S, and the mean square of its own lean.

    expected (S, S): `expected_information`; strain (S,): from what was expected to the fit. The lean, the first two of
    the errors, is what this image's differ by from the camera's, and how unsure that still is.
    """
    after, square, freedom = inverse(plus(expected, information, 1.0)), 0.0, 0.0
    by_all = times(per_image[:2], expected[3:])  # of the image's lean by what it differs by from what was expected
    lean, unsure = applied(by_all, strain), times(by_all, after)
    for a in range(2):
        left = per_image[a, a] + dot(unsure[a], by_all[a]) - dot(per_image[a], by_all[a, 3:])
        square += 0.5 * (lean[a] * lean[a] + left)
    for a in range(len(after)):
        for b in range(len(after)):
            freedom += information[a, b] * after[a, b]
    return freedom, square


@njit(cache=True)
def step_squares(joint, measured, per_image, information, gradient, residual, noise):  # type: ignore[no-untyped-def]
    """Squared errors (3,) of the motion since the image before, and what is unknown of them, by what an image shows.

    noise (3, 3): what the motion has added to the covariance of the pose.
    """
    spread = measured_covariance(joint, measured, per_image)
    expected = inverse(spread)
    after, pull, squares = inverse(plus(expected, information, 1.0)), applied(information, residual), np.empty(3)
    for a in range(len(pull)):
        pull[a] += gradient[a]
    step, more = applied(after, pull), np.empty((len(after), len(after)))
    for a in range(len(after)):
        for b in range(len(after)):
            more[a, b] = step[a] * step[b] + after[a, b] - spread[a, b]
    by_all = times(expected[:, :3], noise)  # of the motion's error by what the image differs by
    grown = times(times(by_all.T, more), by_all)
    for a in range(3):
        squares[a] = noise[a, a] + grown[a, a]
    return squares
