"""own: what our own system reaches, beside the others and what is possible at all.

No figure of a paper. Each part of the table has a module: own_drives.py, own_play.py, own_points.py.
"""

from __future__ import annotations

from touchline.experiments.own_drives import FROM_S, SECONDS, drive_rows
from touchline.experiments.own_play import play_rows
from touchline.experiments.own_points import FRAMES, point_rows
from touchline.experiments.own_table import COLUMNS, OWN, SYSTEMS
from touchline.experiments.result import ExperimentResult, Headline


def own(seeds: int) -> ExperimentResult:
    """Points, drives of robots as built, and the ideal ones beside them."""
    drives, points, play = drive_rows(seeds), point_rows(seeds), play_rows(seeds)
    first = drives[0][3:][: len(SYSTEMS)]
    return ExperimentResult(
        "own",
        "Our own system, touchline, beside the others on the same robots and points",
        seeds,
        COLUMNS,
        tuple(drives + play + points),
        Headline("straight tracks, mean error (cm): " + ", ".join(SYSTEMS), "–", "; ".join(first)),
        _NOTES,
    )


_NOTES = (
    f"Robots as built, drawn anew per seed, observation level, {SECONDS:g} s at 10 Hz, errors of tracked frames from "
    f"{FROM_S:g} s on; camera.yaml from calibrate mirror where nothing else is said. Brackets: where the mean over "
    f"robots lies with 95 %, by bootstrap; the last column is {OWN} less the best of the others, robot by robot.",
    f"Points: {FRAMES} single observations per seed on the 18 x 12 m field within 6 m, ranges with 2 % + 1 cm of "
    "error, bearings with 0.5°, 5 % clutter where nothing else is said. Bound: Cramér and Rao's, without the clutter; "
    "the greater of position and heading. Found: within 20 cm and 5°, from nothing at either end of the field.",
)
