"""Which of many poses are the same, and which modes lie over each other: compiled loops over pairs."""

import math

import numba
import numpy as np


@numba.njit(cache=True, error_model="numpy", inline="always")
def _turn(angle):  # type: ignore[no-untyped-def]
    """Wrapped to [-π, π)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@numba.njit(cache=True, error_model="numpy", inline="always")
def _away(one, other, twin, away):  # type: ignore[no-untyped-def]
    """Pose (3,) minus another, or minus its twin, into away (3,)."""
    sign = -1.0 if twin else 1.0
    away[0], away[1] = one[0] - sign * other[0], one[1] - sign * other[1]
    away[2] = _turn(one[2] - other[2] - (math.pi if twin else 0.0))


@numba.njit(cache=True, error_model="numpy", inline="always")
def _distance2(information, away):  # type: ignore[no-untyped-def]
    """Squared Mahalanobis distance of a difference (3,)."""
    d2 = 0.0
    for a in range(3):
        for b in range(3):
            d2 += information[a, b] * away[a] * away[b]
    return d2


@numba.njit(cache=True, error_model="numpy")
def distinct(poses, information, same, twins, count):  # type: ignore[no-untyped-def]
    """Indices of poses (N, 3), up to count, that are none of those before them; twins: nor the twin of one.

    A pose is another's if it is nearer than same (m in x and y, rad), or within one standard deviation of it by that
    one's information (N, 3, 3): along a direction that no line observes, one pose stands for all. Where fewer than
    count are left so, those that stand along such a direction follow.
    """
    kept, found = np.empty(min(count, poses.shape[0]), dtype=np.int64), 0
    same_m, same_rad = same
    away = np.empty(3)
    for d2 in (1.0, 0.0):
        for i in range(poses.shape[0]):
            if found == kept.shape[0]:
                break
            free = True
            for k in range(found):
                for twin in range(2 if twins else 1):
                    _away(poses[i], poses[kept[k]], twin == 1, away)
                    near = abs(away[0]) < same_m and abs(away[1]) < same_m and abs(away[2]) < same_rad
                    if near or _distance2(information[kept[k]], away) < d2:
                        free = False
                if not free:
                    break
            if free:
                kept[found] = i
                found += 1
    return kept[:found]


@numba.njit(cache=True, error_model="numpy")
def overlaps(poses, information, twins):  # type: ignore[no-untyped-def]
    """(N,): how many of the modes (N, 3) with information (N, 3, 3) each lies over, itself 1, the far ones 0.

    The sum of exp(-d²/2), d the Mahalanobis distance to each by the mean of both informations. twins: or to its twin.
    Modes along a direction that no line observes lie over each other; divided by this, together they weigh as one.
    """
    sums = np.ones(poses.shape[0])
    away = np.empty(3)
    for i in range(poses.shape[0]):
        for j in range(i):
            for twin in range(2 if twins else 1):
                _away(poses[i], poses[j], twin == 1, away)
                near = math.exp(-0.25 * (_distance2(information[i], away) + _distance2(information[j], away)))
                sums[i] += near
                sums[j] += near
    return sums
