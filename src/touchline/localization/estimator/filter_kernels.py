"""Numba loops of the filter: a dozen states, for which NumPy takes longer than their sums.

Everywhere: mean (N,) and joint (N, N), covariance, of all states; measured (S,), those that a fit measures: x, y,
heading and the camera's errors; per_image (S - 3, S - 3), covariance of what an image's own errors differ by from the
camera's; seen: state (S,), information (S, S) and gradient (S,) of what an image shows, as of `StateFit`. What is found
is written to arrays that are given: to return one takes as long as all the sums.
"""

import numpy as np
from numba import njit

from touchline.localization.registration.covariance import ANYWHERE_INFORMATION
from touchline.matrices import add_to, applied, copy_row, dot, inverse, plus, symmetrise, times
from touchline.motion.driven import linearise
from touchline.motion.odometry import wrapped

YAW_RATE, DELAY, ERRORS = 6, 7, 8  # states behind pose and scales; the errors are all from there on
MIN_DELAY_S, MAX_DELAY_S = -0.1, 0.4  # that are looked for
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
def residual_of(mean, measured, state):  # type: ignore[no-untyped-def]
    """(S,) from what was expected to where a fit ended."""
    residual = np.empty(len(measured))
    for a in range(len(measured)):
        residual[a] = state[a] - mean[measured[a]]
    residual[2] = wrapped(residual[2])
    return residual


@njit(cache=True)
def predict(known, motion, by_delay, noise, spans, added, out):  # type: ignore[no-untyped-def]
    """Move the mean, in place, and write its covariance then to out (N, N); the pose.

    known: mean, joint, drift (N,) of every variance in a second. motion, by_delay (3,), noise (3, 3): as of
    `Filter.predict`; spans: of it in seconds, and how late its ends are stamped (s). added (3, 3): to which is added
    what the motion adds to the covariance of the pose.
    """
    (mean, joint, drift), (seconds, late_s) = known, spans
    by_scales, by_state, by_motion, grown = np.empty((6, 6)), np.zeros((8, 8)), np.empty((3, 3)), np.empty(len(drift))
    x, y, heading = linearise(mean, mean[3:], motion, by_scales, by_motion)
    add_to(by_state, by_scales, 1.0)
    by_state[YAW_RATE, YAW_RATE] = by_state[DELAY, DELAY] = 1.0
    delayed = applied(by_motion, by_delay)
    for a in range(3):
        by_state[a, DELAY] = delayed[a]
    by_state[2, YAW_RATE] = seconds
    more = times(times(by_motion, noise), by_motion.T)
    add_to(added, more, 1.0)
    for k in range(len(drift)):
        grown[k] = seconds * drift[k]
    propagate(joint, by_state, more, grown, out)
    later_s = mean[DELAY] - late_s
    mean[0], mean[1] = x + later_s * delayed[0], y + later_s * delayed[1]
    mean[2] = wrapped(wrapped(heading) + (later_s * delayed[2] + seconds * mean[YAW_RATE]))
    return mean[0], mean[1], mean[2]


@njit(cache=True)
def propagate(joint, by_state, noise, drift, out):  # type: ignore[no-untyped-def]
    """Covariance after a motion, to out (N, N): by_state (M, M), derivative of the first M states after it by those
    before; noise (3, 3): what the motion adds to that of the pose; drift (N,): to every variance.
    """
    moved = len(by_state)
    for k in range(len(joint)):
        copy_row(joint[k], out[k])
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


@njit(cache=True)
def expect(mean, joint, measured, per_image, state, information):  # type: ignore[no-untyped-def]
    """What an image will show, into state (S,), and the inverse covariance of that, into information (S, S)."""
    shown = measured_covariance(joint, measured, per_image)
    for a in range(len(measured)):
        state[a] = mean[measured[a]]
        shown[a, a] += _EXACT
    found = inverse(shown)
    for a in range(len(measured)):
        copy_row(found[a], information[a])


@njit(cache=True)
def pose_innovation(mean, joint, measured, per_image, seen):  # type: ignore[no-untyped-def]
    """How far the pose by an image alone lies from the prediction, and its squared Mahalanobis distance."""
    (state, information, gradient), shown = seen, np.empty((3, 3))
    residual = residual_of(mean, measured, state)
    for a in range(3):
        for b in range(3):
            shown[a, b] = information[a, b] + ANYWHERE_INFORMATION[a, b]
    spread = inverse(shown)  # of the pose by the image
    by_state = times(spread, information[:3])  # of that pose by pose and errors
    off, more = applied(spread, gradient[:3]), applied(by_state, residual)
    for a in range(3):
        off[a] += more[a]
    add_to(spread, times(times(by_state, measured_covariance(joint, measured, per_image)), by_state.T), 1.0)
    return (off[0], off[1], off[2]), dot(off, applied(inverse(spread), off))


@njit(cache=True)
def correct(mean, joint, measured, per_image, seen, learned, out):  # type: ignore[no-untyped-def]
    """Mean and covariance by an image, into out: (N,) and (N, N); the pose. learned (N,): share of its step that each
    state takes.
    """
    (state, information, gradient), (moved, after) = seen, out
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
    for k in range(len(joint)):
        for i in range(len(joint)):
            after[k, i] = joint[k, i] + spent[k, i] - shared[k, i]
    add_to(after, shared.T, -1.0)
    symmetrise(after)
    pull = applied(information, residual_of(mean, measured, state))
    for a in range(len(pull)):
        pull[a] += gradient[a]
    step = applied(gain, pull)
    for k in range(len(mean)):
        moved[k] = mean[k] + step[k]
    moved[2] = wrapped(moved[2])
    moved[DELAY] = min(max(moved[DELAY], MIN_DELAY_S), MAX_DELAY_S)
    return moved[0], moved[1], moved[2]


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
def step_squares(mean, joint, measured, per_image, seen, noise):  # type: ignore[no-untyped-def]
    """Squared errors (3,) of the motion since the image before, and what is unknown of them, by what an image shows.

    noise (3, 3): what the motion has added to the covariance of the pose.
    """
    (state, information, gradient), spread = seen, measured_covariance(joint, measured, per_image)
    expected, residual = inverse(spread), residual_of(mean, measured, state)
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
    return squares[0], squares[1], squares[2]
