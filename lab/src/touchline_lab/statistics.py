"""Figures over robots with their 95 % intervals."""

import math
import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from touchline.geometry import FloatArray


class Interval(NamedTuple):
    """A figure over robots, and where it lies with 95 %."""

    value: float
    low: float
    high: float


def over_robots(values: Sequence[float] | FloatArray, statistic: Any = np.median) -> Interval:
    """A statistic over robots, its interval by BCa bootstrap (Efron 1987), robots drawn anew with replacement; by plain
    percentiles where BCa is not defined, none for one robot and for values that are not finite.
    """
    from scipy.stats import bootstrap

    numbers = np.asarray(values, dtype=np.float64)
    known = numbers[~np.isnan(numbers)]
    if not len(known):
        return Interval(math.nan, math.nan, math.nan)
    value = float(statistic(known))
    if len(known) < 2 or not np.isfinite(known).all() or np.ptp(known) == 0.0:
        return Interval(value, value, value)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for method in ("BCa", "percentile"):
            drawn = bootstrap((known,), statistic, method=method, n_resamples=2000, random_state=0)
            low, high = map(float, drawn.confidence_interval)
            if math.isfinite(low) and math.isfinite(high):
                break
    return Interval(value, low, high)


def per_hour(times: int, seconds: float) -> Interval:
    """Of so many in a time: per hour, with the upper bound of 95 % of a Poisson process (low is 0)."""
    from scipy.stats import chi2

    hours = seconds / 3600.0
    return Interval(times / hours, 0.0, float(chi2.ppf(0.95, 2 * times + 2)) / 2.0 / hours)
