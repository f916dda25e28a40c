"""lu2013-lighting (Table 2, figure 8): one colour table under other light, with exposure control and without."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from touchline.experiments.harness import NONE, ExperimentResult, Headline, Row, follow, paper_cells, percent, spread
from touchline.experiments.lighting_runs import (
    CASES,
    DARKER,
    FIRST,
    GLASS,
    LEFT_ON,
    RATE_HZ,
    SECOND,
    SECONDS,
    SWITCH_S,
    THIRD,
    Case,
    Robot,
    Run,
    drive,
    learned_colours,
    points_in_the_dark,
)
from touchline.experiments.scenes import BLUE, RED, dots, new_figure, way
from touchline.geometry import FloatArray
from touchline.simulation.run import Simulation
from touchline.simulation.scenario import open_scenario

COLUMNS = (
    "light", "exposure", "figure",
    "x paper", "x its form here", "x (cm)", "y paper", "y its form here", "y (cm)",
    "θ paper", "θ its form here", "θ (rad)", "position its form here (cm)", "position (cm)",
    "of the first: paper", "its form here", "of the first", "line points", "tracked: its form here", "tracked",
    "ideal: position (cm)", "ideal: tracked",
)  # fmt: skip
BUILT = 3  # robots as built, of whom more would take too long
WITHOUT = (SECOND, THIRD, GLASS)  # cases that are driven without control, too


Job = tuple[str, bool]  # a case's name and whether the exposure is controlled (False: the first case's settings)
Runs = Mapping[str, Mapping[Job, Sequence[Run]]]  # by form: ours, paper, ideal


def lu2013_lighting(seeds: int) -> ExperimentResult:
    """Table 2: each case with exposure control, some also with the settings that suited the first case."""
    ideals = [(seed, True) for seed in range(seeds)]
    with tempfile.TemporaryDirectory() as folder:
        best, robots = {}, {}
        for seed, ideal in follow([*((seed, False) for seed in range(min(seeds, BUILT))), *ideals], "colours"):
            robots[seed, ideal] = Robot(seed, Path(folder, f"{seed}-{ideal}.npz"), ideal)
            best[seed, ideal] = learned_colours(seed, robots[seed, ideal].colours, ideal=ideal)
        runs = _all_runs(list(robots.values()), best)
        dark = [
            points_in_the_dark(seed, robots[seed, True].colours, best[seed, True])
            for seed in follow(range(seeds), "places in the dark")
        ]
    rows = [row for case in CASES for row in _rows(case, True, runs)]
    rows += [row for case in WITHOUT for row in _rows(case, False, runs)]
    return ExperimentResult(
        "Table 2 of Lu et al. 2013: errors under other light, colours learned in the first case only",
        COLUMNS,
        rows,
        _headline(runs),
        (*_NOTES, _switched_off(runs["ours"][THIRD.name, False]), _darkness(dark), _exposures(runs["ours"])),
        (
            ("tracks", _tracks_figure([(c.name, runs["ours"][c.name, True][0]) for c in (FIRST, SECOND, THIRD)])),
            ("exposure", _exposure_figure(runs["ours"])),
        ),
    )


def _all_runs(robots: Sequence[Robot], best: Mapping[tuple[int, bool], tuple[float, float]]) -> Runs:
    """All drives; best: exposure (ms) and gain of the first case, by seed and whether the robot is ideal."""
    jobs = [(case, True) for case in CASES] + [(case, False) for case in WITHOUT]
    runs: dict[str, dict[Job, list[Run]]] = {
        form: {(case.name, control): [] for case, control in jobs} for form in ("ours", "paper", "ideal")
    }
    every = [(robot, job) for robot in robots for job in jobs if not robot.ideal or _has_ideal(*job)]
    for robot, (case, control) in follow(every, "drives"):
        fixed = None if control else best[robot.seed, robot.ideal]
        runs["ideal" if robot.ideal else "ours"][case.name, control].append(drive(case, robot, fixed))
        if control and case.paper is not None and not robot.ideal:
            runs["paper"][case.name, control].append(drive(case, replace(robot, paper=True), None))
    return runs


_NOTES = (
    f"The scenarios lighting-1 to 3 rendered, {SECONDS:g} s at {RATE_HZ:g} images per second; straight tracks. Robots "
    f"as built, {BUILT} of them, camera.yaml from calibrate mirror, eight robots moving about, but without motion "
    "blur; its form here: the same with the system's and the exposure control's preset `paper`. Beside them an ideal "
    "robot for each seed, three robots standing about. Errors are those since the first tracked image; line points are "
    "means over all images. The robot waits while the control searches. Without control exposure and gain stay at what "
    "the control found at the first case's start.",
    "Of the first: errors over those of the first case, each as the root of the squared means in x and in y, the "
    "paper's by the same formula.",
    "Levels of light: 1 is the hall's lamps, 500 lx (EN 12193, class II; JGJ 153-2007, matches of amateurs). Second "
    "case: patches of sun 6 times as bright, as in the recorded linear images (omni_exposure), 0.6 of daylight "
    "everywhere. Third case: lamps go off and on every 10 s. The paper's first case knows no daylight, and its third "
    "switches the lamps; what was left it doesn't say. Here two standards take turns: 20 lx of safety lighting in a "
    "sports hall (0.04; JGJ 153-2007, of the paper's country) and 10 lx, the least among spectators (0.02; EN 12193). "
    "That the first costs nothing and the second does was known when they were taken. Dull "
    "day: 100 lx (0.2), 5000 lx outside at a daylight factor of 2 %. Clear glass: the sun at 35 degrees "
    "brings 50 klx to the ground, 38 klx behind two panes: 76 times the lamps, with 2.0 of daylight from sky and "
    "bounces. The entropy's peak exposes for the shade; patches are white all over, and what lies under them counts "
    "neither as carpet nor as its end.",
    "Without control the paper found no line points in its second case: its look-up table classes absolute colours, "
    "where the detector here compares a line with the "
    "green beside it. The paper's best settings fall from 18 ms, 18 to 12 ms, 12 from the first case to the second, by "
    "a factor of 2.25.",
)


def _rows(case: Case, control: bool, runs: Runs) -> list[Row]:
    """Mean, standard deviation and maximum, as the paper has them."""
    ours, paper, ideal = (runs[form][case.name, control] for form in ("ours", "paper", "ideal"))
    rows: list[Row] = []
    said = case.paper if control else None
    for k, (title, key) in enumerate((("mean", "mean"), ("std", "std_signed"), ("max", "max"))):
        cells = paper_cells(said and said[k], partial(_figure, key=key), paper, ours)
        head, last = ("", ""), ""
        more: Row = ("",) * 6
        if k == 0:
            theirs = NONE if said is None else f"{paper_ratio(case):.2f}"
            ratios = (_of_the_first(some, runs[form]) for some, form in ((paper, "paper"), (ours, "ours")))
            points = spread([float(run.track.points.mean()) for run in ours], 0)
            head = (case.name, "controlled" if control else "as in the first")
            more, last = (theirs, *ratios, points, _tracked(paper), _tracked(ours)), _tracked(ideal)
        rows.append((*head, title, *cells, *more, _figure(ideal, "position", key), last))
    return rows


def _has_ideal(case: Case, control: bool) -> bool:
    """Whether ideal robots drive it: the paper's cases, and clear glass both ways."""
    return case is GLASS or (control and case.paper is not None)


def _figure(runs: Sequence[Run], name: str, key: str) -> str:
    tables = [run.errors for run in runs if run.errors is not None]
    scale, decimals = (1.0, 4) if name == "heading" else (100.0, 2)
    return spread([scale * getattr(getattr(t, name), key) for t in tables], decimals)


def _tracked(runs: Sequence[Run]) -> str:
    return percent([float(run.track.tracking.mean()) for run in runs])


def _of_the_first(runs: Sequence[Run], every: Mapping[Job, Sequence[Run]]) -> str:
    ratios = [run.mean_xy_m / first.mean_xy_m for run, first in zip(runs, every[FIRST.name, True], strict=False)]
    return spread(ratios) if np.isfinite(ratios).all() else "–"


def paper_ratio(case: Case) -> float:
    """The paper's mean error in x and y over that of its first case."""
    assert case.paper is not None
    assert FIRST.paper is not None
    return math.hypot(*case.paper[0][:2]) / math.hypot(*FIRST.paper[0][:2])


def _headline(runs: Runs) -> Headline:
    def error_m(every: Mapping[Job, Sequence[Run]], case: Case) -> float:
        return float(np.mean([run.mean_xy_m for run in every[case.name, True]]))

    def ratios(every: Mapping[Job, Sequence[Run]]) -> str:
        return ", ".join(f"{error_m(every, case) / error_m(every, FIRST):.2f}" for case in (SECOND, THIRD))

    def points(case: Case, control: bool) -> float:
        return float(np.mean([run.track.points.mean() for run in runs["ours"][case.name, control]]))

    left = [100.0 * points(case, False) / points(FIRST, True) for case in (SECOND, THIRD)]
    return Headline(
        "mean error of the second and third case over the first's; line points left without control",
        f"{paper_ratio(SECOND):.2f}, {paper_ratio(THIRD):.2f}; none, –",
        f"{ratios(runs['ours'])}; {left[0]:.0f} %, {left[1]:.0f} %; ideal {ratios(runs['ideal'])}",
    )


def _switched_off(runs: Sequence[Run]) -> str:
    """What the third case leaves of the line points while the lamps are off."""
    told = []
    for turn, level in enumerate(LEFT_ON):
        left = []
        for run in runs:
            interval = (np.arange(len(run.track.points)) + 1) / RATE_HZ // SWITCH_S
            off = (interval % 2 == 1) & (interval // 2 % len(LEFT_ON) == turn)
            left.append(100.0 * float(run.track.points[off].mean() / run.track.points[interval % 2 == 0].mean()))
        told.append(f"{spread(left, 0)} % at {500.0 * level:g} lx")
    return f"Third case without control, line points while the lamps are off: {', '.join(told)}."


def _darkness(dark: Sequence[FloatArray]) -> str:
    """How far the first case's settings reach, from each seed's `points_in_the_dark`."""
    parts = []
    for k, level in enumerate(DARKER, start=1):
        fixed, controlled = (spread([100.0 * float(each[k, c] / each[0, c]) for each in dark], 0) for c in (0, 1))
        parts.append(f"{500.0 * level:g} lx ({level:g}) {fixed} % and {controlled} %")
    return (
        "Line points at eight places per seed in even light, as a share of those under lamps, without control and with "
        f"it: {'; '.join(parts)}."
    )


def _exposures(runs: Mapping[Job, Sequence[Run]]) -> str:
    """How far the control moved."""
    base = np.mean([run.stops[0] for run in runs[FIRST.name, True]])
    found = {case.name: 2.0 ** (np.mean([run.stops.mean() for run in runs[case.name, True]]) - base) for case in CASES}
    least = {case.name: 2.0 ** (np.max([run.stops.max() for run in runs[case.name, True]]) - base) for case in CASES}
    return (
        "Exposure times gain under control, over that of the first case's start: "
        + ", ".join(f"{name}: {value:.2f} (at most {least[name]:.2f})" for name, value in found.items())
        + "."
    )


def _tracks_figure(drives: Sequence[tuple[str, Run]]) -> Figure:
    """As figure 8 (a), (e), (f): black the way, red the traces, black points where the exposure was searched."""
    field, names = Simulation(open_scenario("lighting-1")).field, [name for name, _ in drives]
    figure, axes = new_figure(1, len(drives), (4.6 * len(drives), 3.6), names, field=field)
    for axis, (_, run) in zip(axes, drives, strict=True):
        way(axis, run.track.truth, "black", 1.8, zorder=2)
        way(axis, run.track.poses[run.track.tracking], RED, 0.8, zorder=3)
        dots(axis, run.track.truth[run.searched], "black", 6, zorder=4)
    return figure


def _exposure_figure(every: Mapping[Job, Sequence[Run]]) -> Figure:
    """Line points and exposure over time, with control and without."""
    shown = WITHOUT
    figure, axes = new_figure(2, len(shown), (4.6 * len(shown), 5.4))
    for k, case in enumerate(shown):
        for control, colour, label in ((True, BLUE, "controlled"), (False, RED, "as in the first case")):
            run = every[case.name, control][0]
            seconds = (np.arange(len(run.track.points)) + 1) / RATE_HZ
            axes[k].plot(seconds, run.track.points, color=colour, linewidth=1.0, label=label)
            axes[k + len(shown)].plot(seconds, 2.0**run.stops, color=colour, linewidth=1.2)
        axes[k].set(title=case.name, ylim=(0, None))
        axes[k + len(shown)].set(yscale="log", xlabel="time (s)", ylim=(4.0, 1200.0))
    axes[0].set_ylabel("line points")
    axes[len(shown)].set_ylabel("exposure · gain (ms)")
    axes[2].legend(frameon=False, loc="lower right")
    return figure
