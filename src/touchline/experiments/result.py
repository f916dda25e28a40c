"""What an experiment gives: a table of our figures beside the paper's, pictures, and one headline."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from touchline.geometry import FloatArray

_DRAWS = 2000
_Z = 1.959964  # of the normal distribution, 95 % between both signs


@dataclass(frozen=True, slots=True)
class Headline:
    """The one row of the results page: what was measured, the paper's figure, ours."""

    what: str
    paper: str
    ours: str


@dataclass(frozen=True, eq=False, slots=True)
class ExperimentResult:
    """Result of an experiment over `seeds` seeds.

    columns, rows: the table, as text; numbers are means over the seeds, ± is their standard deviation. notes: whole
    sentences on what was simulated and counted. pictures: by name, without ending.
    """

    name: str
    title: str
    seeds: int
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    headline: Headline
    notes: tuple[str, ...] = ()
    pictures: tuple[tuple[str, Figure], ...] = ()


def spread(values: Sequence[float] | FloatArray, decimals: int = 2) -> str:
    """Mean ± standard deviation over the seeds (of N - 1); a lone value stands alone, a dash for none."""
    numbers = np.asarray(values, dtype=np.float64)
    if len(numbers) == 0:
        return "–"
    if len(numbers) == 1:
        return f"{numbers[0]:.{decimals}f}"
    return f"{numbers.mean():.{decimals}f} ± {numbers.std(ddof=1):.{decimals}f}"


def percent(values: Sequence[float] | FloatArray) -> str:
    """`spread` of shares, in per cent."""
    shares = np.asarray(values, dtype=np.float64)
    return f"{spread(100.0 * shares, 1)} %" if len(shares) else "–"


def interval(values: Sequence[float] | FloatArray, decimals: int = 2) -> str:
    """Mean over robots and, in brackets, where it lies with 95 %: by bootstrap, robots drawn anew with replacement."""
    if len(values) < 2:
        return spread(values, decimals)
    mean, low, high = mean_interval(values)
    return f"{mean:.{decimals}f} [{low:.{decimals}f}, {high:.{decimals}f}]"


def mean_interval(values: Sequence[float] | FloatArray) -> tuple[float, float, float]:
    """Mean of one value or more, and where it lies with 95 %, by bootstrap."""
    numbers = np.asarray(values, dtype=np.float64)
    drawn = np.random.default_rng(0).choice(numbers, (_DRAWS, len(numbers))).mean(axis=1)
    low, high = np.quantile(drawn, (0.025, 0.975)).tolist()
    return float(numbers.mean()), low, high


def rate(successes: int, tries: int) -> str:
    """A share in per cent with Wilson's 95 % interval of a binomial one; a dash for no tries."""
    if tries == 0:
        return "–"
    low, high = wilson(successes, tries)
    return f"{100.0 * successes / tries:.1f} % [{100.0 * low:.1f}, {100.0 * high:.1f}]"


def wilson(successes: int, tries: int) -> tuple[float, float]:
    """Bounds of a binomial share with 95 % (Wilson, 1927)."""
    share, square = successes / tries, _Z**2 / tries
    middle = share + 0.5 * square
    half = _Z * math.sqrt(share * (1.0 - share) / tries + 0.25 * square / tries)
    return max(0.0, (middle - half) / (1.0 + square)), min(1.0, (middle + half) / (1.0 + square))
