"""Resampling: when particles are drawn anew, how, and how many of them."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from pydantic import Field

from touchline.config import Settings
from touchline.geometry import FloatArray, Pose
from touchline.localization.search.resampling import low_variance
from touchline.published.particles.particle_set import ParticleEstimate, ParticleSet

EVERY_CYCLE = math.inf


class ParticleNumber(Protocol):
    """How many particles are needed."""

    def __call__(self, drawn: FloatArray, estimate: ParticleEstimate) -> int:
        """drawn (N, 3): as many poses as before, drawn just now. estimate: of the particles before."""
        ...


@dataclass(frozen=True, slots=True)
class Resampling:
    """The resampling policy.

    threshold: ratio of effective particles below which they are drawn anew (Thrun, Burgard, Fox: Probabilistic
    Robotics, section 4.3.4); EVERY_CYCLE draws always. number: how many; None: as many as before. roughening: noise
    that drawn particles get when they move next, as a ratio of their extent over the cube root of their number, so
    that copies search between the originals (Gordon, Salmond, Smith 1993). mean_of_drawn: the estimate is that of the
    drawn particles, as equations (11) to (14) of Ismail et al. 2021 have it; else of the weighted ones, which is surer.
    """

    threshold: float = 0.5
    number: int | ParticleNumber | None = None
    roughening: float = 0.0
    mean_of_drawn: bool = False

    def is_due(self, effective: float, count: int) -> bool:
        """Whether so many effective particles of all are too few."""
        return effective < self.threshold * count

    def draw(self, particles: ParticleSet, estimate: ParticleEstimate, rng: np.random.Generator) -> FloatArray:
        """Poses (M, 3), drawn in proportion to the weights."""
        start, count = float(rng.random()), len(particles)
        drawn: FloatArray = low_variance(particles.poses, particles.weights, start, count)
        wanted = self.number or count
        if callable(wanted):
            wanted = wanted(drawn, estimate)
        return drawn if wanted == count else low_variance(particles.poses, particles.weights, start, wanted)

    def roughness(self, drawn: ParticleEstimate, count: int) -> FloatArray | None:
        """Standard deviations (3,), m, m, rad, of the noise that drawn particles get; None without any."""
        if not self.roughening:
            return None
        ratio = 4.0 * self.roughening * count ** (-1.0 / _DIMENSIONS)
        along = math.sqrt(0.5) * drawn.deviation_m
        return np.array([ratio * along, ratio * along, ratio * drawn.deviation_rad])


_DIMENSIONS = 3  # of a pose


@dataclass(frozen=True, slots=True)
class CertaintyNumber:
    """Between min_count and max_count, in proportion to the standard deviation of the position.

    Schulz and Behnke 2012, section 6: 250 to 1000 particles, depending on the certainty of the pose. uncertain_m:
    deviation from which there are most.
    """

    min_count: int = 250
    max_count: int = 1000
    uncertain_m: float = 1.0

    def __call__(self, drawn: FloatArray, estimate: ParticleEstimate) -> int:
        """The number for an estimate."""
        ratio = min(estimate.deviation_m / self.uncertain_m, 1.0)
        return self.min_count + round(ratio * (self.max_count - self.min_count))


KLD_ERROR = 0.05  # largest distance (nats) between the samples and the truth: Fox's
KLD_QUANTILE = 2.326  # standard normal quantile of keeping it: 99 %, as Fox
BIN_M = 0.5  # size of a bin in x and y: Fox's 50 cm
BIN_RAD = 0.2618  # size of a bin in heading: Fox's 15 degrees
# ratio of the particles that every drawing keeps at least: one good draw may agree on a look-alike place, five in a row
# don't. Near 0 is Fox's own, the number that is asked for at once
MIN_KEPT_RATIO = 0.5
MIN_PARTICLES = 1  # fewest particles: one when certain (references 8 and 9)


class AdaptiveSettings(Settings):
    """Particle numbers by Kullback-Leibler distance (Fox 2003: Adapting the sample size in particle filters).

    References 8, 9, 12 of Lu et al. 2013, who keep 600.
    """

    enabled: bool = Field(False, description="draw only as many particles as the spread asks for; the paper keeps all")


@dataclass(frozen=True, slots=True)
class KldNumber:
    """As few as keep the Kullback-Leibler distance below its limit; never more than before."""

    def __call__(self, drawn: FloatArray, estimate: ParticleEstimate) -> int:
        """The number for the bins that the drawn particles occupy."""
        wanted = kld_number(occupied_bins(drawn, estimate.pose, BIN_M, BIN_RAD))
        return min(max(wanted, int(MIN_KEPT_RATIO * len(drawn))), len(drawn))


def kld_number(bins: int) -> int:
    """Particles that keep the Kullback-Leibler distance below its limit, for so many occupied bins (Fox 2003, eq. 7).

    A single bin needs a single particle.
    """
    if bins <= 1:
        return MIN_PARTICLES
    a = 2.0 / (9.0 * (bins - 1))
    number = (bins - 1) / (2.0 * KLD_ERROR) * (1.0 - a + math.sqrt(a) * KLD_QUANTILE) ** 3
    return max(MIN_PARTICLES, math.ceil(number))


def occupied_bins(poses: FloatArray, middle: Pose, size_m: float, size_rad: float) -> int:
    """How many bins of size_m x size_m x size_rad hold one of the poses (N, 3).

    middle: the middle of a bin. With the particles' mean there, a narrow cloud fills one bin wherever it lies.
    """
    turns = max(1, round(2.0 * math.pi / size_rad))
    size = np.array([size_m, size_m, 2.0 * math.pi / turns])
    bins = np.floor((poses - middle.as_array()) / size + 0.5).astype(np.int64)
    bins[:, 2] %= turns
    far = 100_000  # more bins than any field has along one side
    return len(np.unique(((bins[:, 0] + far) * (2 * far + 1) + bins[:, 1] + far) * turns + bins[:, 2]))
