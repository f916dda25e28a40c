"""reliability: faults of what is seen, of wheels and of the compass, and kidnaps; who calls a wrong pose tracking?

No figure of a paper. The runs and what counts are in reliability_runs.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from touchline.experiments.faults import (
    Drive,
    Fault,
    blob,
    false_line,
    far_points,
    one_line,
    ring,
    spliced,
    stuck_compass,
    turned_compass,
    uniform_points,
)
from touchline.experiments.progress import computed
from touchline.experiments.reliability_runs import (
    FOOLED_FRAMES,
    KIDNAP_EVERY_S,
    KIDNAP_M,
    RIGHT_M,
    TWIN_M,
    WITHIN_FRAMES,
    WRONG_M,
    Kidnapped,
    LaidIn,
    Outcome,
    counts,
    driven,
    followed,
    kidnaps_of,
    longest,
)
from touchline.experiments.result import ExperimentResult, Headline, rate
from touchline.experiments.scenes import BLUE, RED, new_figure
from touchline.experiments.wheel_faults import Slip, no_wheels, some_wheels
from touchline.geometry import Pose

SYSTEMS = ("nubot-mti", "nubot-mcl", "iris-fusion")  # nubot-mcl-alone is a comparison of the paper's, without doubt
SECONDS, BEGIN_S, AFTER_S = 34.0, 5.0, 3.0  # a drive; until a fault begins; what is looked at after it
COMPASS_RUNS, COMPASS_SECONDS, COMPASS_S = 2, 16.0, 3.0
ELSEWHERE = (1_000_000, 1_000_001, 1_000_002)  # drives that a robot is carried into, the first that is far enough
AMID_EVERY = 2  # of the runs with a compass's fault as many have a kidnap, too
KIDNAP_RUNS, KIDNAP_SECONDS = 1, 63.0

FAULTS: tuple[LaidIn, ...] = (
    Fault("uniform points from the start", 0.0, SECONDS, uniform_points),
    Fault("all points at 10⁶ m from the start", 0.0, SECONDS, far_points),
    Fault("a blob 20 m away from the start", 0.0, SECONDS, blob),
    Fault("a ring at 1 m from the start", 0.0, SECONDS, ring),
    Fault("a ring at 1 m later", BEGIN_S, SECONDS, ring),
    Fault("one true line for 10 s", BEGIN_S, BEGIN_S + 10.0, one_line(BEGIN_S)),
    Fault("a false line for 5 s", BEGIN_S, BEGIN_S + 5.0, false_line),
    Fault("odometry and wheels gone for 5 s", BEGIN_S, BEGIN_S + 5.0, no_wheels),
    Fault("30 % of odometry and wheels dropped", 0.0, 12.0, some_wheels(0.3)),
    Slip("wheels spinning for 2 s", BEGIN_S, BEGIN_S + 2.0, spin_m_s=2.0),
    Slip("wheels stuck for 10 s", BEGIN_S, BEGIN_S + 10.0, factor=0.0),
    Slip("wheels × 1.15", 0.0, 12.0, factor=1.15),
    Fault("compass + 180° from the start", 0.0, SECONDS, turned_compass),
)
COMPASS: tuple[LaidIn, ...] = (
    Fault("compass + 180° for 10 s, in play", COMPASS_S, COMPASS_S + 10.0, turned_compass),
    Fault("compass stuck for 10 s, in play", COMPASS_S, COMPASS_S + 10.0, stuck_compass(COMPASS_S)),
)


SHOWN = ("a false line for 5 s", "one true line for 10 s", "compass + 180° for 10 s, in play")


class KidnapAmid(NamedTuple):
    """A compass that shows the opposite for 8 s, and a robot that is carried away at start_s."""

    name: str
    start_s: float
    end_s: float

    def laid_into(self, drive: Drive, rng: np.random.Generator) -> Drive:
        """The drive, going on as another one from start_s, with the compass's fault in it."""
        cut = int(np.searchsorted(drive.times_s, self.start_s))
        others = (driven("match", seed, COMPASS_SECONDS)[0] for seed in ELSEWHERE)
        other = next(o for o in others if counts(Pose(*drive.truth[cut - 1]), Pose(*o.truth[cut])))
        compass = Fault("", COMPASS_S, COMPASS_S + 8.0, turned_compass)
        return compass.laid_into(spliced(drive, other, self.start_s), rng)


AMID: tuple[LaidIn, ...] = (
    KidnapAmid("a kidnap while the compass is + 180°", COMPASS_S + 4.0, COMPASS_S + 4.0),
    KidnapAmid("a kidnap after the compass was + 180°", COMPASS_S + 10.5, COMPASS_S + 10.5),
)


class Results(NamedTuple):
    """Of each fault (by name) and system its runs, and of each system its kidnaps in play."""

    runs: dict[tuple[str, str], list[Outcome]]
    kidnaps: dict[str, list[Kidnapped]]


def measure(seeds: int) -> Results:
    """All runs of so many seeds."""
    in_play = [
        ("match", COMPASS_RUNS * seed + k, COMPASS_SECONDS) for seed in range(seeds) for k in range(COMPASS_RUNS)
    ]
    tasks: list[_Task] = [("faults", ("straight-tracks", seed, SECONDS)) for seed in range(seeds)]
    tasks += [("compass" if drive[1] % AMID_EVERY else "amid", drive) for drive in in_play]
    tasks += [("kidnaps", ("match", seed, KIDNAP_SECONDS)) for seed in range(KIDNAP_RUNS * seeds)]
    results = Results({}, {system: [] for system in SYSTEMS})
    for found in computed(_measured, tasks, "drives"):
        for key, runs in found.runs.items():
            results.runs.setdefault(key, []).extend(runs)
        for system in SYSTEMS:
            results.kidnaps[system] += found.kidnaps[system]
    return results


_Task = tuple[str, tuple[str, int, float]]  # which faults, or kidnaps; the drive


def _measured(task: _Task) -> Results:
    """One drive."""
    kind, drive = task
    found = Results({}, {system: [] for system in SYSTEMS})
    if kind == "kidnaps":
        _add_kidnaps(found.kidnaps, drive)
    else:
        faults = {"faults": FAULTS, "compass": COMPASS, "amid": (*COMPASS, *AMID)}[kind]
        _add_faults(found.runs, drive, faults)
    return found


def _add_faults(
    runs: dict[tuple[str, str], list[Outcome]],
    which: tuple[str, int, float],
    faults: Sequence[LaidIn],
) -> None:
    drive, setup, _ = driven(*which)
    for fault in faults:
        faulty = fault.laid_into(drive, np.random.default_rng([which[1], 14])).until(fault.end_s + AFTER_S)
        for system in SYSTEMS:
            runs.setdefault((fault.name, system), []).append(followed(system, setup, faulty, which[1]))


def _add_kidnaps(kidnaps: dict[str, list[Kidnapped]], which: tuple[str, int, float]) -> None:
    often = (f"disturbances.kidnap_every_s={KIDNAP_EVERY_S:g}", "disturbances.covered_images=0")
    drive, setup, times_s = driven(*which, *often)
    for system in SYSTEMS:
        kidnaps[system] += kidnaps_of(drive, times_s, followed(system, setup, drive, which[1]))


def reliability(seeds: int) -> ExperimentResult:
    """Every fault for every system, and kidnaps in play."""
    return told_of(measure(seeds), seeds)


def told_of(results: Results, seeds: int) -> ExperimentResult:
    """The table, headline and picture of what so many seeds have come to."""
    named = {fault.name: fault for fault in (*FAULTS, *COMPASS, *AMID)}
    runs = sorted(results.runs.items(), key=lambda item: list(named).index(item[0][0]))
    rows = [_row(named[fault], system, outcomes) for (fault, system), outcomes in runs]
    rows += [_kidnap_row(system, kidnaps) for system, kidnaps in results.kidnaps.items()]
    fooled = [outcome for _, outcomes in runs for outcome in outcomes]
    carried = [kidnap for kidnaps in results.kidnaps.values() for kidnap in kidnaps]
    return ExperimentResult(
        "reliability",
        f"Faults of what is seen, of wheels and of the compass, and kidnaps in play; wrong is more than {WRONG_M:g} m "
        "or 0.5 rad off",
        seeds,
        _COLUMNS,
        tuple(rows),
        Headline(
            "runs fooled; kidnaps in play right within 10 frames; fooled",
            "–",
            f"{_fooled(fooled)} of {len(fooled)}; {rate(sum(k.right for k in carried), len(carried))}; "
            f"{sum(k.wrong > FOOLED_FRAMES for k in carried)} of {len(carried)}",
        ),
        _NOTES,
        (("faults", _figure([results.runs[name, SYSTEMS[0]][0] for name in SHOWN], SHOWN)),),
    )


_COLUMNS = (
    "fault", "system", "runs", "fooled", "frames wrong, called tracking, unnamed: most of a run", "all of them (%)",
    "tracking (%)", "frames until right again: median, longest",
)  # fmt: skip
_NOTES = (
    f"Fooled: more than {FOOLED_FRAMES} frames in a row wrong, called tracking, and the true pose not named as the "
    "twin at the other end of the field. Rates have Wilson's interval of 95 %.",
    f"Robots as built, observation level, 10 frames per second: {SECONDS:g} s of straight-tracks; in play: "
    f"{COMPASS_RUNS} runs of match per seed, with shoves and eight robots. Faults of odometry are those of the "
    "measuring wheels as well.",
    f"Kidnaps in play: every {KIDNAP_EVERY_S:g} s in full view, {KIDNAP_M:g} m or 30° away or more and not within "
    f"{TWIN_M:g} m of the twin. Right: tracked within {100 * RIGHT_M:.0f} cm and 10° in one of the "
    f"{WITHIN_FRAMES} frames from the first at the new place; in the row's other columns are frames in a row wrong "
    "while tracking, and of the kidnaps that were not right how many were searching then.",
    "A compass that is half a turn off from the first frame can't be told from a right one: both ends are named.",
)


def _fooled(outcomes: Sequence[Outcome]) -> int:
    return sum(longest(outcome.unnamed) > FOOLED_FRAMES for outcome in outcomes)


def _row(fault: LaidIn, system: str, outcomes: Sequence[Outcome]) -> tuple[str, ...]:
    unnamed = [int(np.count_nonzero(outcome.unnamed)) for outcome in outcomes]
    return (
        fault.name,
        system,
        str(len(outcomes)),
        rate(_fooled(outcomes), len(outcomes)),
        str(max(unnamed)),
        f"{100.0 * sum(unnamed) / sum(len(outcome.times_s) for outcome in outcomes):.2f}",
        f"{100.0 * np.mean([outcome.tracking.mean() for outcome in outcomes]):.0f}",
        _back(outcomes, fault.end_s) if fault.end_s < SECONDS else "–",
    )


def _back(outcomes: Sequence[Outcome], time_s: float) -> str:
    """Frames until right again from a time on: median, longest."""
    back = [outcome.frames_until_right(time_s) for outcome in outcomes]
    known = [frames for frames in back if frames is not None]
    if not known:
        return "never"
    return f"{np.median(known):g}, {max(known)}" + (f"; {len(back) - len(known)} never" if None in back else "")


def _kidnap_row(system: str, kidnaps: Sequence[Kidnapped]) -> tuple[str, ...]:
    missed = [kidnap for kidnap in kidnaps if not kidnap.right]
    return (
        "kidnaps in play",
        system,
        str(len(kidnaps)),
        rate(sum(kidnap.wrong > FOOLED_FRAMES for kidnap in kidnaps), len(kidnaps)),
        str(max(kidnap.wrong for kidnap in kidnaps)),
        "–",
        f"{sum(kidnap.searching for kidnap in missed)} of {len(missed)} not right are searching",
        f"right within {WITHIN_FRAMES}: {rate(len(kidnaps) - len(missed), len(kidnaps))}",
    )


def _figure(outcomes: Sequence[Outcome], titles: Sequence[str]) -> Figure:
    """Error (red) and stated deviation (blue) over time; dots where the pose is not called tracked."""
    figure, axes = new_figure(1, len(outcomes), width_in=12.0, height_in=3.6)
    for each, outcome, title in zip(axes, outcomes, titles, strict=True):
        each.semilogy(outcome.times_s, 100.0 * outcome.errors_m, color=RED, linewidth=0.9, label="error")
        each.semilogy(outcome.times_s, 100.0 * outcome.deviations_m, color=BLUE, linewidth=0.9, label="±")
        doubted = outcome.times_s[~outcome.tracking]
        each.semilogy(doubted, np.full(len(doubted), 0.05), "k.", markersize=3, label="searching")
        each.set_title(title, fontsize=10)
        each.set_xlabel("time (s)")
    axes[0].set_ylabel("cm")
    axes[0].legend(frameon=False)
    return figure
