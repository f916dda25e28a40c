"""schulz-accuracy (figure 5): five minutes of walking, with and without lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from touchline.experiments.progress import follow
from touchline.experiments.result import ExperimentResult, Headline, percent, spread
from touchline.experiments.scenes import BLUE, MAGENTA, RED, new_figure
from touchline.experiments.schulz_recorded import recorded_note, recorded_rows
from touchline.experiments.schulz_runs import (
    AS_BUILT,
    AS_SIMULATED,
    FIELDS,
    IDEAL,
    NEAR_M,
    PANNING,
    WITHOUT_LINES,
    Robot,
    Track,
    either_end,
    random_areas,
    settings,
    time_until_right,
    tracked,
    walk,
    with_false_crossings,
)
from touchline.systems.nimbro_lines import NimbroLinesSettings
from touchline.types import Prior

SECONDS, SECONDS_WITH_FALSE, SECONDS_FROM_NOWHERE = 300.0, 600.0, 30.0
FALSE_SHARES = (0.1, 0.3, 0.5)
STARTS_FROM_NOWHERE = 4  # per seed
COLUMNS = ("robot", "field", "system", "features", "median (cm)", "within 40 cm", "95 % (cm)", "heading (°)", "right")
LINES, NO_LINES = "all", "without lines"
OURS, PAPER = "nimbro-lines", "the paper's own form"


_SIMULATED = (
    f"The scenario humanoid-walk at the observation level, {SECONDS:g} s at 8 Hz, per seed. As built: the camera's "
    "roll and pitch are known to 1° (0.7° in every image anew, 0.7° all the time), a quarter of the lines and "
    "crossings is worn off, four robots walk about close by, for two of every four seconds the head is turned away "
    "from the field. As simulated: 0.25° in every image, two robots. Panning: ± 60° within 8 s. Ideal: no error of "
    "roll and pitch, nobody else."
)
_STARTS = (
    "The start is told within 0.3 m and 10°. Right: within 0.5 m and 20°, and believed by the system. Without lines: "
    "posts, poles and marks alone."
)
_FALSE = (
    f"False crossings: over {SECONDS_WITH_FALSE:g} s each, so much of all crossings is none: even in the view, of "
    "random kind, turned anyhow; all else as simulated."
)


class Case(NamedTuple):
    """One row: which robot, which of FIELDS, which form of the system, with lines or without."""

    robot: Robot
    field: str
    system: str
    features: str


def cases() -> list[Case]:
    """As built first; the ideal robot last."""
    built = [
        Case(AS_BUILT, field, system, features)
        for field in FIELDS
        for system in (OURS, PAPER)
        for features in (LINES, NO_LINES)
    ]
    simulated = [Case(AS_SIMULATED, field, system, LINES) for field in FIELDS for system in (OURS, PAPER)]
    return built + simulated + [Case(robot, field, OURS, LINES) for robot in (PANNING, IDEAL) for field in FIELDS]


def schulz_accuracy(seeds: int) -> ExperimentResult:
    """Walks at the observation level, then the recordings."""
    tracks: dict[Case, list[Track]] = {case: [] for case in cases()}
    places = dict.fromkeys((case.robot, case.field) for case in tracks)
    for (robot, field), seed in follow([(place, seed) for place in places for seed in range(seeds)], "walks"):
        walked = walk(field, robot, seed, SECONDS)
        for case in tracks:
            if (case.robot, case.field) == (robot, field):
                tracks[case].append(tracked(walked, _settings(case), seed))
    rows: list[tuple[str, ...]] = [
        ("the paper's robot", "TeenSize 2010", "the paper", "all", "17", "89 %", "–", "–", "–"),
        ("", "", "", "without lines", "26", "66 %", "–", "–", "–"),
    ]
    rows += [(case.robot.name, case.field, case.system, case.features, *_cells(tracks[case])) for case in tracks]
    rows += _false_rows(seeds)
    recorded = recorded_rows()
    built = [case for case in tracks if case.robot is AS_BUILT and case.system == OURS]
    ours = [_headline(tracks[case]) for case in built if case.features == LINES]
    return ExperimentResult(
        "schulz-accuracy",
        "Figure 5 of Schulz and Behnke 2012: five minutes of walking, with lines and without",
        seeds,
        COLUMNS,
        (*rows, *recorded),
        Headline(
            "median error and poses within 40 cm, robot as built, coloured goals; white goals",
            "17 cm, 89 % (without lines: 26 cm, 66 %)",
            "; ".join(ours),
        ),
        (_SIMULATED, _STARTS, _FALSE, _from_nowhere(seeds), recorded_note(bool(recorded))),
        (("figure5", _histogram({case: tracks[case] for case in built})),),
    )


def _settings(case: Case) -> NimbroLinesSettings:
    changes = WITHOUT_LINES if case.features == NO_LINES else ()
    return settings("paper" if case.system == PAPER else None, *changes)


def _cells(tracks: Sequence[Track]) -> tuple[str, ...]:
    """Median, share within 40 cm, 95 %, heading, share right and believed."""
    return (
        spread([100.0 * float(np.median(t.distances_m)) for t in tracks], 1),
        percent([float(np.mean(t.distances_m <= NEAR_M)) for t in tracks]),
        spread([100.0 * float(np.quantile(t.distances_m, 0.95)) for t in tracks], 0),
        spread([float(np.degrees(np.median(t.turns_rad))) for t in tracks], 2),
        percent([float(np.mean(t.right & t.tracking)) for t in tracks]),
    )


def _false_rows(seeds: int) -> list[tuple[str, ...]]:
    """Longer walks whose crossings are partly none."""
    tracks: dict[tuple[str, float], list[Track]] = {(field, share): [] for field in FIELDS for share in FALSE_SHARES}
    for field, seed in follow([(field, seed) for field in FIELDS for seed in range(seeds)], "walks, false crossings"):
        walked = walk(field, AS_SIMULATED, seed, SECONDS_WITH_FALSE)
        for share in FALSE_SHARES:
            frames = with_false_crossings(walked.frames, share, seed)
            tracks[field, share].append(tracked(replace(walked, frames=frames), settings(), seed))
    return [
        (f"{100 * share:.0f} % false crossings", field, OURS, LINES, *_cells(found))
        for (field, share), found in tracks.items()
    ]


def _from_nowhere(seeds: int) -> str:
    """A sentence on how long it takes until the pose is right without being told any."""
    times: dict[str, list[float]] = {field: [] for field in FIELDS}
    numbers = range(seeds * STARTS_FROM_NOWHERE)
    for field, number in follow([(field, number) for field in FIELDS for number in numbers], "starts from nowhere"):
        walked = walk(field, AS_SIMULATED, number, SECONDS_FROM_NOWHERE, random_areas(field, number))
        track = tracked(walked, settings(), number, Prior())
        times[field].append(time_until_right(either_end(track) if walked.field.is_symmetric else track))
    parts = [
        f"{field}: median {np.median(waited):.1f} s, 90 % {np.quantile(waited, 0.9, method='higher'):.1f} s, "
        f"{np.count_nonzero(np.isinf(waited))} of {len(waited)} never"
        for field, waited in times.items()
    ]
    return (
        "From nowhere, time until the pose is right and stays so for two seconds (as simulated, "
        f"{SECONDS_FROM_NOWHERE:g} s each; where nothing tells the ends apart, at either end): "
        + "; ".join(parts)
        + "."
    )


def _headline(tracks: Sequence[Track]) -> str:
    median, near = _cells(tracks)[:2]
    return f"{median} cm, {near}"


def _histogram(tracks: dict[Case, list[Track]]) -> Figure:
    """The middle of figure 5: distances from the truth, of the robot as built."""
    figure, axes = new_figure(1, len(FIELDS), 9.0, 3.4)
    edges = np.arange(0.0, 1.05, 0.05)
    for axis, field in zip(axes, FIELDS, strict=True):
        for case, tint in zip((c for c in tracks if c.field == field), (BLUE, RED), strict=False):
            away = np.minimum(np.concatenate([track.distances_m for track in tracks[case]]), 0.999)
            shares = 100.0 * np.histogram(away, edges)[0] / len(away)
            axis.stairs(shares, edges, fill=True, alpha=0.35, color=tint)
            axis.stairs(shares, edges, color=tint, label=case.features)
        axis.axvline(NEAR_M, color=MAGENTA, linewidth=1.0, linestyle="--")
        axis.set_title(f"{field} ({FIELDS[field]})", fontsize=10)
        axis.set_xlabel("distance from the truth (m); the last bar: all beyond")
        axis.set_ylabel("poses (%)")
        axis.legend(frameon=False)
    return figure
