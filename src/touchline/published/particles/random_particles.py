"""Random particles: where particles start, and how many start anew so that a wrong belief can be left."""

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from touchline.field.region import Region
from touchline.geometry import FloatArray
from touchline.published.particles.particle_set import ParticleEstimate

WHOLE_FIELD = Region()

BEYOND_M = 1.0  # how far beyond the field particles start: the robot's margin


class UniformPoses(NamedTuple):
    """Poses drawn evenly over a region within reach_m (2,) of the centre.

    heading_rad: mean and standard deviation; None: everywhere, or half the circle, where a symmetric field without a
    region shows the same from the other half.
    """

    reach_m: FloatArray
    region: Region = WHOLE_FIELD
    heading_rad: tuple[float, float] | None = None
    symmetric: bool = False

    def draw(self, rng: np.random.Generator, count: int) -> FloatArray:
        """So many poses (count, 3)."""
        low = np.maximum(-self.reach_m, [self.region.min_x, self.region.min_y])
        high = np.minimum(self.reach_m, [self.region.max_x, self.region.max_y])
        poses = np.empty((count, 3))
        poses[:, :2] = rng.uniform(low, high, (count, 2))
        if self.heading_rad is not None:
            poses[:, 2] = self.heading_rad[0] + self.heading_rad[1] * rng.standard_normal(count)
        else:
            half = self.symmetric and self.region == WHOLE_FIELD
            poses[:, 2] = rng.uniform(-1.0, 1.0, count) * (0.5 * np.pi if half else np.pi)
        return poses


class PoseSource(Protocol):
    """Where particles start."""

    def draw(self, rng: np.random.Generator, count: int) -> FloatArray:
        """So many poses (count, 3)."""
        ...


class RandomInjection(Protocol):
    """Which ratio of the particles starts anew at a drawing, and where."""

    @property
    def poses(self) -> PoseSource:
        """Where."""
        ...

    def observe(self, weights: FloatArray, log_likelihoods: FloatArray) -> None:
        """Particles of these weights (N,), before, have got these likelihoods (N,)."""
        ...

    def ratio(self, estimate: ParticleEstimate) -> float:
        """The ratio, in [0, 1)."""
        ...


@dataclass(slots=True)
class InjectionUntilConverged:
    """Always the same ratio, until the particles lie closer than some standard deviations (m, rad)."""

    poses: UniformPoses
    random_ratio: float
    converged_m: float
    converged_rad: float

    def observe(self, weights: FloatArray, log_likelihoods: FloatArray) -> None:
        """Likelihoods change nothing."""

    def ratio(self, estimate: ParticleEstimate) -> float:
        """The ratio; 0 once the particles have converged."""
        converged = estimate.deviation_m < self.converged_m and estimate.deviation_rad < self.converged_rad
        return 0.0 if converged else self.random_ratio


@dataclass(slots=True)
class AugmentedInjection:
    """Augmented MCL: the more, the lower the likelihood is now, beside what it used to be.

    The ratio is max(min_ratio, 1 - w_fast / w_slow), with averages w of the mean likelihood that forget by the factors
    slow and fast (0 < slow < fast) in every cycle (Thrun, Burgard, Fox: Probabilistic Robotics, table 8.3). They are
    kept as logarithms, since a product of likelihoods may be too small for any number. observations: that the
    likelihood of now is the product of; its root, the likelihood of one, is what is averaged, so that a frame that
    shows more is no worse. 1 is the table's form.
    """

    poses: PoseSource
    slow: float = 0.05
    fast: float = 0.5
    min_ratio: float = 0.0
    max_ratio: float = 0.5
    observations: int = 1
    _log_slow: float = -math.inf
    _log_fast: float = -math.inf

    def observe(self, weights: FloatArray, log_likelihoods: FloatArray) -> None:
        """Take the mean likelihood into both averages; the first one starts them."""
        greatest = float(log_likelihoods.max())
        log_mean = greatest + math.log(float(weights @ np.exp(log_likelihoods - greatest)))
        log_mean /= self.observations
        if self._log_slow == -math.inf:
            self._log_slow = self._log_fast = log_mean
        else:
            self._log_slow = _averaged(self._log_slow, log_mean, self.slow)
            self._log_fast = _averaged(self._log_fast, log_mean, self.fast)

    def ratio(self, estimate: ParticleEstimate) -> float:
        """The ratio after the last observation."""
        return min(max(-math.expm1(self._log_fast - self._log_slow), self.min_ratio), self.max_ratio)


def _averaged(log_before: float, log_now: float, gain: float) -> float:
    """Logarithm of (1 - gain) before + gain now."""
    return float(np.logaddexp(math.log1p(-gain) + log_before, math.log(gain) + log_now))
