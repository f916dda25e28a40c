"""own: what our own system reaches, beside the others and what is possible at all. No figure of a paper.

Drives of all systems side by side: the same robots, the same points, the errors beside each other, among them the error
experiments of the three papers whose robots have a mirror; hours of play, with kidnaps and a compass that wanders and
fails; single observations (own_points.py). Humanoids are in own_humanoids.py.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from touchline import palette
from touchline_lab.experiments import drives, harness, lighting, own_points
from touchline_lab.experiments.drives import Drive, Kidnapped, Track, drive_of, driven, followed, kidnaps_of, longest
from touchline_lab.experiments.injections import Fault, stuck_compass, turned_compass, unseen
from touchline_lab.experiments.own_points import OTHERS, OWN, SYSTEMS, row
from touchline_lab.experiments.scenes import INK, new_figure, robot_dots
from touchline_lab.statistics import over_robots

COLUMNS = ("what", "figure", "asked of touchline", *SYSTEMS, "touchline less the best other")
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
    light: lighting.Case | None = None

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
    Condition("lamps and sun, images", papers="lu2013-lighting", light=lighting.SECOND),
    Condition("lamps off and on, images", papers="lu2013-lighting", light=lighting.THIRD),
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


RUNS, MINUTES = 12, 10.0  # of play, of a seed: two hours
FAULT_S = 10.0  # one in each run
FLIP_S, LOSS_S = 2.0, 1.0
KIDNAP_RUNS, KIDNAP_SECONDS = 4, 63.0
_COMPASS = ("sensors.imu.compass_drift_deg=10", "disturbances.covered_images=0")


class Errors(NamedTuple):
    """Of one run: mean, median and 99 % of the position error (cm) and mean heading error (degrees) over the tracked
    frames, share of frames tracked (%), and the most frames in a row that were wrong and called tracking.
    """

    mean_cm: float
    median_cm: float
    p99_cm: float
    heading_deg: float
    tracked: float
    wrong: int


Runs = Mapping[tuple[str, str], Sequence[Errors]]  # by condition and system, of every robot


def errors_of(track: Track) -> Errors:
    """From FROM_S on."""
    kept, share = track.tracked_from(FROM_S)
    if not share:
        return Errors(math.nan, math.nan, math.nan, math.nan, 0.0, 0)
    return Errors(
        100.0 * float(kept.distances_m.mean()),
        100.0 * float(np.median(kept.distances_m)),
        100.0 * float(np.quantile(kept.distances_m, 0.99)),
        float(np.degrees(kept.turns_rad.mean())),
        100.0 * share,
        longest(track.wrong & (track.times_s >= FROM_S)),
    )


def robot_of(condition: Condition, seed: int) -> Drive:
    """A robot's drive under a condition."""
    if condition.light is not None:  # a rendered hall, the exposure kept right all along
        run = lighting.simulation(condition.light, seed, LIT_SECONDS)
        return drive_of(run, frames=[frame for frame, _ in lighting.controlled(run)])
    drive = driven(condition.scenario, seed, SECONDS, *condition.changes)
    for number, fault in enumerate(condition.faults):
        drive = fault.laid_into(drive, np.random.default_rng([seed, number]))
    return drive


def _errors_at(task: tuple[int, int]) -> dict[tuple[str, str], Errors]:
    """Every system on one robot's drive."""
    condition, seed = CONDITIONS[task[0]], task[1]
    drive = robot_of(condition, seed)
    return {(condition.name, system): errors_of(followed(system, drive, seed)) for system in SYSTEMS}


def own(seeds: int) -> harness.ExperimentResult:
    """Points, drives of robots as built, and the ideal ones beside them."""
    tasks = [(place, seed) for place in range(len(CONDITIONS)) for seed in harness.seed_range(seeds)]
    runs, found, play = harness.gathered(_errors_at, tasks, "drives"), own_points.point_runs(seeds), play_rows(seeds)
    drives = [each for condition in CONDITIONS for each in _rows(condition, runs)]
    return harness.ExperimentResult(
        "Our own system, touchline, beside the others on the same robots and points",
        COLUMNS,
        [*drives, *_paper_rows(CONDITIONS, runs), *play, *own_points.point_rows(found)],
        harness.Headline("straight tracks, mean error (cm): " + ", ".join(SYSTEMS), harness.NONE,
                 "; ".join(drives[0][3:][: len(SYSTEMS)])),
        _NOTES,
        (("drives", _picture(runs)), ("points", own_points.picture(found))),
    )  # fmt: skip


_NOTES = (
    f"Robots as built, drawn anew per seed, observation level, {SECONDS:g} s at 10 Hz, errors of tracked frames from "
    f"{FROM_S:g} s on; on images {LIT_SECONDS:g} s at 2.5 Hz under exposure control; camera.yaml from calibrate mirror "
    "where nothing else is said. Brackets: where the mean over robots lies with 95 %, by bootstrap; the last column is "
    f"{OWN} less the best of the others, robot by robot. In the picture a dot for each robot, a stroke for their mean, "
    "broken red lines for what is asked.",
    "The papers' experiments: all whose figures are errors of robots with a mirror, in brackets; less than every "
    "other's where the interval of the difference to each lies below 0. Those on humanoids are in own-humanoids.",
    f"Points: {own_points.FRAMES} single observations per seed on the 18 x 12 m field within 6 m, ranges with 2 % + "
    "1 cm of error, bearings with 0.5°, 5 % clutter where nothing else is said. Bound: Cramér and Rao's, without the "
    "clutter; the greater of position and heading. Found, near: within 20 cm and 5°, from nothing at either end of the "
    "field. A mode is right where the true pose is near, or within 99 % of the normal distribution that it states: a "
    "lone line tells no place along it. Modes of the same place are taken together.",
)


def _of(runs: Runs, condition: Condition, figure: str) -> dict[str, list[float]]:
    """By system a figure of every robot."""
    return {system: [getattr(one, figure) for one in runs[condition.name, system]] for system in SYSTEMS}


def _rows(condition: Condition, runs: Runs) -> list[harness.Row]:
    mean, p99 = (
        (harness.NONE, harness.NONE) if condition.asked_cm is None else (f"≤ {bound:g}" for bound in condition.asked_cm)
    )
    rows: list[harness.Row] = []
    for figure, name, asked in (
        ("mean_cm", "mean (cm)", mean), ("median_cm", "median (cm)", harness.NONE), ("p99_cm", "99 % (cm)", p99),
        ("heading_deg", "heading (°)", harness.NONE), ("tracked", "tracked (%)", harness.NONE),
    ):  # fmt: skip
        values = _of(runs, condition, figure)
        best = min(OTHERS, key=lambda system: float(np.nanmean(values[system])))
        less = harness.interval(np.subtract(values[OWN], values[best])) if figure != "tracked" else harness.NONE
        cells = {system: harness.interval(each, 1 if figure == "tracked" else 2) for system, each in values.items()}
        rows.append(row("" if rows else condition.title, name, asked, cells, less))
    wrong = {system: str(max(each)) for system, each in _of(runs, condition, "wrong").items()}
    return [*rows, row("", "wrong, called tracking: most frames in a row", "≤ 5", wrong)]


def _paper_rows(conditions: Sequence[Condition], runs: Runs) -> list[harness.Row]:
    """In how many of the papers' experiments we are better than every other system, robot by robot."""
    papers = [condition for condition in conditions if condition.papers]
    means = {condition.title: _of(runs, condition, "mean_cm") for condition in papers}
    last = {c.title: {s: float(np.mean(each)) for s, each in _of(runs, c, "p99_cm").items()} for c in papers}
    less = [name for name, of in means.items() if all(_is_less(np.subtract(of[OWN], of[s])) for s in OTHERS)]
    no_more = [name for name, of in last.items() if all(of[OWN] <= of[s] for s in OTHERS if np.isfinite(of[s]))]
    rows: list[harness.Row] = []
    for figure, kept in (("mean less than every other's", less), ("99 % no more than the best other's", no_more)):
        missed = [name for name in means if name not in kept]
        counts = f"{len(kept)} of {len(papers)}" + (f"; not: {'; '.join(missed)}" if missed else "")
        rows.append(row("" if rows else "the papers' experiments", figure, "all", {OWN: counts}))
    return rows


def _is_less(differences: npt.NDArray[np.float64]) -> bool:
    """Whether the mean of differences lies below 0 with 95 %; a robot that the other never found counts for us."""
    known = differences[np.isfinite(differences)]
    return not len(known) or over_robots(known, np.mean).high < 0.0


def _picture(runs: Runs) -> Figure:
    """Mean and 99 % of the errors of every robot under every condition, a dot for each."""
    figure, axes = new_figure(1, 2, (13.0, 6.4), ("mean error (cm)", "99 % (cm)"))
    for number, (axis, name) in enumerate(zip(axes, ("mean_cm", "p99_cm"), strict=True)):
        for k, condition in enumerate(CONDITIONS):
            for n, ((system, values), tint) in enumerate(zip(_of(runs, condition, name).items(), TINTS, strict=True)):
                height = k + 0.2 * (n - 1.5)
                robot_dots(axis, values, height, tint, system if k == 0 else None)
                axis.plot([np.nanmean(values)] * 2, [height - 0.09, height + 0.09], color=tint, linewidth=1.6)
            for bound in (condition.asked_cm or ())[number : number + 1]:
                axis.plot([bound] * 2, [k - 0.45, k + 0.45], color=palette.VERMILLION, linewidth=1.0, linestyle="--")
        axis.set(xscale="log", ylim=(len(CONDITIONS) - 0.5, -0.5))
        axis.set_yticks(range(len(CONDITIONS)), ["" if number else condition.name for condition in CONDITIONS])
    axes[1].legend(frameon=False, fontsize=8)
    return figure


class Played(NamedTuple):
    """Of one run of play: longest times (s) that it was called tracking while at the other end, and while wrong at all;
    share of frames tracked, and the mean error of these (m).
    """

    flip_s: float
    loss_s: float
    tracked: float
    error_m: float


def play_rows(seeds: int) -> list[harness.Row]:
    """Hours of play, and kidnaps in play."""
    played = list(harness.computed(_played, harness.seed_range(seeds, RUNS), "runs of play"))
    hours = f"{RUNS * seeds * MINUTES / 60.0:g} h of match, the compass fails for {FAULT_S:g} s every {MINUTES:g} min"
    flips, losses = sum(one.flip_s > FLIP_S for one in played), sum(one.loss_s > LOSS_S for one in played)
    kidnaps = harness.gathered(_kidnapped, harness.seed_range(seeds, KIDNAP_RUNS), "runs with kidnaps")
    every = {system: [one for run in runs for one in run] for system, runs in kidnaps.items()}
    right = {system: harness.rate(sum(one.right for one in each), len(each)) for system, each in every.items()}
    rest = {system: [one for one in each if not one.right] for system, each in every.items()}
    searching = {system: f"{sum(one.searching for one in each)} of {len(each)}" for system, each in rest.items()}
    wrong = {system: str(sum(one.wrong > drives.FOOLED_FRAMES for one in each)) for system, each in every.items()}
    return [
        row(hours, f"at the other end for more than {FLIP_S:g} s", "0", {OWN: str(flips)}),
        row("", f"wrong, called tracking, for more than {LOSS_S:g} s", "0", {OWN: str(losses)}),
        row("", "tracked (%)", harness.NONE, {OWN: harness.interval([100.0 * one.tracked for one in played], 1)}),
        row("", "mean (cm)", harness.NONE, {OWN: harness.interval([100.0 * one.error_m for one in played])}),
        row("kidnaps in play", f"right within {drives.WITHIN_FRAMES} frames", "≥ 99.5 %", right),
        row("", "of the rest searching", "all", searching),
        row("", f"wrong, called tracking, for more than {drives.FOOLED_FRAMES} frames", "0", wrong),
    ]


def _kidnapped(run: int) -> dict[str, list[Kidnapped]]:
    """The kidnaps of one match, by system."""
    drive = driven("match", run, KIDNAP_SECONDS, *drives.KIDNAPS)
    return {system: kidnaps_of(drive, followed(system, drive, run)) for system in SYSTEMS}


def _played(run: int) -> Played:
    """One run of play with a fault of the compass in it: stuck, or showing the opposite, by turns."""
    rng = np.random.default_rng([run, 18])
    begin_s = float(rng.uniform(30.0, 60.0 * MINUTES - 2.0 * FAULT_S))
    fault = Fault("", begin_s, begin_s + FAULT_S, stuck_compass if run % 2 else turned_compass)
    return played_of(followed(OWN, fault.laid_into(driven("match", run, 60.0 * MINUTES, *_COMPASS), rng), run))


def played_of(track: Track) -> Played:
    """What our own system made of a drive."""
    period_s, tracked = float(np.median(np.diff(track.times_s))), track.distances_m[track.tracking]
    return Played(
        period_s * longest(track.tracking & track.turned.within(drives.WRONG_M, drives.WRONG_RAD)),
        period_s * longest(track.wrong),
        float(track.tracking.mean()),
        float(tracked.mean()) if len(tracked) else float("nan"),
    )
