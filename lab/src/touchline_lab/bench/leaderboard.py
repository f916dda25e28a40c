"""Tables of the benchmark, drawn from files of results alone."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from touchline_lab.bench.scoring import DriveScore, row_figures
from touchline_lab.bench.suite import TRACKS, Row, Suite
from touchline_lab.experiments.harness import NONE
from touchline_lab.statistics import Interval, over_robots

COLUMNS = (
    "condition", "field", "robots", "median (cm)", "95 % (cm)", "≤ 10 cm (%)", "≤ 30 cm (%)", "tracked (%)",
    "wrong an hour", "found after (s)", "NEES / 3", "covered (%)", "cost (cm)",
)  # fmt: skip
Table = Mapping[tuple[str, str], Sequence[DriveScore]]  # by row and system


class Place(NamedTuple):
    """A system on a track: its one figure over the rows that it has run, and how many these are of all."""

    system: str
    cost_cm: Interval
    rows: int
    of: int
    ratio: float
    """Median over rows of an update's time in the reference loop's; NaN where it was not measured."""
    mb: float


def systems_of(table: Table) -> list[str]:
    """Their names, in the order of the files."""
    return list(dict.fromkeys(system for _, system in table))


def rows_of(suite: Suite, track: str) -> list[Row]:
    """A track's rows."""
    return [row for row in suite.rows if row.track == track]


def figure(suite: Suite, table: Table, system: str, track: str) -> Place | None:
    """The one figure of a system: the mean of its rows' costs, each the mean over robots; None where it has no row.

    The interval draws the robots anew, each robot in all its rows together.
    """
    rows = [table[row.name, system] for row in rows_of(suite, track) if (row.name, system) in table]
    if not rows:
        return None
    means = [float(np.mean([one.cost_m for one in each])) for each in rows]
    robots = min((len(each) for each in rows if len(each) > 1), default=1)
    alone = [mean for mean, each in zip(means, rows, strict=True) if len(each) == 1]
    several = [[one.cost_m for one in each[:robots]] for each in rows if len(each) > 1]
    by_robot = 100.0 * (np.sum(several, axis=0) + sum(alone)) / len(rows) if several else np.zeros(1)
    drawn, value = over_robots(list(by_robot), np.mean), 100.0 * float(np.mean(means))
    measured = [(one.reference, one.mb) for each in rows for one in each if one.reference is not None and one.mb]
    ratio, mb = np.median(measured, axis=0).tolist() if measured else (math.nan, math.nan)
    interval = Interval(value, value + drawn.low - drawn.value, value + drawn.high - drawn.value)
    return Place(system, interval, len(rows), len(rows_of(suite, track)), ratio, mb)


def places(suite: Suite, table: Table, track: str) -> list[Place]:
    """All systems of a track, those that have run every row first, by cost."""
    found = [place for system in systems_of(table) if (place := figure(suite, table, system, track)) is not None]
    return sorted(found, key=lambda place: (place.rows < place.of, place.cost_cm.value))


def detail(suite: Suite, table: Table, system: str) -> list[tuple[str, ...]]:
    """A row for every condition that a system has run."""
    found = []
    for row in suite.rows:
        if scores := table.get((row.name, system)):
            f = row_figures(scores)
            found.append((
                f"{row.track}: {row.condition}", row.field, str(len(scores)),
                cm(f["median_m"]), cm(f["p95_m"]), *(percent(f[name].value) for name in _SHARES),
                f"{f['wrong_per_hour'].value:.1f} (< {f['wrong_per_hour'].high:.1f})",
                waits(f["recover_s"]), number(f["nees"].value, 2), percent(f["covered"].value), cm(f["cost_m"]),
            ))  # fmt: skip
    return found


_SHARES = ("within_10cm", "within_30cm", "available")


def number(value: float, decimals: int) -> str:
    """A figure; a dash where there is none, ∞ for what never was."""
    if math.isnan(value):
        return NONE
    return "∞" if math.isinf(value) else f"{value:.{decimals}f}"


def cm(interval: Interval) -> str:
    """Metres as cm, with the interval where there is one."""
    value, low, high = (number(100.0 * each, 1) for each in interval)
    return value if low == high else f"{value} [{low}, {high}]"


def percent(value: float) -> str:
    """A share in per cent."""
    return number(100.0 * value, 1)


def waits(interval: Interval) -> str:
    """Median and longest time until a robot is found."""
    return NONE if math.isnan(interval.value) else f"{number(interval.value, 1)} (≤ {number(interval.high, 1)})"


def place_cells(place: Place | None) -> tuple[str, str, str]:
    """Cost, update and memory of a leaderboard's row; n/a where the track's inputs are none that the system takes."""
    if place is None:
        return "n/a", NONE, NONE
    value, low, high = (number(each, 1) for each in place.cost_cm)
    part = "" if place.rows == place.of else f", {place.rows} of {place.of} rows"
    return f"{value} [{low}, {high}]{part}", number(place.ratio, 1), number(place.mb, 0)


def leaderboard(suite: Suite, table: Table) -> list[tuple[str, ...]]:
    """System, and its cells of each track."""
    found = {track: {place.system: place for place in places(suite, table, track)} for track in TRACKS}
    order = list(dict.fromkeys(name for track in TRACKS for name in found[track]))
    return [(name, *(cell for track in TRACKS for cell in place_cells(found[track].get(name)))) for name in order]
