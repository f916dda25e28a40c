"""What an experiment gives: a table of our figures beside the paper's, pictures, and one headline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from touchline.geometry import FloatArray


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
