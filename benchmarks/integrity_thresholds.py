"""Thresholds of the consistency statistics for a stated rate of false alarms, from clean drives.

    python benchmarks/integrity_thresholds.py [--hours 10] [--minutes 3] [--robots 10] [--seed 1000] [--save FILE.npz]

Robots as built, with a mirror and walking, drive with nothing wrong; what belongs to play is no fault: shoves, slips,
robots close by, half of the view hidden, a tilted mirror, images 60 ms late. Every statistic of the estimates is told
as a share of its present threshold. Where it exceeds its own 99 % quantile for a while that is one event, and the
largest value of each event beyond the quantile follows an exponential distribution (the tail of peaks over a threshold,
Pickands 1975, with shape 0): from its mean and the events an hour follows the threshold that is exceeded once in so
many hours. The seeds from 1000 on are for this; the experiment `faults` judges on those from 2000 on.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from touchline.evaluation.workers import open_workers
from touchline.experiments.catalogue import FEATURES, KINDS_OF_ROBOTS, MIRROR, driven_by
from touchline.experiments.drives import Drive, driven, estimates_of, track_of
from touchline.geometry import FloatArray

QUANTILE = 0.99
APART_S = 2.0  # values beyond the quantile that lie nearer are of one event
CONDITIONS = (
    ("match", "camera.mirror.tilt_spread_deg=1.0"),
    ("match", "disturbances.kidnap_every_s=20", "disturbances.covered_images=0"),
    ("match", "disturbances.shove_every_s=3", "others.near_m=1.0"),
    ("straight-tracks", "camera.delay_s=0.06", "camera.stamped=arrived"),
    ("straight-tracks", "camera.black_sectors_deg=[[0,270]]"),
)
"""Of robots with a mirror, besides those of the catalogue: scenarios and what is changed in them."""


class Log(NamedTuple):
    """Of one drive: times (N,) in s and each statistic (N,). alarms: how often a problem was said or tracking ended."""

    name: str
    times_s: FloatArray
    values: Mapping[str, FloatArray]
    alarms: int
    wrong: int


class Tail(NamedTuple):
    """Of a statistic: how often an hour (1/h) it begins to exceed its quantile, and by how much on average."""

    quantile: float
    largest: float
    per_hour: float
    excess: float

    def threshold(self, hours: float) -> float:
        """What is exceeded once in so many hours."""
        return self.quantile + self.excess * math.log(max(self.per_hour * hours, 1.0))

    def rate(self, threshold: float) -> float:
        """How often an hour a threshold is exceeded (1/h)."""
        if self.excess <= 0.0:
            return 0.0
        return self.per_hour * math.exp(-max(threshold - self.quantile, 0.0) / self.excess)


def tail_of(logs: Sequence[tuple[FloatArray, FloatArray]]) -> Tail:
    """The tail of a statistic, from times (N,) in s and its values (N,) of several drives."""
    every = np.concatenate([values for _, values in logs])
    quantile = float(np.quantile(every, QUANTILE))
    hours = sum(float(times_s[-1] - times_s[0]) for times_s, _ in logs) / 3600.0
    peaks: list[float] = []
    for times_s, values in logs:
        beyond = np.flatnonzero(values > quantile)
        if len(beyond):
            events = np.split(beyond, np.flatnonzero(np.diff(times_s[beyond]) > APART_S) + 1)
            peaks += [float(values[event].max()) for event in events]
    excess = float(np.mean(peaks)) - quantile if peaks else 0.0
    return Tail(quantile, float(every.max()), len(peaks) / hours, excess)


def log_of(task: tuple[str, int, int, float]) -> Log:
    """A robot's clean drive. task: the kind of robots, or a condition's number; the robot's number; seed; seconds."""
    kind, number, seed, seconds = task
    drive: Drive
    if kind in KINDS_OF_ROBOTS:
        name, drive = f"{kind} {number}", driven_by(kind, number, seed, seconds)
    else:
        scenario, *changes = CONDITIONS[int(kind)]
        name, drive = " ".join((scenario, *changes)), driven(scenario, seed, seconds, *changes)
    estimates = estimates_of("touchline", drive, seed)
    names = {name for estimate in estimates for name in estimate.statistics}
    values = {name: np.array([estimate.statistics.get(name, 0.0) for estimate in estimates]) for name in sorted(names)}
    said = np.array([any(not text.startswith("undecided") for text in estimate.problems) for estimate in estimates])
    said |= np.array([max(estimate.statistics.values(), default=0.0) >= 1.0 for estimate in estimates])
    alarms = int(np.count_nonzero(np.diff(said.astype(np.int8), prepend=0) > 0))
    return Log(name, drive.times_s, values, alarms, int(np.count_nonzero(track_of(drive, estimates).unnamed)))


def report(logs: Sequence[Log], hours: float) -> list[str]:
    """The table of the statistics, and which drives had alarms."""
    lines = [
        f"{'statistic':20s} {'99 %':>8s} {'largest':>8s} {'events/h':>9s} {'alarms/h':>9s} {f'1 in {hours:g} h':>9s}"
    ]
    for name in sorted({name for log in logs for name in log.values}):
        tail = tail_of([(log.times_s, log.values[name]) for log in logs if name in log.values])
        figures = (tail.quantile, tail.largest, tail.per_hour, tail.rate(1.0), tail.threshold(hours))
        lines.append(f"{name:20s}" + "".join(f" {figure:9.3f}" for figure in figures))
    lines.append("Values are shares of the present threshold: the last column is by how much that is to be multiplied.")
    driven_h = sum(float(log.times_s[-1] - log.times_s[0]) for log in logs) / 3600.0
    lines += [f"{log.alarms} alarms, {log.wrong} images wrong: {log.name}" for log in logs if log.alarms or log.wrong]
    return [*lines, f"{sum(log.alarms for log in logs)} alarms in {driven_h:.2f} h"]


def main() -> None:
    """Drive, and say which thresholds stand for the rate."""
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--hours", type=float, default=10.0, help="one false alarm in so many hours, of each statistic")
    asked.add_argument("--minutes", type=float, default=3.0, help="of each drive")
    asked.add_argument("--robots", type=int, default=10, help="of each kind and condition")
    asked.add_argument("--seed", type=int, default=1000, help="of the first robot")
    asked.add_argument("--workers", type=int, default=1, help="processes")
    asked.add_argument("--save", type=Path, help="an .npz of all statistics")
    given = asked.parse_args()
    kinds = (MIRROR, FEATURES, *map(str, range(len(CONDITIONS))))
    tasks = [(kind, n, given.seed + n, 60.0 * given.minutes) for kind in kinds for n in range(given.robots)]
    with open_workers(given.workers) as workers:
        logs = list(workers.map(log_of, tasks))
    if given.save is not None:
        np.savez_compressed(given.save, **{f"{log.name}: {k}": v for log in logs for k, v in log.values.items()})
    print("\n".join(report(logs, given.hours)))


if __name__ == "__main__":
    main()
