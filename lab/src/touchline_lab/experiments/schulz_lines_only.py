"""schulz-lines-only (Table 2, figure 6): the same walk tracked with all features, without lines, and by lines alone."""

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np
from matplotlib.figure import Figure

from touchline.field import FieldModel, open_field
from touchline.geometry import wrap_angles
from touchline_lab.experiments import harness
from touchline_lab.experiments import schulz_runs as humanoids
from touchline_lab.experiments.drives import Track
from touchline_lab.experiments.scenes import BLUE, MAGENTA, RED, new_figure, way
from touchline_lab.experiments.schulz_runs import OURS, PAPER, believed, tracked, walk

FIELD, SECONDS = "indoor-9x6", 600.0
CONDITIONS = {"all observations": (), "no lines": humanoids.WITHOUT_LINES, "only lines": humanoids.ONLY_LINES}
ALL, WITHOUT, ONLY = CONDITIONS
TRUTH = "truth"
# Table 2: Euclid (m) and angle (rad).
PAIRS = {(ALL, WITHOUT): (0.17, 0.09), (ALL, ONLY): (0.14, 0.07), (WITHOUT, ONLY): (0.26, 0.15)}
COLUMNS = ("robot", "system", "condition", "reference", "paper (m)", "ours (m)", "paper (rad)", "ours (rad)", "right")
AS_BUILT, AS_SIMULATED, IDEAL = humanoids.AS_BUILT, humanoids.AS_SIMULATED, humanoids.IDEAL
CASES = ((AS_BUILT, OURS), (AS_BUILT, PAPER), (AS_SIMULATED, OURS), (AS_SIMULATED, PAPER), (IDEAL, OURS))
_BESIDE = {OURS: (), PAPER: humanoids.TRACKING_ALONE}
_NOTES = (
    f"The scenario humanoid-walk on {FIELD} at the observation level, {SECONDS:g} s from target area to target area, "
    "per seed; the start is told within 0.3 m and 10°, all three tracks are of the same frames. The robots are those "
    "of schulz-accuracy. The paper recorded one circle, and had no truth for it.",
    "Means over the frames. Right: within 0.5 m and 20° of the truth, and believed by the system. No lines: posts "
    "and poles alone, without the centre circle and penalty marks; only lines: lines and crossings. The paper tracks "
    "without global localization here, and so does its own form: no random particles.",
)

Tracks = Mapping[str, Track]  # by condition


def schulz_lines_only(seeds: int) -> harness.ExperimentResult:
    """Ten minutes per seed, three conditions."""
    walks = list(product((AS_BUILT, AS_SIMULATED, IDEAL), harness.seed_range(seeds)))
    found = harness.gathered(_tracks, walks, "walks")
    built = found[CASES[0]]
    pairs = ((ONLY, TRUTH), (ALL, ONLY))
    to_truth, to_all = (harness.spread([100.0 * _apart(tracks, *pair)[0] for tracks in built], 1) for pair in pairs)
    lost = harness.percent([1.0 - believed(tracks[ONLY]) for tracks in built])
    return harness.ExperimentResult(
        "Table 2 and figure 6 of Schulz and Behnke 2012: pose tracking by lines alone",
        COLUMNS,
        [row for case in CASES for row in _rows(case, found[case])],
        harness.Headline(
            "lines alone, robot as built: mean deviation from the truth; from the track of all; frames not right",
            "–; 14 cm; none",
            f"{to_truth} cm; {to_all} cm; {lost}",
        ),
        _NOTES,
        (("figure6", _figure(open_field(FIELD), built[0])),),
    )


def _tracks(task: tuple[humanoids.Robot, int]) -> dict[tuple[humanoids.Robot, str], Tracks]:
    """Of one walk by both forms of the system."""
    robot, seed = task
    walked = walk(FIELD, robot, seed, SECONDS)
    return {
        (robot, system): {
            name: tracked(walked, seed, humanoids.settings(system, *_BESIDE[system], *off))
            for name, off in CONDITIONS.items()
        }
        for chosen, system in CASES
        if chosen == robot
    }


def _rows(case: tuple[humanoids.Robot, str], found: Sequence[Tracks]) -> list[harness.Row]:
    rows: list[harness.Row] = []
    for one, other in (*PAIRS, *((name, TRUTH) for name in CONDITIONS)):
        apart = np.array([_apart(tracks, one, other) for tracks in found])
        metres, radians = (
            (f"{value:g}" for value in PAIRS[one, other]) if other != TRUTH else (harness.NONE, harness.NONE)
        )
        right = harness.percent([believed(tracks[one]) for tracks in found]) if other == TRUTH else harness.NONE
        first = ("", "") if rows else (case[0].name, case[1])
        rows.append(
            (*first, one, other, metres, harness.spread(apart[:, 0], 3), radians, harness.spread(apart[:, 1], 3), right)
        )
    return rows


def _apart(tracks: Tracks, one: str, other: str) -> tuple[float, float]:
    """Mean distance (m) and angle (rad) between two tracks."""
    offset = tracks[one].poses - (tracks[one].truth if other == TRUTH else tracks[other].poses)
    return float(np.hypot(offset[:, 0], offset[:, 1]).mean()), float(np.abs(wrap_angles(offset[:, 2])).mean())


def _figure(field: FieldModel, tracks: Tracks) -> Figure:
    """Figure 6: the tracks of the first circle."""
    figure, axes = new_figure(1, len(CONDITIONS), (11.0, 3.2), list(tracks), field=field, beyond_m=0.6)
    for axis, (name, track), tint in zip(axes, tracks.items(), (MAGENTA, RED, BLUE), strict=True):
        first = track.part(track.times_s <= 75.0)
        way(axis, first.truth, "black", label="truth", zorder=2)
        way(axis, first.poses, tint, label=name, zorder=3)
    return figure
