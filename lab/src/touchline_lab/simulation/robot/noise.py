"""Random processes of the sensors, each with the moments that its settings name."""

import math

import numpy as np
from numba import njit

from touchline.geometry import FloatArray

_WAVES = 24


class PlaceDisturbance:
    """A smooth random function of the place, zero mean, root mean square `rms`: a sum of waves 3 to 10 m long.

    Iron in the floor and cables under it turn the compass like this: the same error whenever the robot is there.
    """

    def __init__(self, rms: float, rng: np.random.Generator) -> None:
        lengths_m = rng.uniform(3.0, 10.0, _WAVES)
        directions = rng.uniform(0.0, 2.0 * math.pi, _WAVES)
        self._waves = 2.0 * math.pi / lengths_m * np.stack((np.cos(directions), np.sin(directions)))
        self._phases = rng.uniform(0.0, 2.0 * math.pi, _WAVES)
        self._height = rms * math.sqrt(2.0 / _WAVES)

    def at(self, places_m: FloatArray) -> FloatArray:
        """Values (N,) at places (N, 2) in the field frame."""
        return self._height * np.cos(places_m @ self._waves + self._phases).sum(axis=1)


def drift(count: int, period_s: float, rms: float, time_constant_s: float, rng: np.random.Generator) -> FloatArray:
    """(count,) samples of noise with exponential correlation (Ornstein-Uhlenbeck), started in its steady state."""
    keep = math.exp(-period_s / time_constant_s)
    kicks = rms * math.sqrt(1.0 - keep * keep) * rng.standard_normal(count)
    return _decaying_sum(rms * float(rng.standard_normal()), kicks, keep)


def random_walk(count: int, period_s: float, after_one_second: float, rng: np.random.Generator) -> FloatArray:
    """(count,) samples of a random walk from zero whose standard deviation after one second is given."""
    steps = after_one_second * math.sqrt(period_s) * rng.standard_normal(count)
    steps[0] = 0.0
    return np.cumsum(steps)


@njit(cache=True)
def _decaying_sum(value: float, kicks: FloatArray, keep: float) -> FloatArray:
    """(N,): value, then at every step keep times the one before plus the kick (N,)."""
    out = np.empty(len(kicks))
    for i in range(len(kicks)):
        out[i] = value
        value = keep * value + kicks[i]
    return out
