"""lu2013-lighting (Table 2, figure 8): one colour table under other light, with exposure control and without."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from touchline.experiments.lighting_runs import (
    CASES,
    DARKER,
    FIRST,
    GLASS,
    LEFT_ON,
    RATE_HZ,
    SECOND,
    SWITCH_S,
    THIRD,
    Case,
    Drive,
    drive,
    learned_colours,
    points_in_the_dark,
)
from touchline.experiments.progress import follow
from touchline.experiments.result import ExperimentResult, Headline, spread
from touchline.experiments.scenes import BLUE, RED, field_axes, new_figure
from touchline.geometry import FloatArray
from touchline.simulation.run import Simulation
from touchline.simulation.scenario import open_scenario

COLUMNS = (
    "light", "exposure", "figure", "x paper", "x (cm)", "y paper", "y (cm)", "θ paper", "θ (rad)",
    "position (cm)", "of the first", "line points", "tracked",
)  # fmt: skip


def lu2013_lighting(seeds: int) -> ExperimentResult:
    """Table 2: each case with exposure control, then with the settings that suited the first case."""
    controlled: dict[str, list[Drive]] = {case.name: [] for case in CASES}
    fixed: dict[str, list[Drive]] = {case.name: [] for case in CASES}
    with tempfile.TemporaryDirectory() as folder:
        best = [learned_colours(seed, Path(folder, f"{seed}.npz")) for seed in follow(range(seeds), "colours")]
        for case, seed in follow([(case, seed) for seed in range(seeds) for case in CASES], "cases"):
            colours = Path(folder, f"{seed}.npz")
            controlled[case.name].append(drive(case, seed, colours, None))
            fixed[case.name].append(drive(case, seed, colours, best[seed]))
        dark = [
            points_in_the_dark(seed, Path(folder, f"{seed}.npz"), best[seed])
            for seed in follow(range(seeds), "places in the dark")
        ]
    firsts = controlled[FIRST.name]
    rows = [
        row
        for case in CASES
        for name, runs in (("controlled", controlled[case.name]), ("as in the first", fixed[case.name]))
        for row in _rows(case, name, runs, firsts)
    ]
    return ExperimentResult(
        "lu2013-lighting",
        "Table 2 of Lu et al. 2013: errors under other light, colours learned in the first case only",
        seeds,
        COLUMNS,
        tuple(rows),
        _headline(controlled, fixed),
        (*_NOTES, _switched_off(fixed[THIRD.name]), _darkness(dark), _exposures(controlled)),
        (
            ("tracks", _tracks_figure([(c.name, controlled[c.name][0]) for c in (FIRST, SECOND, THIRD)])),
            ("exposure", _exposure_figure(controlled, fixed)),
        ),
    )


_NOTES = (
    f"The scenarios lighting-1 to 3 rendered, 60 s at {RATE_HZ:g} images per second and seed; straight tracks, three "
    "standing robots. Errors are those since the first tracked image; line points are means over all images. The robot "
    "waits while the control searches. Without control exposure and gain stay at what the control found at the first "
    "case's start.",
    "Levels of light: 1 is the hall's lamps, 500 lx (EN 12193, class II; JGJ 153-2007, matches of amateurs). Second "
    "case: patches of sun 6 times as bright, as in the recorded linear images (omni_exposure), 0.6 of daylight "
    "everywhere. Third case: lamps go off and on every 10 s. The paper's first case knows no daylight, and its third "
    "switches the lamps; what was left it doesn't say. Here two standards take turns: 20 lx of safety lighting in a "
    "sports hall (0.04; JGJ 153-2007, of the paper's country) and 10 lx, the least among spectators (0.02; EN 12193). "
    "That the first costs nothing and the second does was known when they were taken. Dull "
    "day: 100 lx (0.2), 5000 lx outside at a daylight factor of 2 %. Clear glass: the sun at 35 degrees "
    "brings 50 klx to the ground, 38 klx behind two panes: 76 times the lamps, with 2.0 of daylight from sky and "
    "bounces. It is shown as the limit: the entropy's peak exposes for the shade, patches are white all over, a robot "
    "within one sees no line, and shadows of window bars draw false points. There the first case's settings, with "
    "shade overexposed too, do better.",
    "Without control the paper found no line points in its second case: its look-up table classes absolute colours, "
    "where the detector here compares a line with the "
    "green beside it. The paper's best settings fall from 18 ms, 18 to 12 ms, 12 from the first case to the second, by "
    "a factor of 2.25.",
)


def _rows(case: Case, control: str, runs: Sequence[Drive], firsts: Sequence[Drive]) -> list[tuple[str, ...]]:
    """Mean, standard deviation and maximum, as the paper has them."""
    tables = [run.errors for run in runs if run.errors is not None]
    lines: list[tuple[str, ...]] = []
    with_paper = case.paper is not None and control == "controlled"
    for k, (title, key) in enumerate((("mean", "mean"), ("std", "std_signed"), ("max", "max"))):
        paper = tuple(f"{v:g}" for v in case.paper[k]) if with_paper and case.paper else ("–",) * 3
        ours = [
            spread([scale * getattr(getattr(t, name), key) for t in tables], decimals) if tables else "–"
            for name, scale, decimals in (("x", 100, 2), ("y", 100, 2), ("heading", 1, 4), ("position", 100, 2))
        ]
        more = ("", "", "")
        if k == 0:
            ratios = [run.mean_m / first.mean_m for run, first in zip(runs, firsts, strict=True)]
            more = (
                spread(ratios) if np.isfinite(ratios).all() else "–",
                spread([float(run.points.mean()) for run in runs], 0),
                f"{spread([100.0 * float(run.tracked.mean()) for run in runs], 1)} %",
            )
        head = (case.name, control) if k == 0 else ("", "")
        lines.append((*head, title, paper[0], ours[0], paper[1], ours[1], paper[2], ours[2], ours[3], *more))
    return lines


def _headline(controlled: dict[str, list[Drive]], fixed: dict[str, list[Drive]]) -> Headline:
    def error_m(runs: Sequence[Drive]) -> float:
        return float(np.mean([run.mean_m for run in runs]))

    def points(runs: Sequence[Drive]) -> float:
        return float(np.mean([run.points.mean() for run in runs]))

    ratios = [error_m(controlled[case.name]) / error_m(controlled[FIRST.name]) for case in (SECOND, THIRD)]
    left = [100.0 * points(fixed[case.name]) / points(fixed[FIRST.name]) for case in (SECOND, THIRD)]
    return Headline(
        "mean error of the second and third case over the first's; line points left without control",
        "1.00, 0.77; none, –",
        f"{ratios[0]:.2f}, {ratios[1]:.2f}; {left[0]:.0f} %, {left[1]:.0f} %",
    )


def _switched_off(runs: Sequence[Drive]) -> str:
    """What the third case leaves of the line points while the lamps are off."""
    told = []
    for turn, level in enumerate(LEFT_ON):
        left = []
        for run in runs:
            interval = (np.arange(len(run.points)) + 1) / RATE_HZ // SWITCH_S
            off = (interval % 2 == 1) & (interval // 2 % len(LEFT_ON) == turn)
            left.append(100.0 * float(run.points[off].mean() / run.points[interval % 2 == 0].mean()))
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


def _exposures(controlled: dict[str, list[Drive]]) -> str:
    """How far the control moved."""
    base = np.mean([run.stops[0] for run in controlled[FIRST.name]])
    found = {case.name: 2.0 ** (np.mean([run.stops.mean() for run in controlled[case.name]]) - base) for case in CASES}
    least = {case.name: 2.0 ** (np.max([run.stops.max() for run in controlled[case.name]]) - base) for case in CASES}
    return (
        "Exposure times gain under control, over that of the first case's start: "
        + ", ".join(f"{name}: {value:.2f} (at most {least[name]:.2f})" for name, value in found.items())
        + "."
    )


def _tracks_figure(drives: Sequence[tuple[str, Drive]]) -> Figure:
    """As figure 8 (a), (e), (f): black the way, red the traces, black points where the exposure was searched."""
    figure, axes = new_figure(1, len(drives), width_in=4.6 * len(drives), height_in=3.6)
    field = Simulation(open_scenario("lighting-1")).field
    for axis, (name, run) in zip(axes, drives, strict=True):
        field_axes(axis, field)
        axis.plot(run.truth[:, 0], run.truth[:, 1], color="black", linewidth=1.8, zorder=2)
        axis.plot(run.path[run.tracked, 0], run.path[run.tracked, 1], color=RED, linewidth=0.8, zorder=3)
        axis.plot(run.truth[run.searched, 0], run.truth[run.searched, 1], "o", color="black", markersize=6, zorder=4)
        axis.set_title(name, fontsize=10)
    return figure


def _exposure_figure(controlled: dict[str, list[Drive]], fixed: dict[str, list[Drive]]) -> Figure:
    """Line points and exposure over time, with control and without."""
    shown = (SECOND, THIRD, GLASS)
    figure, axes = new_figure(2, len(shown), width_in=4.6 * len(shown), height_in=5.4)
    for k, case in enumerate(shown):
        for runs, colour, label in ((controlled, BLUE, "controlled"), (fixed, RED, "as in the first case")):
            run = runs[case.name][0]
            seconds = (np.arange(len(run.points)) + 1) / RATE_HZ
            axes[k].plot(seconds, run.points, color=colour, linewidth=1.0, label=label)
            axes[k + len(shown)].plot(seconds, 2.0**run.stops, color=colour, linewidth=1.2)
        axes[k].set(title=case.name, ylim=(0, None))
        axes[k + len(shown)].set(yscale="log", xlabel="time (s)", ylim=(4.0, 1200.0))
    axes[0].set_ylabel("line points")
    axes[len(shown)].set_ylabel("exposure · gain (ms)")
    axes[2].legend(frameon=False, loc="lower right")
    return figure
