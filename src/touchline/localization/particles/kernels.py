"""Numba loops of Monte Carlo localization: motion, sensor model, resampling, mean.

Everywhere: particles (N, 3) as x, y (m), heading (rad) in the field frame; log_weights and weights (N,). Every loop
runs once over the particles, so a cycle costs time in proportion to particles times points.
"""

from __future__ import annotations

import math

import numba
import numpy as np


@numba.njit(cache=True)
def move(particles, motion, deviations, normals):  # type: ignore[no-untyped-def]
    """Move every particle by the odometry's motion (3,) and its own share of the noise; in place.

    motion: `before_from_after`. deviations (3,): standard deviations along x, y of the robot (m) and of the heading
    (rad). normals (N, 3): standard normal numbers. The motion model P(l | l', a) of Lu et al. 2013, section 4.
    """
    for j in range(particles.shape[0]):
        cosine, sine = math.cos(particles[j, 2]), math.sin(particles[j, 2])
        ahead = motion[0] + deviations[0] * normals[j, 0]
        left = motion[1] + deviations[1] * normals[j, 1]
        particles[j, 0] += cosine * ahead - sine * left
        particles[j, 1] += sine * ahead + cosine * left
        particles[j, 2] += motion[2] + deviations[2] * normals[j, 2]


@numba.njit(cache=True)
def add_log_likelihoods(particles, points, shares, squares, origin_x, origin_y, resolution_m, factor, log_weights):  # type: ignore[no-untyped-def]
    """Add the sensor model's logarithm to the log weights, in place: equations (1) to (3) of Lu et al. 2013.

    log P(o | l) = -factor · sum of share d². With shares 1 and factor 1 / (2 σ²) this is the paper's product.
    points (M, 2): robot frame, m. shares (M,). squares (ny, nx) float32: squared distance to the nearest line (m²) at
    origin + resolution · (ix, iy); the nearest sample counts, at the table's edge for points beyond it.
    """
    last_x, last_y = float(squares.shape[1] - 1), float(squares.shape[0] - 1)
    samples_per_m = 1.0 / resolution_m
    for j in range(particles.shape[0]):
        cosine, sine = math.cos(particles[j, 2]) * samples_per_m, math.sin(particles[j, 2]) * samples_per_m
        shift_x = (particles[j, 0] - origin_x) * samples_per_m + 0.5
        shift_y = (particles[j, 1] - origin_y) * samples_per_m + 0.5
        total = 0.0
        for i in range(points.shape[0]):
            fx = shift_x + cosine * points[i, 0] - sine * points[i, 1]
            fy = shift_y + sine * points[i, 0] + cosine * points[i, 1]
            fx = min(fx, last_x) if fx > 0.0 else 0.0  # written so that NaN never becomes an index
            fy = min(fy, last_y) if fy > 0.0 else 0.0
            total += shares[i] * squares[np.uint64(int(fy)), np.uint64(int(fx))]
        log_weights[j] -= factor * total


@numba.njit(cache=True)
def normalize(log_weights, weights):  # type: ignore[no-untyped-def]
    """Fill weights with exp(log_weights), normalized to the sum 1; returns the effective sample size.

    The greatest logarithm is taken off first, from log_weights too: whatever the product of equation (3) comes to,
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
def tempering(log_weights, least_effective):  # type: ignore[no-untyped-def]
    """Largest exponent in (0, 1] of the weights that leaves an effective sample size of least_effective or more.

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
        if total * total >= least_effective * squares:
            low = exponent
        else:
            high = exponent
        if low >= 0.98 * high or exponent < 1e-9:
            return low if low > 0.0 else exponent
        exponent = 0.5 * high if low == 0.0 else 0.5 * (low + high)


@numba.njit(cache=True)
def mean_and_covariance(particles, weights):  # type: ignore[no-untyped-def]
    """Weighted mean (3,), circular in the heading, and covariance (3, 3) about it in (m, m, rad)."""
    x = y = cosine = sine = 0.0
    for j in range(particles.shape[0]):
        w = weights[j]
        x += w * particles[j, 0]
        y += w * particles[j, 1]
        cosine += w * math.cos(particles[j, 2])
        sine += w * math.sin(particles[j, 2])
    mean = np.array([x, y, math.atan2(sine, cosine)])
    covariance = np.zeros((3, 3))
    away = np.empty(3)
    for j in range(particles.shape[0]):
        away[0] = particles[j, 0] - x
        away[1] = particles[j, 1] - y
        turned = particles[j, 2] - mean[2]
        away[2] = turned - 2.0 * math.pi * math.floor(turned / (2.0 * math.pi) + 0.5)
        for a in range(3):
            for b in range(a + 1):
                covariance[a, b] += weights[j] * away[a] * away[b]
    for a in range(3):
        for b in range(a):
            covariance[b, a] = covariance[a, b]
    return mean, covariance


@numba.njit(cache=True)
def resample(particles, weights, start, out):  # type: ignore[no-untyped-def]
    """Low-variance resampling into out (M, 3): one comb of M teeth, start in [0, 1) of a tooth, through the weights.

    Every particle is drawn floor(M w) or floor(M w) + 1 times, and M w times on average over all starts (Thrun,
    Burgard, Fox: Probabilistic Robotics, table 4.4). weights sum to 1.
    """
    count = out.shape[0]
    last = particles.shape[0] - 1
    j = 0
    reached = weights[0]
    for k in range(count):
        tooth = (start + k) / count
        while tooth >= reached and j < last:
            j += 1
            reached += weights[j]
        out[k] = particles[j]


@numba.njit(cache=True)
def occupied_bins(particles, middle, size_m, size_rad):  # type: ignore[no-untyped-def]
    """How many bins of size_m x size_m x size_rad hold a particle.

    middle (3,): a pose in the middle of a bin. With the particles' mean there, a narrow cloud fills one bin wherever
    it lies.
    """
    turns = max(1, round(2.0 * math.pi / size_rad))
    keys = np.empty(particles.shape[0], dtype=np.int64)
    for j in range(particles.shape[0]):
        ix = math.floor((particles[j, 0] - middle[0]) / size_m + 0.5) + 100_000
        iy = math.floor((particles[j, 1] - middle[1]) / size_m + 0.5) + 100_000
        turned = (particles[j, 2] - middle[2]) / (2.0 * math.pi) * turns + 0.5
        keys[j] = (ix * 200_001 + iy) * turns + math.floor(turned) % turns
    keys.sort()
    count = 1
    for j in range(1, keys.shape[0]):
        if keys[j] != keys[j - 1]:
            count += 1
    return count
