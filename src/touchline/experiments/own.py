"""own: what our own system reaches, beside the others and what is possible at all.

No figure of a paper. Each part of the table has a module: own_drives.py, own_play.py, own_points.py.
"""

from __future__ import annotations

from touchline.experiments import own_drives, own_points
from touchline.experiments.own_drives import FROM_S, LIT_SECONDS, SECONDS, drive_rows, drive_runs
from touchline.experiments.own_play import play_rows
from touchline.experiments.own_points import FRAMES, point_rows, point_runs
from touchline.experiments.own_table import COLUMNS, OWN, SYSTEMS
from touchline.experiments.result import ExperimentResult, Headline


def own(seeds: int) -> ExperimentResult:
    """Points, drives of robots as built, and the ideal ones beside them."""
    driven, found, play = drive_runs(seeds), point_runs(seeds), play_rows(seeds)
    drives = drive_rows(driven)
    first = drives[0][3:][: len(SYSTEMS)]
    return ExperimentResult(
        "own",
        "Our own system, touchline, beside the others on the same robots and points",
        seeds,
        COLUMNS,
        tuple(drives + play + point_rows(found)),
        Headline("straight tracks, mean error (cm): " + ", ".join(SYSTEMS), "–", "; ".join(first)),
        _NOTES,
        (("drives", own_drives.picture(driven)), ("points", own_points.picture(found))),
    )


_NOTES = (
    f"Robots as built, drawn anew per seed, observation level, {SECONDS:g} s at 10 Hz, errors of tracked frames from "
    f"{FROM_S:g} s on; on images {LIT_SECONDS:g} s at 2.5 Hz under exposure control; camera.yaml from calibrate mirror "
    "where nothing else is said. Brackets: where the mean over robots lies with 95 %, by bootstrap; the last column is "
    f"{OWN} less the best of the others, robot by robot. In the picture a dot for each robot, a stroke for their mean, "
    "broken red lines for what is asked.",
    "The papers' experiments: all whose figures are errors of robots with a mirror, in brackets; less than every "
    "other's where the interval of the difference to each lies below 0. Those on humanoids are in own-humanoids.",
    f"Points: {FRAMES} single observations per seed on the 18 x 12 m field within 6 m, ranges with 2 % + 1 cm of "
    "error, bearings with 0.5°, 5 % clutter where nothing else is said. Bound: Cramér and Rao's, without the clutter; "
    "the greater of position and heading. Found, near: within 20 cm and 5°, from nothing at either end of the field. "
    "A mode is right where the true pose is near, or within 99 % of the normal distribution that it states: a lone "
    "line tells no place along it. Modes of the same place are taken together.",
)
