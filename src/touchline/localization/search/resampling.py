"""Numba loops that draw poses by their weights, and temper weights."""

import math

import numba
import numpy as np


@numba.njit(cache=True)
def low_variance(poses, weights, start, count):  # type: ignore[no-untyped-def]
    """Low-variance resampling: (count, 3) of poses (N, 3), one comb of teeth through the weights (N,), which sum to 1.

    start: in [0, 1) of a tooth. Every particle is drawn floor(count w) or floor(count w) + 1 times, and count w times
    on average over all starts (Thrun, Burgard, Fox: Probabilistic Robotics, table 4.4).
    """
    out = np.empty((count, 3))
    last = poses.shape[0] - 1
    j = 0
    reached = weights[0]
    for k in range(count):
        tooth = (start + k) / count
        while tooth >= reached and j < last:
            j += 1
            reached += weights[j]
        for axis in range(3):  # copying a row at once would take a second to compile
            out[k, axis] = poses[j, axis]
    return out


@numba.njit(cache=True)
def tempering(log_weights, min_effective):  # type: ignore[no-untyped-def]
    """Largest exponent in (0, 1] of the weights that leaves an effective sample size of min_effective or more.

    log_weights (N,): logarithms, but for a constant. The effective sample size falls with the exponent from N on;
    halving finds a bracket, bisection narrows it to 2 %.
    """
    greatest = -np.inf
    for j in range(log_weights.shape[0]):
        greatest = max(greatest, log_weights[j])
    low, high, exponent = 0.0, 1.0, 1.0
    while True:
        total = squares = 0.0
        for j in range(log_weights.shape[0]):
            weight = math.exp(exponent * (log_weights[j] - greatest))
            total += weight
            squares += weight * weight
        if total * total >= min_effective * squares:
            low = exponent
        else:
            high = exponent
        if low >= 0.98 * high or exponent < 1e-9:
            return low if low > 0.0 else exponent
        exponent = 0.5 * high if low == 0.0 else 0.5 * (low + high)
