"""faults: the catalogue of faults, one by one and in pairs; who is wrong and sure, and who says which sensor it is?

No figure of a paper.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from touchline.evaluation.protection import ALERT_LIMIT_M, draw_stanford
from touchline.experiments.catalogue import (
    CATALOGUE,
    CLOUD,
    FEATURES,
    KINDS_OF_ROBOTS,
    MIRROR,
    ROBOTS,
    Case,
    Laid,
    laid,
    pairs,
)
from touchline.experiments.drives import BoolArray, Track, estimates_of, track_of
from touchline.experiments.harness import NONE, ExperimentResult, Headline, Row, gathered
from touchline.experiments.scenes import new_figure
from touchline.geometry import FloatArray
from touchline.types import Estimate

OWN = "touchline"
OTHERS = {MIRROR: ("nubot-mti", "nubot-mcl", "iris-fusion"), FEATURES: ("nimbro-lines",), CLOUD: ()}
ROBOTS_OF_SEED, FIRST_SEED = 2, 2000  # robots of which no threshold is: those have the seeds from 1000 on
FEWER, OTHERS_AT = 5, 1  # one robot in so many for the other systems, and for each pair; where the others begin
PAIRS = {MIRROR: 70, FEATURES: 30}
WRONG_M, WRONG_RAD = 0.5, math.radians(15.0)
BEFORE_FRAMES = 30
NAMES = {
    "odometry": r"^odometry|wheel",
    "gyro": r"gyro",
    "clock": r"stamp|clock",
    "image": r"^images? (?!contradict)|camera|what is seen",
    "field": r"what is seen|camera\.yaml|carpet",
    "clutter": r"what is seen|carpet|has not changed",
    "compass": r"compass",
    "head": r"^images? (?!contradict)|camera|head",
    "start": r"compass|colour",
}
"""What a problem says that names a culprit of a family, as a regular expression."""
NO_ALARM = "undecided"  # how a problem begins that is none of a sensor


class Outcome(NamedTuple):
    """What a system made of one drive with a fault. frames: from the fault's start on; of these those that were wrong.

    wrong: tracked, more than 0.5 m or 15° off, and not at the other end; other_end: there, and the true pose not named.
    bounded, misleading: with a protection level, and beyond it, at the nearer end, from the second image on. alarm_s:
    until first not tracked, not bounded, or a problem said. rightly: whether the culprit is named that is most often
    named; None: none is. tracked: shares before, during and after. bounds: (K, 2) error and protection level (m).
    """

    moves: bool
    frames: int
    wrong: int
    other_end: int
    bounded: int
    misleading: int
    alarm_s: float | None
    rightly: bool | None
    tracked: tuple[float, float, float]
    bounds: FloatArray


def outcome(case: Case, of: Laid, estimates: Sequence[Estimate], moves: bool) -> Outcome:
    """What a system's estimates of a drive are worth."""
    track, count = track_of(of.faulty, estimates), len(estimates)
    times_s = of.clean.times_s if count == len(of.clean.frames) else of.faulty.times_s
    first = min(int(np.searchsorted(of.clean.times_s, of.start_s)), count - 1)
    last = min(max(int(np.count_nonzero(times_s < of.end_s)), first + 1), count)
    given, beyond, bounds = against_bounds(track, estimates)
    off, there = ~track.within(WRONG_M, WRONG_RAD), track.turned.within(WRONG_M, WRONG_RAD)
    told = [[text for text in each.problems if not text.startswith(NO_ALARM)] for each in estimates]
    alarm = ~track.tracking | np.array([bool(texts) for texts in told]) | (~given & given.any())
    since, counted = np.arange(count) >= first, np.arange(count) > first
    return Outcome(
        moves,
        count - first,
        int(np.count_nonzero(since & track.tracking & off & ~there)),
        int(np.count_nonzero(since & track.tracking & off & there & ~track.twin_named)),
        int(np.count_nonzero(counted & given)),
        int(np.count_nonzero(counted & given & beyond)),
        float(times_s[first + int(np.argmax(alarm[first:]))] - times_s[first]) if alarm[first:].any() else None,
        rightly_named(case, [text for texts in told[first:] for text in texts]),
        _shares(track.tracking, (max(first - BEFORE_FRAMES, 0), first, last, count)),
        bounds[given],
    )


def against_bounds(track: Track, estimates: Sequence[Estimate]) -> tuple[BoolArray, BoolArray, FloatArray]:
    """Which estimates (N,) are tracked with a protection level; which err by more; error and level (N, 2) in m.

    The error is that at the nearer end of the field.
    """
    levels = np.array([(each.protection_m, each.protection_rad) for each in estimates], dtype=np.float64)
    error_m, beyond = np.full(len(estimates), np.inf), np.ones(len(estimates), np.bool_)
    for end in (track, track.turned):
        error_m = np.minimum(error_m, end.distances_m)
        beyond &= (end.distances_m > levels[:, 0]) | (end.turns_rad > levels[:, 1])
    return np.isfinite(levels[:, 0]) & track.tracking, beyond, np.column_stack((error_m, levels[:, 0]))


def _shares(tracking: np.ndarray, edges: Sequence[int]) -> tuple[float, float, float]:
    """Before, during and after; NaN where there is no such time."""
    spans = [tracking[begin:end] for begin, end in pairwise(edges)]
    before, during, after = (float(span.mean()) if len(span) else math.nan for span in spans)
    return before, during, after


def rightly_named(case: Case, texts: Sequence[str]) -> bool | None:
    """Whether that is at fault which is named most often; None where nothing is named."""
    named = Counter(text for text in texts if re.search("|".join(NAMES.values()), text))
    if not named:
        return None
    right = "|".join(NAMES[kind.family] for kind in case if kind.family in NAMES)
    return bool(right) and re.search(right, named.most_common(1)[0][0]) is not None


Found = Mapping[tuple[str, str], Sequence[Outcome]]  # by case and system


def title(case: Case) -> str:
    """Of a case: its fault, or for a pair that it is one."""
    return case[0].title if len(case) == 1 else f"{case[0].robots}: pairs"


def _of_robot(task: tuple[str, int]) -> dict[tuple[str, str, int], Outcome]:
    """All cases on one robot, by the systems that it has."""
    robots, number = task
    seed, moves = FIRST_SEED + number, KINDS_OF_ROBOTS[robots][number % ROBOTS].moves
    singles: list[Case] = [(kind,) for kind in CATALOGUE if kind.robots == robots]
    found = {}
    drawn = [case for k, case in enumerate(pairs(PAIRS.get(robots, 0), robots)) if (k + number) % FEWER == 0]
    for index, case in enumerate((*singles, *drawn)):
        of = laid(case, number, seed)
        for system in (OWN, *(OTHERS[robots] if number % FEWER == OTHERS_AT and len(case) == 1 else ())):
            found[title(case), system, index] = outcome(case, of, estimates_of(system, of.faulty, seed), moves)
    return found


def faults(seeds: int) -> ExperimentResult:
    """Every fault of the catalogue and pairs of them, on every kind of robots."""
    each = gathered(_of_robot, list(product(KINDS_OF_ROBOTS, range(ROBOTS_OF_SEED * seeds))), "robots")
    found: dict[tuple[str, str], list[Outcome]] = {}
    for (name, system, _), outcomes in each.items():
        found.setdefault((name, system), []).extend(outcomes)
    own = [one for (name, system), outcomes in found.items() if system == OWN for one in outcomes]
    names = list(dict.fromkeys(name for name, _ in found))
    return ExperimentResult(
        "The catalogue of faults: wrong while tracking, beyond the protection level, noticed, named",
        COLUMNS,
        [*(_row(name, [name], found) for name in names),
         *(_row(f"all of {robots}", [name for name in names if name.startswith(f"{robots}:")], found)
           for robots in KINDS_OF_ROBOTS),
         _row("all", names, found)],
        Headline("touchline, moving robots: wrong while tracking; beyond the protection level", NONE,
                 f"{_wrong(own)} %; {_misleading(own)} ‰"),
        _NOTES,
        (("bounds", _picture(found)),),
    )  # fmt: skip


SYSTEMS = tuple(dict.fromkeys(system for systems in OTHERS.values() for system in systems))
COLUMNS = (
    "robots: fault", "wrong, tracking (%)", "most of a robot (%)", "standing: wrong (%)", "at the other end (%)",
    "beyond the protection level (‰)", "protection level (cm)", "alarm (s): median, longest, never", "named rightly",
    "tracked before, during, after (%)", *(f"{system}: wrong (%)" for system in SYSTEMS),
)  # fmt: skip
_NOTES = (
    "Robots as built at the observation level, drives of 30 s or 10 s longer than a fault of a stated length: with a "
    "mirror on tracks, in matches, half hidden, slow, fast, standing; humanoids by features and by clouds of points, "
    "fast, slow and walking in place. Faults begin after 4 to 8 s, and last between 0.3 and 60 s, even by the "
    "logarithm, to the end, or as long as they say; such as last to the end are there from the first image on in every "
    "other robot.",
    "Wrong: tracked, and more than 0.5 m or 15° off, of the frames from the fault's start on, moving robots; at the "
    "other end of the field only where the true pose is not named. Beyond the protection level: of images with one, "
    "all robots, from the second on, given the end. Alarm: until the pose is not tracked, has no bound or a problem is "
    "said. Named rightly: of the robots of which a culprit is named, those where the one named most is the one.",
    f"{OWN} on {ROBOTS_OF_SEED} robots a seed and kind, the others on one in {FEWER} of them and without pairs; each "
    f"pair on one in {FEWER}. No threshold was found on these robots.",
    "Where the camera's clock is wrong the true pose is that at the stamp, by the clock of the odometry.",
)


def _wrong(outcomes: Sequence[Outcome]) -> str:
    """Share of the frames that are wrong, moving robots."""
    return _share([(one.wrong, one.frames) for one in outcomes if one.moves], 100.0)


def _misleading(outcomes: Sequence[Outcome]) -> str:
    return _share([(one.misleading, one.bounded) for one in outcomes], 1000.0)


def _share(counts: Sequence[tuple[int, int]], of: float) -> str:
    marked, frames = sum(count[0] for count in counts), sum(count[1] for count in counts)
    return f"{of * marked / frames:.2f}" if frames else NONE


def _row(name: str, names: Sequence[str], found: Found) -> Row:
    """Of one fault, or of several together."""
    outcomes = [one for each in names for one in found[each, OWN]]
    moving, still = [one for one in outcomes if one.moves], [one for one in outcomes if not one.moves]
    alarms = [one.alarm_s for one in moving if one.alarm_s is not None]
    named = [one.rightly for one in outcomes if one.rightly is not None]
    bounds = np.concatenate([one.bounds for one in outcomes])
    tracked = np.array([one.tracked for one in outcomes])
    others = [[one for each in names for one in found.get((each, system), ())] for system in SYSTEMS]
    return (
        name,
        _wrong(outcomes),
        f"{max((100.0 * one.wrong / one.frames for one in moving), default=math.nan):.1f}",
        _share([(one.wrong + one.other_end, one.frames) for one in still], 100.0),
        _share([(one.other_end, one.frames) for one in moving], 100.0),
        _misleading(outcomes),
        f"{100.0 * np.median(bounds[:, 1]):.1f}" if len(bounds) else NONE,
        f"{np.median(alarms):.1f}, {max(alarms):.1f}, {len(moving) - len(alarms)} of {len(moving)}" if alarms else NONE,
        f"{sum(named)} of {len(named)}" if named else NONE,
        ", ".join(_percent(column) for column in tracked.T),
        *(_wrong(each) for each in others),
    )


def _percent(shares: FloatArray) -> str:
    known = shares[np.isfinite(shares)]
    return f"{100.0 * known.mean():.0f}" if len(known) else NONE


def _picture(found: Found) -> Figure:
    """Stanford diagrams of both cameras, under all faults."""
    return bounds_figure({
        camera: [one.bounds for (name, system), each in found.items() for one in each
                 if system == OWN and name.startswith(camera) and not name.endswith(": none")]
        for camera in (MIRROR, FEATURES)
    })  # fmt: skip


def bounds_figure(bounds: Mapping[str, Sequence[FloatArray]]) -> Figure:
    """Stanford diagrams, by kinds of robots: errors and protection levels (K, 2) in m, of each robot."""
    figure, axes = new_figure(1, 2, (11.0, 5.0), tuple(f"{robots}, all faults" for robots in bounds))
    for axis, each in zip(axes, bounds.values(), strict=True):
        error_m, level_m = np.concatenate([np.zeros((0, 2)), *each]).T
        if len(error_m):
            draw_stanford(axis, error_m, level_m, ALERT_LIMIT_M)
    return figure
