"""schulz-lines-only (Table 2, figure 6): the same walk tracked with all features, without lines, and by lines alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from touchline.experiments.progress import follow
from touchline.experiments.result import ExperimentResult, Headline, percent, spread
from touchline.experiments.scenes import BLUE, MAGENTA, RED, field_axes, new_figure
from touchline.experiments.schulz_runs import (
    AS_BUILT,
    AS_SIMULATED,
    IDEAL,
    ONLY_LINES,
    TRACKING_ALONE,
    WITHOUT_LINES,
    Robot,
    Track,
    settings,
    tracked,
    walk,
)
from touchline.field import FieldModel, open_field
from touchline.geometry import wrap_angles

FIELD, SECONDS = "indoor-9x6", 600.0
CONDITIONS = {"all observations": (), "no lines": WITHOUT_LINES, "only lines": ONLY_LINES}
ALL, NONE, ONLY = CONDITIONS
TRUTH = "truth"
# Table 2: Euclid (m) and angle (rad).
PAIRS = {(ALL, NONE): (0.17, 0.09), (ALL, ONLY): (0.14, 0.07), (NONE, ONLY): (0.26, 0.15)}
COLUMNS = ("robot", "system", "condition", "reference", "paper (m)", "ours (m)", "paper (rad)", "ours (rad)", "right")


class Case(NamedTuple):
    """A robot and a form of the system."""

    robot: Robot
    preset: str | None


CASES = (
    Case(AS_BUILT, None),
    Case(AS_BUILT, "paper"),
    Case(AS_SIMULATED, None),
    Case(AS_SIMULATED, "paper"),
    Case(IDEAL, None),
)
_NAMES = {None: "nimbro-lines", "paper": "the paper's own form"}
_BESIDE = {None: (), "paper": TRACKING_ALONE}
_NOTES = (
    f"The scenario humanoid-walk on {FIELD} at the observation level, {SECONDS:g} s from target area to target area, "
    "per seed; the start is told within 0.3 m and 10°, all three tracks are of the same frames. The robots are those "
    "of schulz-accuracy. The paper recorded one circle, and had no truth for it.",
    "Means over the frames. Right: within 0.5 m and 20° of the truth, and believed by the system. No lines: posts, "
    "poles and marks alone; only lines: lines and crossings. The paper tracks without global localization here, and so "
    "does its own form: no random particles.",
)

Tracks = dict[str, Track]


def schulz_lines_only(seeds: int) -> ExperimentResult:
    """Ten minutes per seed, three conditions."""
    found: dict[Case, list[Tracks]] = {case: [] for case in CASES}
    for robot, seed in follow(
        [(robot, seed) for robot in (AS_BUILT, AS_SIMULATED, IDEAL) for seed in range(seeds)], "walks"
    ):
        walked = walk(FIELD, robot, seed, SECONDS)
        for case in (case for case in CASES if case.robot is robot):
            found[case].append(
                {
                    name: tracked(walked, settings(case.preset, *_BESIDE[case.preset], *off), seed)
                    for name, off in CONDITIONS.items()
                }
            )
    built = found[CASES[0]]
    to_truth = [100.0 * _apart(tracks, ONLY, TRUTH)[0] for tracks in built]
    to_all = [100.0 * _apart(tracks, ALL, ONLY)[0] for tracks in built]
    lost = percent([1.0 - _right(tracks[ONLY]) for tracks in built])
    return ExperimentResult(
        "schulz-lines-only",
        "Table 2 and figure 6 of Schulz and Behnke 2012: pose tracking by lines alone",
        seeds,
        COLUMNS,
        tuple(row for case in CASES for row in _rows(case, found[case])),
        Headline(
            "lines alone, robot as built: mean deviation from the truth; from the track of all; frames not right",
            "–; 14 cm; none",
            f"{spread(to_truth, 1)} cm; {spread(to_all, 1)} cm; {lost}",
        ),
        _NOTES,
        (("figure6", _figure(open_field(FIELD), built[0])),),
    )


def _rows(case: Case, found: Sequence[Tracks]) -> list[tuple[str, ...]]:
    pairs = {**PAIRS, **{(name, TRUTH): (None, None) for name in CONDITIONS}}
    rows: list[tuple[str, ...]] = []
    for index, ((one, other), paper) in enumerate(pairs.items()):
        apart = np.array([_apart(tracks, one, other) for tracks in found])
        right = percent([_right(tracks[one]) for tracks in found]) if other == TRUTH else "–"
        first = (case.robot.name, _NAMES[case.preset]) if index == 0 else ("", "")
        said = ["–" if value is None else f"{value:g}" for value in paper]
        rows.append((*first, one, other, said[0], spread(apart[:, 0], 3), said[1], spread(apart[:, 1], 3), right))
    return rows


def _apart(tracks: Tracks, one: str, other: str) -> tuple[float, float]:
    """Mean distance (m) and angle (rad) between two tracks."""
    reference = tracks[one].truth if other == TRUTH else tracks[other].poses
    offset = tracks[one].poses - reference
    return float(np.hypot(offset[:, 0], offset[:, 1]).mean()), float(np.abs(wrap_angles(offset[:, 2])).mean())


def _right(track: Track) -> float:
    return float(np.mean(track.right & track.tracking))


def _figure(field: FieldModel, tracks: Tracks) -> Figure:
    """Figure 6: the tracks of the first circle."""
    figure, axes = new_figure(1, len(CONDITIONS), 11.0, 3.2)
    once = tracks[ALL].times_s <= 75.0
    for axis, (name, track), tint in zip(axes, tracks.items(), (MAGENTA, RED, BLUE), strict=True):
        field_axes(axis, field, beyond_m=0.6)
        axis.plot(*track.truth[once, :2].T, color="black", linewidth=1.0, label="truth", zorder=2)
        axis.plot(*track.poses[once, :2].T, color=tint, linewidth=1.0, label=name, zorder=3)
        axis.set_title(name, fontsize=10)
    return figure
