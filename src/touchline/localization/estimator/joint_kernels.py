"""Numba loops of the filter of pose and mirror errors: a dozen states, for which NumPy takes longer than their sums.

Everywhere: joint (N, N), covariance of all states; seen (S,), those that a fit measures: x, y, heading and the mirror's
errors; swing (S - 3, S - 3), covariance of what shaking adds to the errors of an image; information (S, S) and gradient
(S,) of the points of an image, as of `StateFit`; away (S,), from what was expected to where the fit ended.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from touchline.localization.published.nubot.mirror_fit import inverse, times

_EXACT = 1e-14  # variance of what is known exactly
_NOWHERE = (1e-2, 1e-2, 1.0 / 9.0)  # inverse variances of a pose somewhere on a field


@njit(cache=True)
def _spread(joint, seen, swing):  # type: ignore[no-untyped-def]
    """Covariance (S, S) of what an image shows."""
    count = len(seen)
    spread = np.empty((count, count))
    for a in range(count):
        for b in range(count):
            spread[a, b] = joint[seen[a], seen[b]]
            if a >= 3 and b >= 3:
                spread[a, b] += swing[a - 3, b - 3]
    return spread


@njit(cache=True)
def carried(joint, by_state, more, drift):  # type: ignore[no-untyped-def]
    """Covariance (N, N) after a motion: by_state (M, M), derivative of the first M states after it by those before;
    more (3, 3): what the motion adds to that of the pose; drift (N,): to every variance.
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
    out[:3, :3] += more
    return out


@njit(cache=True)
def expected_information(joint, seen, swing):  # type: ignore[no-untyped-def]
    """Inverse covariance (S, S) of what an image will show."""
    spread = _spread(joint, seen, swing)
    for a in range(len(seen)):
        spread[a, a] += _EXACT
    return inverse(spread)


@njit(cache=True)
def innovation_of(joint, seen, swing, information, gradient, away):  # type: ignore[no-untyped-def]
    """How far the pose by the lines alone lies from the prediction (3,), and its squared Mahalanobis distance."""
    pose = information[:3, :3].copy()
    for a in range(3):
        pose[a, a] += _NOWHERE[a]
    spread = inverse(pose)  # of the pose by the lines
    by_state = times(spread, information[:3])  # of that pose by pose and errors
    off = np.zeros(3)
    for a in range(3):
        for b in range(3):
            off[a] += spread[a, b] * gradient[b]
        for b in range(len(seen)):
            off[a] += by_state[a, b] * away[b]
    crossed = times(by_state, _spread(joint, seen, swing))
    for a in range(3):
        for b in range(3):
            for k in range(len(seen)):
                spread[a, b] += crossed[a, k] * by_state[b, k]
    strange, distance2 = inverse(spread), 0.0
    for a in range(3):
        for b in range(3):
            distance2 += strange[a, b] * off[a] * off[b]
    return off, distance2


@njit(cache=True)
def correction_of(joint, seen, swing, information, gradient, away, moving):  # type: ignore[no-untyped-def]
    """Step (N,) of the states, and their covariance (N, N) after it; moving (N,): share of its step that each takes."""
    count, states = len(seen), len(joint)
    crossed, step, after = np.empty((states, count)), np.zeros(states), np.empty((states, states))
    spread = _spread(joint, seen, swing)
    resting = times(information, spread)
    told = information + times(resting, information)
    for b in range(count):
        resting[b, b] += 1.0
        for a in range(states):
            crossed[a, b] = joint[a, seen[b]]
    gain = times(crossed, inverse(resting))  # of what was said
    for b in range(count):
        said = gradient[b]
        for k in range(count):
            said += information[b, k] * away[k]
        for a in range(states):
            gain[a, b] *= moving[a]
            step[a] += gain[a, b] * said
    shared, spent = times(gain, information), times(gain, told)
    for a in range(states):
        for b in range(a + 1):
            left = joint[a, b]
            for k in range(count):
                left += spent[a, k] * gain[b, k] - shared[a, k] * crossed[b, k] - crossed[a, k] * shared[b, k]
            after[a, b] = after[b, a] = left
    return step, after


@njit(cache=True)
def shown_of(swing, expected, information, strain):  # type: ignore[no-untyped-def]
    """How many numbers the points of an image tell, of the S that they are asked, and the mean square of its own lean.

    expected (S, S): `expected_information`; strain (S,): from what was expected to the fit. The lean, the first two of
    the errors, is what this image's differ by from the head's, and how unsure that still is.
    """
    after, told, square = inverse(expected + information), 0.0, 0.0
    by_all = times(swing[:2], expected[3:])  # of the image's lean by what it differs by from what was expected
    unsure = times(by_all, after)
    for a in range(len(after)):
        for b in range(len(after)):
            told += information[a, b] * after[b, a]
    for a in range(2):
        lean, left = 0.0, swing[a, a]
        for b in range(len(after)):
            lean += by_all[a, b] * strain[b]
            left += unsure[a, b] * by_all[a, b]
        for b in range(len(swing)):
            left -= swing[a, b] * by_all[a, 3 + b]
        square += 0.5 * (lean * lean + left)
    return told, square
