"""Whole matches with a referee, in which a humanoid is penalised, picked up, falls and changes its half.

    python lab/benchmarks/matches.py [--matches 200] [--first 6000] [--journal FILE]

A match takes a minute or more of processor time. With a journal each one is written as it ends, and what the file holds
is not played again.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from touchline.geometry import BoolArray
from touchline.types import Estimate, Prior
from touchline_lab.experiments import schulz_runs as humanoids
from touchline_lab.experiments.drives import Drive, estimates_of, track_of
from touchline_lab.experiments.harness import NONE, Kept, Row, progress_to, resumed, wilson
from touchline_lab.simulation.robot.match import ACCIDENT, FALL, HALF_TIME, PENALTY, PICKED_UP

OWN, FIELD = "touchline", "hsl-s-9x6"
HALF_S, EVERY_S = 600.0, 30.0
FIRST = 6000  # number of the first match; no constant was chosen on any from there on
SOON_S = 2.0  # of vision within which a robot back from a penalty has to be tracked
RETURNS = (PENALTY, PICKED_UP, ACCIDENT, FALL, HALF_TIME)
START = (-2.5, 1.0, 0.0)  # in the own half, which is all that the robot is told


class Return(NamedTuple):
    """A robot comes back. waited_s: until it is tracked; seen_s: of that, time in which images showed anything; both
    inf if never, until something else happens. right: within 0.5 m and 0.5 rad then. named: else, a reason was given.
    """

    kind: str
    waited_s: float
    seen_s: float
    right: bool
    named: bool


class Match(NamedTuple):
    """Its returns; frames: all, tracked, and of these wrong: more than 0.5 m or 0.5 rad off; a pose whose twin is named
    counts, too. wrong_s: from when to when, span by span.
    """

    number: int
    returns: tuple[Return, ...]
    frames: int
    tracked: int
    wrong: int
    wrong_s: tuple[tuple[float, float], ...]

    @classmethod
    def of(cls, row: Sequence[Any]) -> Match:
        """From a journal's row."""
        number, returns, *rest = row
        return cls(number, tuple(Return(*one) for one in returns), *rest)


def match(number: int, half_s: float = HALF_S, every_s: float = EVERY_S) -> Drive:
    """One match; the number is its seed."""
    rng = np.random.default_rng([number, 28])
    places = humanoids.random_areas(FIELD, number, 24)[0].replace("[[", f"[{list(START)}, [", 1)
    missed = [str(bool(rng.random() < 0.3)).lower() for _ in range(2)]
    changes = (
        places,
        f"game.half_s={half_s:g}",
        f"game.every_s={every_s:g}",
        f"game.missed_ready=[{','.join(missed)}]",
    )
    walked = humanoids.walk(FIELD, humanoids.AS_BUILT, number, 2.0 * half_s, changes)
    return replace(walked, prior=Prior(own_half=True))


def played(number: int, half_s: float = HALF_S, every_s: float = EVERY_S) -> Match:
    """What the system makes of one match."""
    drive = match(number, half_s, every_s)
    estimates = estimates_of(OWN, drive, number)
    track = track_of(drive, estimates)
    happened = [event for event in drive.events if event["kind"] in RETURNS]
    ends_s = [*(float(event["t"]) for event in happened[1:]), math.inf]
    period_s = float(np.median(np.diff(track.times_s)))
    returns = []
    for event, end_s in zip(happened, ends_s, strict=True):
        after = np.flatnonzero((track.times_s >= float(event["until_s"])) & (track.times_s < end_s))
        if len(after):
            returns.append(_return(str(event["kind"]), [estimates[k] for k in after], ~track.wrong[after], period_s))
    edges = np.flatnonzero(np.diff(np.concatenate(([0], track.wrong.astype(np.int8), [0])))).reshape(-1, 2)
    spans = tuple((float(track.times_s[a]), float(track.times_s[b - 1])) for a, b in edges)
    return Match(number, tuple(returns), len(estimates), int(track.tracking.sum()), int(track.wrong.sum()), spans)


def _return(kind: str, estimates: Sequence[Estimate], right: BoolArray, period_s: float) -> Return:
    tracked = [estimate.status.value == "tracking" for estimate in estimates]
    if not any(tracked):
        return Return(kind, math.inf, math.inf, False, all(estimate.reason for estimate in estimates))
    first = tracked.index(True)
    seen = sum(estimate.points > 0 for estimate in estimates[: first + 1])
    return Return(kind, first * period_s, seen * period_s, bool(right[first]), False)


COLUMNS = (
    "back from", "returns", "right when tracked (%, 95 %)", "undecided and named", "tracked after: median (s)",
    "95 % (s)", "of that seeing anything: median (s)", "95 % (s)", f"within {SOON_S:g} s (%)",
)  # fmt: skip
_NOTES = (
    f"A humanoid as built walks on {FIELD} at the observation level, looks 2 s at the field and 2 s away by turns, and "
    "has no compass. All that it is told is its own half at the start, and what the GameController says, twice a "
    f"second; three in ten READYs are not received. {EVERY_S:g} s after 12 s of peace, on average, it is penalised and "
    "put back at a touch line, at the height of the own penalty mark, give or take 0.3 m; is penalised "
    "though nobody moves it; is picked up; or falls, is moved by 0.3 m and 40° (standard deviations), and lies for 3 "
    "to 8 s. At half-time it is carried anywhere into its own half.",
    "Right: within 0.5 m and 0.5 rad in the first tracked image after it; undecided: none until something else "
    "happens. Intervals are Wilson's.",
)


def _ratio(returns: Sequence[Return]) -> str:
    decided = [one for one in returns if math.isfinite(one.waited_s)]
    right = sum(one.right for one in decided)
    if not decided:
        return NONE
    low, high = wilson(right, len(decided))
    return f"{100.0 * right / len(decided):.1f} [{100.0 * low:.1f}, {100.0 * high:.1f}]"


def _cells(kind: str, returns: Sequence[Return]) -> Row:
    undecided = [one for one in returns if math.isinf(one.waited_s)]
    times = [[each for each in waits if math.isfinite(each)] for waits in
             ([one.waited_s for one in returns], [one.seen_s for one in returns])]  # fmt: skip
    cells = [f"{np.quantile(each, share):.1f}" if each else NONE for each in times for share in (0.5, 0.95)]
    named = sum(one.named for one in undecided)
    soon = f"{100.0 * np.mean([one.seen_s <= SOON_S for one in returns]):.1f}" if returns else NONE
    return (kind, f"{len(returns)}", _ratio(returns), f"{named} of {len(undecided)}", *cells, soon)


def report(found: Sequence[Match]) -> str:
    """Table, notes, and every match with wrong frames or a return that went wrong."""
    every = [one for each in found for one in each.returns]
    frames, tracked, wrong = (sum(column) for column in zip(*(one[2:5] for one in found), strict=True))
    rows = [COLUMNS, *(_cells(kind, [one for one in every if one.kind == kind]) for kind in RETURNS),
            _cells("all", every)]  # fmt: skip
    low, high = (1e3 * bound for bound in wilson(wrong, tracked))
    lines = [f"{len(found)} matches of two halves of {HALF_S / 60.0:g} minutes with a referee"]
    lines += [" | ".join(row) for row in rows]
    lines.append(
        f"{wrong} of {tracked} tracked images wrong, {1e3 * wrong / tracked:.2f} [{low:.2f}, {high:.2f}] in 1000; "
        f"tracked {100.0 * tracked / frames:.1f} % of {frames}"
    )
    for one in found:
        failed = [each for each in one.returns if not each.right]
        spans = ", ".join(f"{a:.1f}-{b:.1f} s" for a, b in one.wrong_s)
        if one.wrong or failed:
            lines.append(f"match {one.number}: {one.wrong} wrong ({spans}); {failed}")
    return "\n".join((*lines, *_NOTES))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--matches", type=int, default=40)
    parser.add_argument("--first", type=int, default=FIRST)
    parser.add_argument("--journal", type=Path, help="a file of results; it is begun, or gone on with")
    given = parser.parse_args()
    kept = None if given.journal is None else Kept(given.journal)
    with progress_to(lambda line: print(line, file=sys.stderr), kept=kept):
        rows = resumed(played, range(given.first, given.first + given.matches), "matches")
    print(report([Match.of(row) for row in rows]))


if __name__ == "__main__":
    main()
