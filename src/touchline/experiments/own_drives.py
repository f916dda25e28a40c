"""Drives of all systems side by side, for `own`: the same robots, the same points, the errors beside each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from touchline.experiments.faults import Drive
from touchline.experiments.own_table import NONE, OTHERS, OWN, SYSTEMS, row
from touchline.experiments.progress import follow
from touchline.experiments.reliability_runs import driven, longest, outcome
from touchline.experiments.result import interval
from touchline.geometry import wrap_angles
from touchline.systems import RobotSetup, open_system

SECONDS, FROM_S = 60.0, 5.0
_FOUR = "camera.black_sectors_deg=[[22.5,67.5],[112.5,157.5],[202.5,247.5],[292.5,337.5]]"
_UNTOUCHED = ("camera.known_from=design", "camera.mirror.tilt_spread_deg=0.6", "camera.mirror.shift_spread_mm=0.6")


class Condition(NamedTuple):
    """A scenario with changes; asked: the bounds on our mean and 99 % (cm), None where the others' are the bound."""

    name: str
    scenario: str = "straight-tracks"
    changes: tuple[str, ...] = ()
    asked_cm: tuple[float, float] | None = None


CONDITIONS = (
    Condition("straight tracks"),
    Condition("straight tracks, 50 % hidden", changes=(_FOUR,)),
    Condition("straight tracks, a half hidden", changes=("camera.black_sectors_deg=[[0,180]]",)),
    Condition("match", "match"),
    Condition("tour of 20 places", "tour-20"),
    Condition("mirror off by 0.6° and 0.6 mm, table untouched", changes=_UNTOUCHED, asked_cm=(1.5, 8.0)),
    Condition("vibration of 0.3°", changes=("camera.mirror.vibration_deg=0.3",)),
    Condition("100 ms late", changes=("camera.delay_s=0.1",)),
    Condition("100 ms late, stamped on arrival", changes=("camera.delay_s=0.1", "camera.stamped=arrived")),
    Condition("ideal: straight tracks", changes=("ideal=true",)),
    Condition("ideal: match", "match", ("ideal=true",)),
)


class Errors(NamedTuple):
    """Of one run: mean and 99 % of the position error (cm) and mean heading error (degrees) over the tracked frames,
    share of frames tracked (%), and the most frames in a row that were wrong and called tracking.
    """

    mean_cm: float
    p99_cm: float
    heading_deg: float
    tracked: float
    wrong: int


def errors_of(
    system: str, drive: Drive, setup: RobotSetup, seed: int, settings: Mapping[str, Any] | None = None
) -> Errors:
    """What a system makes of a drive, from FROM_S on. settings: of the system, where they differ."""
    told = open_system(system, setup, settings, np.random.default_rng(seed))
    estimates = [told.step(frame) for frame in drive.frames]
    found = outcome(drive, estimates)
    counts = drive.times_s >= FROM_S
    tracked = counts & found.tracking
    if not tracked.any():
        return Errors(float("nan"), float("nan"), float("nan"), 0.0, 0)
    turns = wrap_angles(np.array([one.pose.heading for one in estimates]) - drive.truth[:, 2])
    return Errors(
        100.0 * float(found.errors_m[tracked].mean()),
        100.0 * float(np.quantile(found.errors_m[tracked], 0.99)),
        float(np.degrees(np.abs(turns[tracked]).mean())),
        100.0 * float(tracked.sum() / counts.sum()),
        longest(found.wrong & counts),
    )


def runs_of(condition: Condition, seed: int) -> dict[str, Errors]:
    """Every system on one robot's drive."""
    drive, setup, _ = driven(condition.scenario, seed, SECONDS, *condition.changes)
    return {system: errors_of(system, drive, setup, seed) for system in SYSTEMS}


def drive_rows(seeds: int) -> list[tuple[str, ...]]:
    """Every condition, with a robot for each seed."""
    tasks = [(condition, seed) for condition in CONDITIONS for seed in range(seeds)]
    runs: dict[str, list[dict[str, Errors]]] = {}
    for condition, seed in follow(tasks, "drives"):
        runs.setdefault(condition.name, []).append(runs_of(condition, seed))
    return [each for condition in CONDITIONS for each in _rows(condition, runs[condition.name])]


def _rows(condition: Condition, runs: Sequence[dict[str, Errors]]) -> list[tuple[str, ...]]:
    def told(name: str, decimals: int = 2) -> dict[str, str]:
        return {system: interval([getattr(run[system], name) for run in runs], decimals) for system in SYSTEMS}

    mean, p99 = (NONE, NONE) if condition.asked_cm is None else (f"≤ {bound:g}" for bound in condition.asked_cm)
    wrong = {system: str(max(run[system].wrong for run in runs)) for system in SYSTEMS}
    return [
        row(condition.name, "mean (cm)", mean, told("mean_cm"), _less([_of(run, "mean_cm") for run in runs])),
        row("", "99 % (cm)", p99, told("p99_cm"), _less([_of(run, "p99_cm") for run in runs])),
        row("", "heading (°)", NONE, told("heading_deg"), _less([_of(run, "heading_deg") for run in runs])),
        row("", "tracked (%)", NONE, told("tracked", 1)),
        row("", "wrong, called tracking: most frames in a row", "≤ 5", wrong),
    ]


def _of(run: dict[str, Errors], name: str) -> dict[str, float]:
    return {system: getattr(run[system], name) for system in SYSTEMS}


def _less(runs: Sequence[dict[str, float]]) -> str:
    """Ours less the best of the others', robot by robot, with the interval of the mean."""
    best = min(OTHERS, key=lambda system: float(np.nanmean([run[system] for run in runs])))
    return interval([run[OWN] - run[best] for run in runs])
