"""The particle set: weighted samples of where the robot may stand, their mean and their spread."""

import math
from typing import NamedTuple

import numba
import numpy as np

from touchline.geometry import FloatArray, Pose, as_pose, deviation_m, deviation_rad


class ParticleEstimate(NamedTuple):
    """What the particles say: their mean and covariance (3, 3) in (m, m, rad), field frame.

    points: line points that they were weighed by. inlier_ratio: how many of them lie on lines, seen from the mean; NaN
    where nobody looked.
    """

    pose: Pose
    covariance: FloatArray
    points: int = 0
    inlier_ratio: float = math.nan

    @property
    def deviation_m(self) -> float:
        """Standard deviation of the position (m)."""
        return deviation_m(self.covariance)

    @property
    def deviation_rad(self) -> float:
        """Standard deviation of the heading (rad)."""
        return deviation_rad(self.covariance)


class ParticleSet:
    """Particles with their importance weights.

    poses (N, 3): x, y (m), heading (rad), field frame. log_weights (N,): but for a constant. weights (N,): they sum to
    1 and hold what log_weights held at the last `normalize`.
    """

    def __init__(self, poses: FloatArray, single_covariance: FloatArray | None = None) -> None:
        """poses (N, 3), float64, contiguous; not copied.

        single_covariance (3, 3): of all the poses that a particle stands for when it is the only one.
        """
        self.single_covariance = np.zeros((3, 3)) if single_covariance is None else single_covariance
        self.replace(poses)

    def __len__(self) -> int:
        return len(self.poses)

    def replace(self, poses: FloatArray) -> None:
        """Other particles (N, 3) take the place of these, all of the same weight."""
        self.poses = poses
        self.log_weights = np.zeros(len(poses))
        self.weights = np.full(len(poses), 1.0 / len(poses))

    def normalize(self) -> float:
        """Take the weights from their logarithms; returns the effective sample size."""
        return float(normalize(self.log_weights, self.weights))

    def estimate(self) -> ParticleEstimate:
        """Weighted mean, circular in the heading, and covariance about it."""
        mean, covariance = mean_and_covariance(self.poses, self.weights)
        return ParticleEstimate(as_pose(mean), self.single_covariance.copy() if len(self) == 1 else covariance)


@numba.njit(cache=True)
def normalize(log_weights, weights):  # type: ignore[no-untyped-def]
    """Fill weights (N,) with exp(log_weights), normalized to the sum 1; returns the effective sample size.

    The greatest logarithm is taken off first, from log_weights (N,) too: whatever a product of likelihoods comes to,
    the best particle's exponent is zero, so nothing can underflow but particles that don't count.
    """
    greatest = -np.inf
    for j in range(log_weights.shape[0]):
        greatest = max(greatest, log_weights[j])
    total = squares = 0.0
    for j in range(log_weights.shape[0]):
        log_weights[j] -= greatest
        weights[j] = math.exp(log_weights[j])
        total += weights[j]
        squares += weights[j] * weights[j]
    for j in range(weights.shape[0]):
        weights[j] /= total
    return total * total / squares


@numba.njit(cache=True)
def mean_and_covariance(poses, weights):  # type: ignore[no-untyped-def]
    """Weighted mean (3,) of poses (N, 3), circular in the heading, and covariance (3, 3) about it in (m, m, rad).

    The sums are single numbers, not arrays: that compiles in half the time.
    """
    x = y = cosine = sine = 0.0
    for j in range(poses.shape[0]):
        w = weights[j]
        x += w * poses[j, 0]
        y += w * poses[j, 1]
        cosine += w * math.cos(poses[j, 2])
        sine += w * math.sin(poses[j, 2])
    heading = math.atan2(sine, cosine)
    xx = xy = yy = xt = yt = tt = 0.0
    for j in range(poses.shape[0]):
        dx, dy, turned = poses[j, 0] - x, poses[j, 1] - y, poses[j, 2] - heading
        turned -= 2.0 * math.pi * math.floor(turned / (2.0 * math.pi) + 0.5)
        wx, wy, wt = weights[j] * dx, weights[j] * dy, weights[j] * turned
        xx += wx * dx
        xy += wy * dx
        yy += wy * dy
        xt += wt * dx
        yt += wt * dy
        tt += wt * turned
    mean, covariance = np.empty(3), np.empty((3, 3))
    mean[0], mean[1], mean[2] = x, y, heading
    covariance[0, 0], covariance[1, 1], covariance[2, 2] = xx, yy, tt
    covariance[0, 1] = covariance[1, 0] = xy
    covariance[0, 2] = covariance[2, 0] = xt
    covariance[1, 2] = covariance[2, 1] = yt
    return mean, covariance
