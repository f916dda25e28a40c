"""faults: the catalogue of faults, one by one and in pairs; who is wrong and sure, and who says which sensor it is?

No figure of a paper. Results are kept in faults.jsonl as they come: a run goes on where one was stopped.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from touchline.evaluation.protection import ALERT_LIMIT_M
from touchline.geometry import BoolArray, FloatArray
from touchline.types import Estimate, ProblemCode
from touchline_lab.experiments import catalogue
from touchline_lab.experiments.drives import Drive, estimates_of, longest, track_of
from touchline_lab.experiments.harness import NONE, ExperimentResult, Headline, Row, resumed, seed_range
from touchline_lab.experiments.scenes import new_figure
from touchline_lab.stanford import draw_stanford

OWN = "touchline"
OTHERS = {
    catalogue.MIRROR: ("nubot-mti", "nubot-mcl", "iris-fusion"),
    catalogue.FEATURES: ("nimbro-lines",),
    catalogue.CLOUD: (),
}
ROBOTS_OF_SEED, FIRST_SEED = 2, 6000  # robots of which no threshold is: those have the seeds from 1000 on
FEWER, OTHERS_AT = 5, 1  # one robot in so many for the other systems, and for each pair; where the others begin
PAIRS = {catalogue.MIRROR: 70, catalogue.FEATURES: 30}
WRONG_M, WRONG_RAD = 0.5, math.radians(15.0)
BEFORE_FRAMES = 30
_ODOMETRY = {code for code in vars(ProblemCode).values() if str(code).startswith("odometry-")}
_STAMPS = {ProblemCode.STAMPS_LATE, ProblemCode.STAMPS_LATE_CORRECTED, ProblemCode.STAMPS_EARLY}
_COMPASS = {ProblemCode.END_BY_COMPASS, ProblemCode.COMPASS_WRONG, ProblemCode.COMPASS_TURNED}
_IMAGES = _STAMPS | {
    ProblemCode.IMAGES_MIRRORED, ProblemCode.IMAGES_TURNED, ProblemCode.IMAGES_SPIN, ProblemCode.IMAGES_REPEAT,
    ProblemCode.CAMERA_DIFFERS, ProblemCode.FIELD_OFF_LINES,
}  # fmt: skip
CODES = {
    "odometry": _ODOMETRY | {ProblemCode.IMAGES_TURNED, ProblemCode.IMAGES_REPEAT},  # against wheels
    "gyro": {ProblemCode.ODOMETRY_AGAINST_GYRO},
    "clock": _STAMPS,
    "image": _IMAGES,
    "field": {ProblemCode.FIELD_OFF_LINES, ProblemCode.FIELD_OFF_CARPET, ProblemCode.CAMERA_DIFFERS},
    "clutter": {ProblemCode.FIELD_OFF_LINES, ProblemCode.FIELD_OFF_CARPET, ProblemCode.IMAGES_REPEAT},
    "compass": _COMPASS,
    "head": _IMAGES | {ProblemCode.ODOMETRY_DRIFT},
    "start": _COMPASS | {ProblemCode.END_BY_COLOURS},
}
"""By family, the codes of the problems that name a culprit of it."""
ALARMS = {
    "alarm asked within 0.5 s": (
        r"odometry \w+ the wrong way|.* all signs wrong|the same image.*|mirrored|a blob.*|images 0.*"
    ),
    "alarm asked within 1.5 s": r".*field told|a neighbour.*|ranges.*|uniform.*|bars.*|20–40.*|a ring.*|a false.*",
    "alarm asked within 3 s": r"camera's clock \d+ ms.*|turned by (2|5|20)°",
}
"""Groups of faults by how soon they are to be noticed, as regular expressions of their names."""


class Score(NamedTuple):
    """Of some frames those that were wrong: tracked, more than 0.5 m or 15° off, and not at the other end; other_end:
    there, and the true pose not named. bounded, misleading: with a protection level, and beyond it, at the nearer end,
    from the second frame on. bounds: (K, 2) error and protection level (m).
    """

    frames: int
    wrong: int
    other_end: int
    bounded: int
    misleading: int
    bounds: FloatArray

    def tree(self) -> dict[str, Any]:
        """As JSON knows it."""
        return {**self._asdict(), "bounds": self.bounds.round(4).tolist()}

    @classmethod
    def of_tree(cls, tree: Mapping[str, Any]) -> Score:
        """A score from its tree."""
        return cls(**{**tree, "bounds": np.array(tree["bounds"]).reshape(-1, 2)})


class Frames(NamedTuple):
    """Estimates beside the truth, frame by frame (N,): what `Score` counts, and `bounds` (N, 2)."""

    tracking: BoolArray
    wrong: BoolArray
    other_end: BoolArray
    bounded: BoolArray
    misleading: BoolArray
    bounds: FloatArray

    def score(self, first: int = 0) -> Score:
        """From a frame on."""
        later = slice(first + 1, None)
        wrong, other_end = (int(each[first:].sum()) for each in (self.wrong, self.other_end))
        bounded, misleading = (int(each[later].sum()) for each in (self.bounded, self.misleading))
        return Score(len(self.wrong) - first, wrong, other_end, bounded, misleading, self.bounds[self.bounded])


def frames_of(drive: Drive, estimates: Sequence[Estimate]) -> Frames:
    """What a system's estimates of a drive are worth."""
    track = track_of(drive, estimates)
    levels = np.array([(each.protection_m, each.protection_rad) for each in estimates], dtype=np.float64)
    error_m, beyond = np.full(len(estimates), np.inf), np.ones(len(estimates), np.bool_)
    for end in (track, track.turned):
        error_m = np.minimum(error_m, end.distances_m)
        beyond &= (end.distances_m > levels[:, 0]) | (end.turns_rad > levels[:, 1])
    off, there = track.tracking & ~track.within(WRONG_M, WRONG_RAD), track.turned.within(WRONG_M, WRONG_RAD)
    bounded = np.isfinite(levels[:, 0]) & track.tracking
    return Frames(
        track.tracking, off & ~there, off & there & ~track.twin_named, bounded, bounded & beyond,
        np.column_stack((error_m, levels[:, 0])),
    )  # fmt: skip


class Outcome(NamedTuple):
    """What a system made of one drive with a fault. score: from the fault's start on. other_end_s: for how long it was
    at the other end at most. alarm_s: until first not tracked, not bounded, or a problem said. rightly: whether the
    culprit is named that is most often named; None: none is. tracked: shares before, during and after.
    """

    moves: bool
    score: Score
    other_end_s: float
    alarm_s: float | None
    rightly: bool | None
    tracked: tuple[float, float, float]

    def tree(self) -> dict[str, Any]:
        """As JSON knows it."""
        return {**self._asdict(), "score": self.score.tree()}

    @classmethod
    def of_tree(cls, tree: Mapping[str, Any]) -> Outcome:
        """An outcome from its tree."""
        return cls(**{**tree, "score": Score.of_tree(tree["score"]), "tracked": tuple(tree["tracked"])})


def outcome(case: catalogue.Case, of: catalogue.Laid, estimates: Sequence[Estimate], moves: bool) -> Outcome:
    """What a system's estimates of a drive are worth."""
    found, count = frames_of(of.faulty, estimates), len(estimates)
    times_s = of.clean.times_s if count == len(of.clean.frames) else of.faulty.times_s
    first = min(int(np.searchsorted(of.clean.times_s, of.start_s)), count - 1)
    last = min(max(int(np.count_nonzero(times_s < of.end_s)), first + 1), count)
    alarms = [[one.code for one in each.problems if one.code != ProblemCode.END_UNDECIDED] for each in estimates]
    unbounded = ~found.bounded & found.bounded.any()
    alarm = (~found.tracking | unbounded | np.array([bool(codes) for codes in alarms]))[first:]
    edges = (max(first - BEFORE_FRAMES, 0), first, last, count)
    spans = [found.tracking[begin:end] for begin, end in pairwise(edges)]
    before, during, after = (float(span.mean()) if len(span) else math.nan for span in spans)
    return Outcome(
        moves,
        found.score(first),
        float(longest(found.other_end[first:]) * np.median(np.diff(times_s))),
        float(times_s[first + int(np.argmax(alarm))] - times_s[first]) if alarm.any() else None,
        rightly_named(case, [code for codes in alarms[first:] for code in codes]),
        (before, during, after),
    )


def rightly_named(case: catalogue.Case, codes: Sequence[str]) -> bool | None:
    """Whether that is at fault which is named most often; None where nothing is named. codes: of all problems."""
    named = Counter(code for code in codes if any(code in each for each in CODES.values()))
    if not named:
        return None
    most, _ = named.most_common(1)[0]
    return any(most in CODES.get(kind.family, ()) for kind in case)


Found = Mapping[tuple[str, str], Sequence[Outcome]]  # by case and system


def title(case: catalogue.Case) -> str:
    """Of a case: its fault, or for a pair that it is one."""
    return case[0].title if len(case) == 1 else f"{case[0].robots}: pairs"


def cases(robots: str) -> list[catalogue.Case]:
    """All single faults of a kind of robots, and its pairs."""
    return [
        *((kind,) for kind in catalogue.CATALOGUE if kind.robots == robots),
        *catalogue.pairs(PAIRS.get(robots, 0), robots),
    ]


def _of_case(task: tuple[str, str, int, int]) -> list[tuple[str, str, dict[str, Any]]]:
    """A case on one robot: title, system and outcome of each system that it has."""
    name, robots, index, number = task
    case, seed, moves = (
        cases(robots)[index],
        FIRST_SEED + number,
        catalogue.KINDS_OF_ROBOTS[robots][number % catalogue.ROBOTS].moves,
    )
    others = OTHERS[robots] if number % FEWER == OTHERS_AT and len(case) == 1 else ()
    of = catalogue.laid(case, number, seed)
    found = [(system, estimates_of(system, of.faulty, seed)) for system in (OWN, *others)]
    return [(name, system, outcome(case, of, estimates, moves).tree()) for system, estimates in found]


def tasks(seeds: int) -> list[tuple[str, str, int, int]]:
    """Every case on so many robots of its kind, robot by robot; of the pairs each on one in `FEWER`."""
    found = []
    for number in seed_range(seeds, ROBOTS_OF_SEED):
        for robots in catalogue.KINDS_OF_ROBOTS:
            for index, case in enumerate(cases(robots)):
                if len(case) == 1 or (index + number) % FEWER == 0:
                    found.append((title(case), robots, index, number))
    return found


def faults(seeds: int) -> ExperimentResult:
    """Every fault of the catalogue and pairs of them, on every kind of robots."""
    found: dict[tuple[str, str], list[Outcome]] = {}
    for results in resumed(_of_case, tasks(seeds), "faults"):
        for name, system, tree in results:
            found.setdefault((name, system), []).append(Outcome.of_tree(tree))
    own = [one for (name, system), outcomes in found.items() if system == OWN for one in outcomes]
    names = list(dict.fromkeys(name for name, _ in found))
    sums = {f"all of {robots}": rf"{robots}: .*" for robots in catalogue.KINDS_OF_ROBOTS}
    sums |= {title: rf"[^:]*: ({names})" for title, names in ALARMS.items()} | {"all": ".*"}
    grouped = {title: [name for name in names if re.fullmatch(which, name)] for title, which in sums.items()}
    return ExperimentResult(
        "The catalogue of faults: wrong while tracking, beyond the protection level, noticed, named",
        COLUMNS,
        [*(_row(name, [name], found) for name in names),
         *(_row(title, each, found) for title, each in grouped.items() if each)],
        Headline("touchline, moving robots: wrong while tracking; beyond the protection level", NONE,
                 f"{_wrong(own)} %; {misleading([one.score for one in own])} ‰"),
        (*_NOTES, _covered(found)),
        (("bounds", _picture(found)),),
    )  # fmt: skip


SYSTEMS = tuple(dict.fromkeys(system for systems in OTHERS.values() for system in systems))
COLUMNS = (
    "robots: fault", "wrong, tracking (%)", "most of a robot (%)", "standing: wrong (%)",
    "at the other end (%), longest (s)", "beyond the protection level (‰)", "protection level (cm)",
    "alarm (s): median, longest, never", "named rightly", "tracked before, during, after (%)",
    *(f"{system}: wrong (%)" for system in SYSTEMS),
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
    "Where the camera's clock is wrong the true pose is that at the stamp, by the clock of the odometry. No threshold "
    "was found on these robots.",
)


def _covered(found: Found) -> str:
    """What the table covers."""
    parts = []
    for system in (OWN, *SYSTEMS):
        counts = [len(each) for (name, by), each in found.items() if by == system and not name.endswith(": pairs")]
        if counts:
            robots = f"{min(counts)}" if min(counts) == max(counts) else f"{min(counts)} to {max(counts)}"
            parts.append(f"{system}: {len(counts)} faults, robots of each: {robots}")
    counted = sum(len(each) for (name, _), each in found.items() if name.endswith(": pairs"))
    return f"Covered: {'; '.join(parts)}; pairs of faults: {counted}."


def _wrong(outcomes: Sequence[Outcome]) -> str:
    """Share of the frames that are wrong, moving robots."""
    return _share([(one.score.wrong, one.score.frames) for one in outcomes if one.moves], 100.0)


def misleading(scores: Sequence[Score]) -> str:
    """Share of the bounded frames that are (‰)."""
    return _share([(one.misleading, one.bounded) for one in scores], 1000.0)


def _share(counts: Sequence[tuple[int, int]], of: float) -> str:
    marked, frames = sum(count[0] for count in counts), sum(count[1] for count in counts)
    return f"{of * marked / frames:.2f}" if frames else NONE


def _row(name: str, names: Sequence[str], found: Found) -> Row:
    """Of one fault, or of several together."""
    outcomes = [one for each in names for one in found.get((each, OWN), ())]
    moving = [one for one in outcomes if one.moves]
    still = [one.score for one in outcomes if not one.moves]
    alarms = [one.alarm_s for one in moving if one.alarm_s is not None]
    named = [one.rightly for one in outcomes if one.rightly is not None]
    levels_m = np.concatenate([one.score.bounds[:, 1] for one in outcomes])
    there = _share([(one.score.other_end, one.score.frames) for one in moving], 100.0)
    others = [[one for each in names for one in found.get((each, system), ())] for system in SYSTEMS]
    return (
        name,
        _wrong(outcomes),
        f"{max((100.0 * one.score.wrong / one.score.frames for one in moving), default=math.nan):.1f}",
        _share([(one.wrong + one.other_end, one.frames) for one in still], 100.0),
        f"{there}, {max((one.other_end_s for one in moving), default=0.0):.1f}",
        misleading([one.score for one in outcomes]),
        f"{100.0 * np.median(levels_m):.1f}" if len(levels_m) else NONE,
        f"{np.median(alarms):.1f}, {max(alarms):.1f}, {len(moving) - len(alarms)} of {len(moving)}" if alarms else NONE,
        f"{sum(named)} of {len(named)}" if named else NONE,
        ", ".join(_percent(column) for column in np.array([one.tracked for one in outcomes], dtype=np.float64).T),
        *(_wrong(each) for each in others),
    )


def _percent(shares: FloatArray) -> str:
    known = shares[np.isfinite(shares)]
    return f"{100.0 * known.mean():.0f}" if len(known) else NONE


def _picture(found: Found) -> Figure:
    """Stanford diagrams of both cameras, under all faults."""
    return bounds_figure({
        camera: [one.score.bounds for (name, system), each in found.items() for one in each
                 if system == OWN and name.startswith(camera) and not name.endswith(": none")]
        for camera in (catalogue.MIRROR, catalogue.FEATURES)
    })  # fmt: skip


def bounds_figure(bounds: Mapping[str, Sequence[FloatArray]]) -> Figure:
    """Stanford diagrams, by kinds of robots: errors and protection levels (K, 2) in m, of each robot."""
    figure, axes = new_figure(1, 2, (11.0, 5.0), tuple(f"{robots}, all faults" for robots in bounds))
    for axis, each in zip(axes, bounds.values(), strict=True):
        error_m, level_m = np.concatenate([np.zeros((0, 2)), *each]).T
        if len(error_m):
            draw_stanford(axis, error_m, level_m, ALERT_LIMIT_M)
    return figure
