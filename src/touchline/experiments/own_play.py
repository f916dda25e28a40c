"""Hours of play of `touchline`, for `own`: kidnaps, a compass that wanders and fails, and whether anybody is fooled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from touchline.experiments.faults import Drive, Fault, stuck_compass, turned_compass
from touchline.experiments.own_table import OWN, SYSTEMS, row
from touchline.experiments.progress import computed
from touchline.experiments.reliability_runs import (
    FOOLED_FRAMES,
    KIDNAP_EVERY_S,
    WITHIN_FRAMES,
    Kidnapped,
    driven,
    followed,
    kidnaps_of,
    longest,
)
from touchline.experiments.result import interval, rate
from touchline.systems import RobotSetup

RUNS, MINUTES = 12, 10.0  # of a seed: two hours
FAULT_S = 10.0  # one in each run
FLIP_S, LOSS_S = 2.0, 1.0
KIDNAP_RUNS, KIDNAP_SECONDS = 4, 63.0
_COMPASS = ("sensors.imu.compass_drift_deg=10", "disturbances.covered_images=0")
KIDNAPS = (f"disturbances.kidnap_every_s={KIDNAP_EVERY_S:g}", "disturbances.covered_images=0")


class Played(NamedTuple):
    """Of one run: longest times (s) that it was called tracking while at the other end, and while wrong at all; share
    of frames tracked, and the mean error of these (m).
    """

    flip_s: float
    loss_s: float
    tracked: float
    error_m: float


def play_rows(seeds: int) -> list[tuple[str, ...]]:
    """Hours of play, and kidnaps in play."""
    played = list(computed(_played, range(RUNS * seeds), "runs of play"))
    hours = f"{RUNS * seeds * MINUTES / 60.0:g} h of match, a fault of the compass every {MINUTES:g} min"
    flips, losses = sum(one.flip_s > FLIP_S for one in played), sum(one.loss_s > LOSS_S for one in played)
    rows = [
        row(hours, f"at the other end for more than {FLIP_S:g} s", "0", {OWN: str(flips)}),
        row("", f"wrong, called tracking, for more than {LOSS_S:g} s", "0", {OWN: str(losses)}),
        row("", "tracked (%)", "–", {OWN: interval([100.0 * one.tracked for one in played], 1)}),
        row("", "mean (cm)", "–", {OWN: interval([100.0 * one.error_m for one in played])}),
    ]
    kidnaps: dict[str, list[Kidnapped]] = {system: [] for system in SYSTEMS}
    for found in computed(_kidnapped, range(KIDNAP_RUNS * seeds), "runs with kidnaps"):
        for system in SYSTEMS:
            kidnaps[system] += found[system]
    right = {system: rate(sum(one.right for one in each), len(each)) for system, each in kidnaps.items()}
    rest = {system: [one for one in each if not one.right] for system, each in kidnaps.items()}
    searching = {system: f"{sum(one.searching for one in each)} of {len(each)}" for system, each in rest.items()}
    wrong = {system: str(sum(one.wrong > FOOLED_FRAMES for one in each)) for system, each in kidnaps.items()}
    return [
        *rows,
        row("kidnaps in play", f"right within {WITHIN_FRAMES} frames", "≥ 99.5 %", right),
        row("", "of the rest searching", "all", searching),
        row("", f"wrong, called tracking, for more than {FOOLED_FRAMES} frames", "0", wrong),
    ]


def _kidnapped(run: int) -> dict[str, list[Kidnapped]]:
    """The kidnaps of one match, by system."""
    drive, setup, times_s = driven("match", run, KIDNAP_SECONDS, *KIDNAPS)
    return {system: kidnaps_of(drive, times_s, followed(system, setup, drive, run)) for system in SYSTEMS}


def _played(run: int) -> Played:
    """One run of play with a fault of the compass in it: stuck, or showing the opposite, by turns."""
    drive, setup, _ = driven("match", run, 60.0 * MINUTES, *_COMPASS)
    rng = np.random.default_rng([run, 18])
    begin_s = float(rng.uniform(30.0, 60.0 * MINUTES - 2.0 * FAULT_S))
    change = stuck_compass(begin_s) if run % 2 else turned_compass
    return played_on(Fault("", begin_s, begin_s + FAULT_S, change).laid_into(drive, rng), setup, run)


def played_on(drive: Drive, setup: RobotSetup, seed: int) -> Played:
    """What our own system makes of a drive."""
    found = followed(OWN, setup, drive, seed)
    period_s = float(np.median(np.diff(drive.times_s)))
    return Played(
        period_s * longest(found.tracking & found.flipped),
        period_s * longest(found.wrong),
        float(found.tracking.mean()),
        float(found.errors_m[found.tracking].mean()) if found.tracking.any() else float("nan"),
    )
