"""Drives of all systems side by side, for `own`: the same robots, the same points, the errors beside each other.

Among them the error experiments of the three papers whose robots have a mirror; those of the fourth, on humanoids, are
in own_humanoids.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from touchline import palette
from touchline.experiments import lighting_runs
from touchline.experiments.faults import Drive, Fault, unseen
from touchline.experiments.own_table import NONE, OTHERS, OWN, SYSTEMS, row
from touchline.experiments.progress import computed
from touchline.experiments.reliability_runs import driven, longest, outcome
from touchline.experiments.result import interval, mean_interval
from touchline.experiments.scenes import INK, new_figure
from touchline.geometry import wrap_angles
from touchline.systems import RobotSetup, open_system

SECONDS, FROM_S = 60.0, 5.0
LIT_SECONDS = 25.0  # on images, which have to be rendered
COVERED_S = ((8.0, 3.0), (20.0, 2.0), (30.0, 1.5))  # as in iris-disturbances and iris-track: begin, how long
TINTS = (INK, palette.BLUE, palette.SKY, palette.VERMILLION)
_ONE = "camera.black_sectors_deg=[[22.5,67.5]]"
_TWO = "camera.black_sectors_deg=[[22.5,67.5],[202.5,247.5]]"
_FOUR = "camera.black_sectors_deg=[[22.5,67.5],[112.5,157.5],[202.5,247.5],[292.5,337.5]]"
_UNTOUCHED = ("camera.known_from=design", "camera.mirror.tilt_spread_deg=0.6", "camera.mirror.shift_spread_mm=0.6")


class Condition(NamedTuple):
    """A scenario with changes. papers: the experiments of papers that it is.

    asked: the bounds on our mean and 99 % (cm), None where the others' are the bound. faults: laid into the drive.
    light: on rendered images under this light instead.
    """

    name: str
    scenario: str = "straight-tracks"
    changes: tuple[str, ...] = ()
    papers: str = ""
    asked_cm: tuple[float, float] | None = None
    faults: tuple[Fault, ...] = ()
    light: lighting_runs.Case | None = None

    @property
    def title(self) -> str:
        """Its name, with the experiments that it is."""
        return f"{self.name} ({self.papers})" if self.papers else self.name


_COVERED = tuple(Fault("", start_s, start_s + lasts_s, unseen) for start_s, lasts_s in COVERED_S)
UNTOUCHED = Condition("mirror off by 0.6° and 0.6 mm, table untouched", changes=_UNTOUCHED, asked_cm=(1.5, 8.0))
HALF = Condition(
    "straight tracks, a half hidden", changes=("camera.black_sectors_deg=[[0,180]]",), papers="lu2013-occlusion"
)
SHAKING = Condition("vibration of 0.3°", changes=("camera.mirror.vibration_deg=0.3",))
LATE = Condition("100 ms late, stamped on arrival", changes=("camera.delay_s=0.1", "camera.stamped=arrived"))
TRACKS = Condition("straight tracks", papers="lu2013-occlusion, xiong-tracking")
MATCH = Condition("match", "match")
CONDITIONS = (
    TRACKS,
    Condition("straight tracks, 12.5 % hidden", changes=(_ONE,), papers="lu2013-occlusion"),
    Condition("straight tracks, 25 % hidden", changes=(_TWO,), papers="lu2013-occlusion"),
    Condition("straight tracks, 50 % hidden", changes=(_FOUR,), papers="lu2013-occlusion"),
    HALF,
    Condition("lamps and sun, images", papers="lu2013-lighting", light=lighting_runs.SECOND),
    Condition("lamps off and on, images", papers="lu2013-lighting", light=lighting_runs.THIRD),
    Condition("tour of 20 places", "tour-20", papers="iris-points, iris-tracks"),
    Condition("the same, three times covered", "tour-20", papers="iris-track, iris-disturbances", faults=_COVERED),
    MATCH,
    UNTOUCHED,
    SHAKING,
    Condition("100 ms late", changes=("camera.delay_s=0.1",)),
    LATE,
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


def robot_of(condition: Condition, seed: int) -> tuple[Drive, RobotSetup]:
    """A robot's drive under a condition."""
    if condition.light is not None:
        return _lit(condition.light, seed)
    drive, setup, _ = driven(condition.scenario, seed, SECONDS, *condition.changes)
    for number, fault in enumerate(condition.faults):
        drive = fault.laid_into(drive, np.random.default_rng([seed, number]))
    return drive, setup


def _lit(case: lighting_runs.Case, seed: int) -> tuple[Drive, RobotSetup]:
    """A drive through a rendered hall, the exposure kept right all along."""
    run = lighting_runs.simulation(case, seed, LIT_SECONDS)
    loop, frames = lighting_runs.ControlledExposure(run), []
    for index in range(len(run)):
        frame = run.frame(index)
        image, _ = loop.image(frame.image)
        frames.append(replace(frame, image=image, exposure_ms=run.exposure_ms, gain=run.gain))
    setup = RobotSetup(run.field, run.camera, run.wheel_directions_rad)
    return Drive(frames, np.asarray(run.truth.poses), run.field), setup


def runs_of(condition: Condition, seed: int) -> dict[str, Errors]:
    """Every system on one robot's drive."""
    drive, setup = robot_of(condition, seed)
    return {system: errors_of(system, drive, setup, seed) for system in SYSTEMS}


Runs = dict[str, list[dict[str, Errors]]]  # by condition, of every robot, by system


def drive_runs(seeds: int) -> Runs:
    """Every condition, with a robot for each seed."""
    tasks = [(place, seed) for place in range(len(CONDITIONS)) for seed in range(seeds)]
    runs: Runs = {}
    for (place, _), found in zip(tasks, computed(_runs_at, tasks, "drives"), strict=True):
        runs.setdefault(CONDITIONS[place].name, []).append(found)
    return runs


def _runs_at(task: tuple[int, int]) -> dict[str, Errors]:
    place, seed = task
    return runs_of(CONDITIONS[place], seed)


def drive_rows(runs: Runs) -> list[tuple[str, ...]]:
    """The rows of every condition, and what becomes of the papers' experiments."""
    rows = [each for condition in CONDITIONS for each in _rows(condition, runs[condition.name])]
    return [*rows, *_paper_rows([(c.title, runs[c.name]) for c in CONDITIONS if c.papers])]


def _rows(condition: Condition, runs: Sequence[dict[str, Errors]]) -> list[tuple[str, ...]]:
    def told(name: str, decimals: int = 2) -> dict[str, str]:
        return {system: interval([getattr(run[system], name) for run in runs], decimals) for system in SYSTEMS}

    mean, p99 = (NONE, NONE) if condition.asked_cm is None else (f"≤ {bound:g}" for bound in condition.asked_cm)
    wrong = {system: str(max(run[system].wrong for run in runs)) for system in SYSTEMS}
    return [
        row(condition.title, "mean (cm)", mean, told("mean_cm"), _less([_of(run, "mean_cm") for run in runs])),
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


def _paper_rows(experiments: Sequence[tuple[str, Sequence[dict[str, Errors]]]]) -> list[tuple[str, ...]]:
    """In how many of the papers' experiments we are better than every other system, robot by robot."""
    missed: dict[str, list[str]] = {"mean_cm": [], "p99_cm": []}
    for name, runs in experiments:
        means = [_of(run, "mean_cm") for run in runs]
        if not all(_is_less([run[OWN] - run[other] for run in means]) for other in OTHERS):
            missed["mean_cm"].append(name)
        last = {system: float(np.mean([run[system].p99_cm for run in runs])) for system in SYSTEMS}
        if not all(last[OWN] <= last[other] for other in OTHERS if np.isfinite(last[other])):
            missed["p99_cm"].append(name)

    def told(names: Sequence[str]) -> str:
        return f"{len(experiments) - len(names)} of {len(experiments)}" + (
            f"; not: {'; '.join(names)}" if names else ""
        )

    return [
        row("the papers' experiments", "mean less than every other's", "all", {OWN: told(missed["mean_cm"])}),
        row("", "99 % no more than the best other's", "all", {OWN: told(missed["p99_cm"])}),
    ]


def _is_less(differences: Sequence[float]) -> bool:
    """Whether the mean of differences lies below 0 with 95 %; a robot that the other never found counts for us."""
    known = [value for value in differences if np.isfinite(value)]
    return not known or mean_interval(known)[2] < 0.0


def picture(runs: Runs) -> Figure:
    """Mean and 99 % of the errors of every robot under every condition, a dot for each."""
    figure, axes = new_figure(1, 2, 13.0, 6.4)
    for axis, name, title in zip(axes, ("mean_cm", "p99_cm"), ("mean error (cm)", "99 % (cm)"), strict=True):
        for k, condition in enumerate(CONDITIONS):
            for n, (system, tint) in enumerate(zip(SYSTEMS, TINTS, strict=True)):
                values = [getattr(run[system], name) for run in runs[condition.name]]
                height = k + 0.2 * (n - 1.5)
                label = system if k == 0 else None
                axis.plot(values, [height] * len(values), "o", color=tint, markersize=3.5, alpha=0.8, label=label)
                axis.plot([np.nanmean(values)] * 2, [height - 0.09, height + 0.09], color=tint, linewidth=1.6)
            for bound in (condition.asked_cm or ())[axes.index(axis) : axes.index(axis) + 1]:
                axis.plot([bound] * 2, [k - 0.45, k + 0.45], color=palette.VERMILLION, linewidth=1.0, linestyle="--")
        axis.set_xscale("log")
        axis.set_ylim(len(CONDITIONS) - 0.5, -0.5)
        axis.set_yticks(
            range(len(CONDITIONS)), [c.name for c in CONDITIONS] if axis is axes[0] else [""] * len(CONDITIONS)
        )
        axis.set_title(title, fontsize=10)
    axes[1].legend(frameon=False, fontsize=8)
    return figure
