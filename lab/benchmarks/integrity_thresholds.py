"""Thresholds of the consistency statistics for a stated rate of false alarms, from clean drives.

    python lab/benchmarks/integrity_thresholds.py [--hours 10] [--minutes 3] [--robots 10] [--seed 1000]

Robots as built, with a mirror and walking, drive with nothing wrong; what belongs to play is no fault: shoves, slips,
robots close by, half of the view hidden, one line in view, a tilted mirror, images 60 ms late. Every statistic of the
estimates is told as a share of its present threshold: its distribution, how often an hour it is exceeded, and the one
that stands for the rate asked. Of each condition: false alarms, images tracked, and the protection level.

Where a statistic exceeds its own 99 % quantile for a while that is one event, and the largest value of each event
beyond the quantile follows an exponential distribution (the tail of peaks over a threshold, Pickands 1975, with shape
0): from its mean and the events an hour follows the threshold that is exceeded once in so many hours. The seeds from
1000 on are for this; the experiment `faults` judges on other seeds.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from touchline.evaluation.workers import open_workers
from touchline.geometry import FloatArray
from touchline.types import ProblemCode
from touchline_lab.experiments.catalogue import FEATURES, KINDS_OF_ROBOTS, MIRROR, driven_by
from touchline_lab.experiments.clutter import one_line
from touchline_lab.experiments.drives import Drive, driven, estimates_of
from touchline_lab.experiments.faults import Score, frames_of, misleading
from touchline_lab.experiments.injections import Fault, odometry

QUANTILE = 0.99
# what is said with right, or is no sensor's fault
NO_FALSE_ALARM = ProblemCode.END_UNDECIDED, ProblemCode.STAMPS_LATE_CORRECTED
APART_S = 2.0  # values beyond the quantile that lie nearer are of one event
SLIP_EVERY_S, SLIP_S, SLIP_M_S = 10.0, 0.2, 1.5  # how often wheels slip, for how long, and how fast they roll then
_LONE_S = 4.0  # from when on one line alone is seen
CONDITIONS = {
    "tracks": ("straight-tracks",),
    "match": ("match",),
    "half hidden": ("match", "camera.black_sectors_deg=[[0,180]]"),
    "a quarter in view": ("straight-tracks", "camera.black_sectors_deg=[[0,270]]"),
    "one line": ("straight-tracks",),
    "near robots, shoves": ("match", "disturbances.shove_every_s=3", "others.near_m=1.0"),
    "slips": ("match",),
    "kidnaps": ("match", "disturbances.kidnap_every_s=20", "disturbances.covered_images=0"),
    "tilt of 1°": ("match", "camera.mirror.tilt_deg=[1.0,0.0]"),
    "60 ms late": ("straight-tracks", "camera.delay_s=0.06", "camera.stamped=arrived"),
}
"""Of robots with a mirror, besides those of the catalogue: scenarios and what is changed in them."""


class Log(NamedTuple):
    """Of one drive: times (N,) in s and each statistic (N,). tracked: images.

    alarms: codes of problems where there had been none, or which statistic was beyond its threshold.
    """

    name: str
    times_s: FloatArray
    values: Mapping[str, FloatArray]
    alarms: Sequence[str]
    tracked: int
    score: Score


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


def drive_of(name: str, number: int, seed: int, seconds: float) -> Drive:
    """A robot's clean drive. name: of its kind or of a condition."""
    if name in KINDS_OF_ROBOTS:
        return driven_by(name, number, seed, seconds)
    scenario, *changes = CONDITIONS[name]
    drive, rng = driven(scenario, seed, seconds, *changes), np.random.default_rng([seed, 24])
    if name == "one line":
        drive = Fault("", _LONE_S, math.inf, one_line).laid_into(drive, rng)
    slips_s = np.arange(_LONE_S, seconds, SLIP_EVERY_S) if name == "slips" else ()
    for start_s in slips_s:
        slip = odometry((1.0, 1.0, 1.0), (float(rng.choice((-1.0, 1.0))) * SLIP_M_S, 0.0, 0.0))
        drive = Fault("", start_s, start_s + SLIP_S, slip).laid_into(drive, rng)
    return drive


def log_of(task: tuple[str, int, int, float]) -> Log:
    """What `touchline` makes of a drive. task: as of `drive_of`."""
    drive = drive_of(*task)
    estimates = estimates_of("touchline", drive, task[2])
    names = sorted({name for estimate in estimates for name in estimate.statistics})
    values = {name: np.array([estimate.statistics.get(name, 0.0) for estimate in estimates]) for name in names}
    alarms, before = list[str](), set[str]()
    for estimate in estimates:
        said = {problem.code for problem in estimate.problems if problem.code not in NO_FALSE_ALARM}
        said |= {
            f"{name} is beyond its threshold"
            for name, value in estimate.statistics.items()
            if value >= 1.0 and not said
        }
        alarms += said if not before else ()
        before = said
    found = frames_of(drive, estimates)
    return Log(task[0], drive.times_s, values, alarms, int(found.tracking.sum()), found.score())


def hours_of(logs: Sequence[Log]) -> float:
    """Of driving (h)."""
    return sum(float(log.times_s[-1] - log.times_s[0]) for log in logs) / 3600.0


def report(logs: Sequence[Log], hours: float) -> list[str]:
    """The tables of the statistics and of the conditions."""
    heads = ("median", "99 %", "99.9 %", "largest", "events/h", "alarms/h", f"1 in {hours:g} h")
    lines = [f"{'statistic':20s}" + "".join(f" {head:>9s}" for head in heads)]
    for name in sorted({name for log in logs for name in log.values}):
        known = [(log.times_s, log.values[name]) for log in logs if name in log.values]
        tail, every = tail_of(known), np.concatenate([values for _, values in known])
        figures = (*np.quantile(every, (0.5, QUANTILE, 0.999)), tail.largest, tail.per_hour, tail.rate(1.0))
        lines.append(f"{name:20s}" + "".join(f" {figure:9.3f}" for figure in (*figures, tail.threshold(hours))))
    lines.append("Values are shares of the present threshold: the last column is by how much that is to be multiplied.")
    lines.append("")
    heads = ("hours", "alarms", "wrong", "tracked %", "level cm", "beyond ‰")
    lines.append(f"{'condition':20s}" + "".join(f" {head:>9s}" for head in heads))
    for name in (*dict.fromkeys(log.name for log in logs), "all"):
        some = [log for log in logs if name in (log.name, "all")]
        scores = [log.score for log in some]
        level_cm = 100.0 * np.median(np.concatenate([score.bounds[:, 1] for score in scores]))
        tracked = 100.0 * sum(log.tracked for log in some) / sum(score.frames for score in scores)
        cells = (sum(len(log.alarms) for log in some), sum(score.wrong + score.other_end for score in scores))
        lines.append(
            f"{name:20s} {hours_of(some):9.2f} {cells[0]:9d} {cells[1]:9d} {tracked:9.1f} {level_cm:9.1f} "
            f"{misleading(scores):>9s}"
        )
    said = Counter(f"{log.name}: {text}" for log in logs for text in log.alarms)
    return [*lines, *(f"{count} × {text}" for text, count in said.most_common())]


def main() -> None:
    """Drive, and say which thresholds stand for the rate."""
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--hours", type=float, default=10.0, help="one false alarm in so many hours, of each statistic")
    asked.add_argument("--minutes", type=float, default=3.0, help="of each drive")
    asked.add_argument("--robots", type=int, default=10, help="of each kind and condition")
    asked.add_argument("--seed", type=int, default=1000, help="of the first robot")
    asked.add_argument("--workers", type=int, default=1, help="processes")
    given = asked.parse_args()
    kinds = (MIRROR, FEATURES, *CONDITIONS)
    tasks = [(kind, n, given.seed + n, 60.0 * given.minutes) for kind in kinds for n in range(given.robots)]
    with open_workers(given.workers) as workers:
        logs = list(workers.map(log_of, tasks))
    print("\n".join(report(logs, given.hours)))


if __name__ == "__main__":
    main()
