"""Whole matches with a referee, in which a humanoid is penalised, picked up, falls and changes its half.

python benchmarks/matches.py [--seeds 5]        # forty matches a seed, a minute or more of processor time each
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from touchline.experiments import schulz_runs as humanoids
from touchline.experiments.drives import BoolArray, Drive, estimates_of, track_of
from touchline.experiments.harness import NONE, ExperimentResult, Headline, Row, computed, wilson
from touchline.simulation.robot.match import ACCIDENT, FALL, HALF_TIME, PENALTY, PICKED_UP
from touchline.types import Estimate, Prior

OWN, FIELD = "touchline", "hsl-s-9x6"
HALF_S, EVERY_S = 600.0, 30.0
MATCHES = 40  # a seed: 200 of five
FIRST = 3000  # number of the first match; no constant was chosen on any from there on
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
    counts, too.
    """

    returns: tuple[Return, ...]
    frames: int
    tracked: int
    wrong: int


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
    return Match(tuple(returns), len(estimates), int(track.tracking.sum()), int(track.wrong.sum()))


def _return(kind: str, estimates: Sequence[Estimate], right: BoolArray, period_s: float) -> Return:
    tracked = [estimate.status.value == "tracking" for estimate in estimates]
    if not any(tracked):
        return Return(kind, math.inf, math.inf, False, all(estimate.reason for estimate in estimates))
    first = tracked.index(True)
    seen = sum(estimate.points > 0 for estimate in estimates[: first + 1])
    return Return(kind, first * period_s, seen * period_s, bool(right[first]), False)


def matches(seeds: int) -> ExperimentResult:
    """Forty matches a seed."""
    found = list(computed(played, range(FIRST, FIRST + MATCHES * seeds), "matches"))
    every = [one for each in found for one in each.returns]
    tracked, wrong = sum(one.tracked for one in found), sum(one.wrong for one in found)
    return ExperimentResult(
        f"{len(found)} matches of two halves of {HALF_S / 60.0:g} minutes with a referee",
        COLUMNS,
        [_cells(kind, [one for one in every if one.kind == kind]) for kind in RETURNS] + [_cells("all", every)],
        Headline("right after a return; wrong of tracked images", NONE, f"{_ratio(every)}; {wrong} of {tracked}"),
        _NOTES,
    )


COLUMNS = (
    "back from", "returns", "right when tracked (%, 95 %)", "undecided and named", "tracked after: median (s)",
    "95 % (s)", "of that seeing anything: median (s)", "95 % (s)",
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
    return (kind, f"{len(returns)}", _ratio(returns), f"{named} of {len(undecided)}", *cells)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=1)
    found = matches(parser.parse_args().seeds)
    print(found.title, *(" | ".join(row) for row in (found.columns, *found.rows)), *found.notes, sep="\n")


if __name__ == "__main__":
    main()
