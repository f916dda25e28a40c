"""Numba loops of the filter: a dozen states, for which NumPy takes longer than their sums.

Everywhere: joint (N, N), covariance of all states; measured (S,), those that a fit measures: x, y, heading and the
camera's errors; per_image (S - 3, S - 3), covariance of what an image's own errors differ by from the camera's;
information (S, S) and gradient (S,) of what an image shows, as of `StateFit`; residual (S,), from what was expected to
where the fit ended.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from touchline.matrices import inverse, times
from touchline.motion.driven import linearise

_EXACT = 1e-14  # variance of what is known exactly
_ANYWHERE_INFORMATION = (1e-2, 1e-2, 1.0 / 9.0)  # inverse variances of a pose somewhere on a field


@njit(cache=True)
def measured_covariance(joint, measured, per_image):  # type: ignore[no-untyped-def]
    """Covariance (S, S) of what an image shows, before it is seen."""
    count = len(measured)
    spread = np.empty((count, count))
    for a in range(count):
        for b in range(count):
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
    by_scales, by_state, by_motion = np.empty((6, 6)), np.eye(8), np.empty((3, 3))
    x, y, heading = linearise(pose, scales, motion, by_scales, by_motion)
    by_state[:6, :6] = by_scales
    for a in range(3):
        for b in range(3):
            by_state[a, 7] += by_motion[a, b] * by_delay[b]
    by_state[2, 6] = seconds
    added = times(times(by_motion, noise), by_motion.T)
    return (x, y, heading), by_state[:3, 7], added, propagate(joint, by_state, added, seconds * drift)


@njit(cache=True)
def propagate(joint, by_state, noise, drift):  # type: ignore[no-untyped-def]
    """Covariance (N, N) after a motion: by_state (M, M), derivative of the first M states after it by those before;
    noise (3, 3): what the motion adds to that of the pose; drift (N,): to every variance.
    """
    out, moved = joint.copy(), len(by_state)
    block = times(by_state, joint[:moved])
    for a in range(moved):
        for b in range(moved):
            out[a, b] = 0.0
            for k in range(moved):
                out[a, b] += block[a, k] * by_state[b, k]
        for b in range(moved, len(joint)):
            out[a, b] = out[b, a] = block[a, b]
    for a in range(len(joint)):
        out[a, a] += drift[a]
    out[:3, :3] += noise
    return out


@njit(cache=True)
def expected_information(joint, measured, per_image):  # type: ignore[no-untyped-def]
    """Inverse covariance (S, S) of what an image will show."""
    spread = measured_covariance(joint, measured, per_image)
    for a in range(len(measured)):
        spread[a, a] += _EXACT
    return inverse(spread)


@njit(cache=True)
def pose_innovation(joint, measured, per_image, information, gradient, residual):  # type: ignore[no-untyped-def]
    """How far the pose by an image alone lies from the prediction (3,), and its squared Mahalanobis distance."""
    pose = information[:3, :3].copy()
    for a in range(3):
        pose[a, a] += _ANYWHERE_INFORMATION[a]
    spread = inverse(pose)  # of the pose by the image
    by_state = times(spread, information[:3])  # of that pose by pose and errors
    off = np.zeros(3)
    for a in range(3):
        for b in range(3):
            off[a] += spread[a, b] * gradient[b]
        for b in range(len(measured)):
            off[a] += by_state[a, b] * residual[b]
    crossed = times(by_state, measured_covariance(joint, measured, per_image))
    for a in range(3):
        for b in range(3):
            for k in range(len(measured)):
                spread[a, b] += crossed[a, k] * by_state[b, k]
    weight, distance2 = inverse(spread), 0.0
    for a in range(3):
        for b in range(3):
            distance2 += weight[a, b] * off[a] * off[b]
    return off, distance2


@njit(cache=True)
def correction(joint, measured, per_image, information, gradient, residual, learned):  # type: ignore[no-untyped-def]
    """Step (N,) of the states, and covariance (N, N) after it; learned (N,): share of its step that each takes."""
    count, states = len(measured), len(joint)
    crossed, step, after = np.empty((states, count)), np.zeros(states), np.empty((states, states))
    spread = measured_covariance(joint, measured, per_image)
    damping = times(information, spread)
    predicted_information = information + times(damping, information)
    for b in range(count):
        damping[b, b] += 1.0
        for a in range(states):
            crossed[a, b] = joint[a, measured[b]]
    gain = times(crossed, inverse(damping))
    for b in range(count):
        pull = gradient[b]
        for k in range(count):
            pull += information[b, k] * residual[k]
        for a in range(states):
            gain[a, b] *= learned[a]
            step[a] += gain[a, b] * pull
    shared, spent = times(gain, information), times(gain, predicted_information)
    for a in range(states):
        for b in range(a + 1):
            left = joint[a, b]
            for k in range(count):
                left += spent[a, k] * gain[b, k] - shared[a, k] * crossed[b, k] - crossed[a, k] * shared[b, k]
            after[a, b] = after[b, a] = left
    return step, after


@njit(cache=True)
def degrees_of_freedom_and_lean(per_image, expected, information, strain):  # type: ignore[no-untyped-def]
    """Effective degrees of freedom of an image, of S, and the mean square of its own lean.

    expected (S, S): `expected_information`; strain (S,): from what was expected to the fit. The lean, the first two of
    the errors, is what this image's differ by from the camera's, and how unsure that still is.
    """
    after, freedom, square = inverse(expected + information), 0.0, 0.0
    by_all = times(per_image[:2], expected[3:])  # of the image's lean by what it differs by from what was expected
    unsure = times(by_all, after)
    for a in range(len(after)):
        for b in range(len(after)):
            freedom += information[a, b] * after[b, a]
    for a in range(2):
        lean, left = 0.0, per_image[a, a]
        for b in range(len(after)):
            lean += by_all[a, b] * strain[b]
            left += unsure[a, b] * by_all[a, b]
        for b in range(len(per_image)):
            left -= per_image[a, b] * by_all[a, 3 + b]
        square += 0.5 * (lean * lean + left)
    return freedom, square


@njit(cache=True)
def step_squares(joint, measured, per_image, information, gradient, residual, noise):  # type: ignore[no-untyped-def]
    """Squared errors (3,) of the motion since the image before, and what is unknown of them, by what an image shows.

    noise (3, 3): what the motion has added to the covariance of the pose.
    """
    count = len(measured)
    spread = measured_covariance(joint, measured, per_image)
    expected = inverse(spread)
    after = inverse(expected + information)
    pull = np.zeros(count)
    for a in range(count):
        pull[a] = gradient[a]
        for b in range(count):
            pull[a] += information[a, b] * residual[b]
    step, left = np.zeros(count), after - spread
    for a in range(count):
        for b in range(count):
            step[a] += after[a, b] * pull[b]
    by_all = times(np.ascontiguousarray(expected[:, :3]), noise)  # of the motion's error by what the image differs by
    squares = np.empty(3)
    for a in range(3):
        squares[a] = noise[a, a]
        for b in range(count):
            for k in range(count):
                squares[a] += by_all[b, a] * (step[b] * step[k] + left[b, k]) * by_all[k, a]
    return squares
