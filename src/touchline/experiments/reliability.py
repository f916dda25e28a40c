"""reliability: faults of what is seen, of wheels and of the compass, and kidnaps; who calls a wrong pose tracking?

No figure of a paper.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from touchline.experiments import drives, faults
from touchline.experiments.drives import Drive, Kidnapped, Track, driven, followed
from touchline.experiments.faults import Fault, LaidIn, Slip
from touchline.experiments.harness import NONE, ExperimentResult, Headline, Row, gathered, rate
from touchline.experiments.scenes import BLUE, RED, new_figure
from touchline.geometry import Pose

SYSTEMS = ("nubot-mti", "nubot-mcl", "iris-fusion")  # nubot-mcl-alone is a comparison of the paper's, without doubt
SECONDS, BEGIN_S, AFTER_S = 34.0, 5.0, 3.0  # a drive; until a fault begins; what is looked at after it
COMPASS_RUNS, COMPASS_SECONDS, COMPASS_S = 2, 16.0, 3.0
ELSEWHERE = (1_000_000, 1_000_001, 1_000_002)  # drives that a robot is carried into, the first that is far enough
AMID_EVERY = 2  # of the runs with a compass's fault as many have a kidnap, too
KIDNAP_RUNS, KIDNAP_SECONDS = 1, 63.0
KIDNAPPED = "kidnaps in play"

FAULTS: tuple[LaidIn, ...] = (
    Fault("uniform points from the start", 0.0, SECONDS, faults.uniform_points),
    Fault("all points at 10⁶ m from the start", 0.0, SECONDS, faults.far_points),
    Fault("a blob 20 m away from the start", 0.0, SECONDS, faults.blob),
    Fault("a ring at 1 m from the start", 0.0, SECONDS, faults.ring),
    Fault("a ring at 1 m later", BEGIN_S, SECONDS, faults.ring),
    Fault("one true line for 10 s", BEGIN_S, BEGIN_S + 10.0, faults.one_line(BEGIN_S)),
    Fault("a false line for 5 s", BEGIN_S, BEGIN_S + 5.0, faults.false_line),
    Fault("odometry and wheels gone for 5 s", BEGIN_S, BEGIN_S + 5.0, faults.no_wheels),
    Fault("30 % of odometry and wheels dropped", 0.0, 12.0, faults.some_wheels(0.3)),
    Slip("wheels spinning for 2 s", BEGIN_S, BEGIN_S + 2.0, spin_m_s=2.0),
    Slip("wheels stuck for 10 s", BEGIN_S, BEGIN_S + 10.0, factor=0.0),
    Slip("wheels × 1.15", 0.0, 12.0, factor=1.15),
    Fault("compass + 180° from the start", 0.0, SECONDS, faults.turned_compass),
)
COMPASS: tuple[LaidIn, ...] = (
    Fault("compass + 180° for 10 s, in play", COMPASS_S, COMPASS_S + 10.0, faults.turned_compass),
    Fault("compass stuck for 10 s, in play", COMPASS_S, COMPASS_S + 10.0, faults.stuck_compass(COMPASS_S)),
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
        others = (driven("match", seed, COMPASS_SECONDS) for seed in ELSEWHERE)
        other = next(o for o in others if drives.counts(Pose(*drive.truth[cut - 1]), Pose(*o.truth[cut])))
        compass = Fault("", COMPASS_S, COMPASS_S + 8.0, faults.turned_compass)
        return compass.laid_into(faults.spliced(drive, other, self.start_s), rng)


AMID: tuple[LaidIn, ...] = (
    KidnapAmid("a kidnap while the compass is + 180°", COMPASS_S + 4.0, COMPASS_S + 4.0),
    KidnapAmid("a kidnap after the compass was + 180°", COMPASS_S + 10.5, COMPASS_S + 10.5),
)


Runs = dict[tuple[str, str], Track]  # by fault and system
Task = tuple[str, tuple[str, int, float]]  # which faults, or kidnaps; the drive


def _tasks(seeds: int) -> list[Task]:
    """All drives of so many seeds."""
    in_play = [("match", run, COMPASS_SECONDS) for run in range(COMPASS_RUNS * seeds)]
    return [
        *(("faults", ("straight-tracks", seed, SECONDS)) for seed in range(seeds)),
        *(("compass" if drive[1] % AMID_EVERY else "amid", drive) for drive in in_play),
        *((KIDNAPPED, ("match", seed, KIDNAP_SECONDS)) for seed in range(KIDNAP_RUNS * seeds)),
    ]


def _measured(task: Task) -> dict[tuple[str, str], Track | list[Kidnapped]]:
    """One drive: what every system made of it under every fault, or its kidnaps."""
    kind, (scenario, seed, seconds) = task
    drive = driven(scenario, seed, seconds, *(drives.KIDNAPS if kind == KIDNAPPED else ()))
    if kind == KIDNAPPED:
        return {(kind, system): drives.kidnaps_of(drive, followed(system, drive, seed)) for system in SYSTEMS}
    found: dict[tuple[str, str], Track | list[Kidnapped]] = {}
    for fault in {"faults": FAULTS, "compass": COMPASS, "amid": (*COMPASS, *AMID)}[kind]:
        faulty = fault.laid_into(drive, np.random.default_rng([seed, 14])).until(fault.end_s + AFTER_S)
        found |= {(fault.name, system): followed(system, faulty, seed) for system in SYSTEMS}
    return found


def reliability(seeds: int) -> ExperimentResult:
    """Every fault for every system, and kidnaps in play."""
    named = {fault.name: fault for fault in (*FAULTS, *COMPASS, *AMID)}
    found = gathered(_measured, _tasks(seeds), "drives")
    runs = {key: [one for one in found[key] if isinstance(one, Track)] for key in found if key[0] != KIDNAPPED}
    kidnaps = {
        system: [one for some in found[KIDNAPPED, system] if isinstance(some, list) for one in some]
        for system in SYSTEMS
    }
    fooled = [track for tracks in runs.values() for track in tracks]
    carried = [kidnap for each in kidnaps.values() for kidnap in each]
    in_order = sorted(runs, key=lambda key: list(named).index(key[0]))
    return ExperimentResult(
        "Faults of what is seen, of wheels and of the compass, and kidnaps in play; wrong is more than "
        f"{drives.WRONG_M:g} m or 0.5 rad off",
        _COLUMNS,
        [*((*key, *_cells(named[key[0]], runs[key])) for key in in_order),
         *((KIDNAPPED, system, *_kidnap_cells(each)) for system, each in kidnaps.items())],
        Headline(
            "runs fooled; kidnaps in play right within 10 frames; fooled",
            NONE,
            f"{_fooled(fooled)} of {len(fooled)}; {rate(sum(k.right for k in carried), len(carried))}; "
            f"{sum(k.wrong > drives.FOOLED_FRAMES for k in carried)} of {len(carried)}",
        ),
        _NOTES,
        (("faults", _figure([runs[name, SYSTEMS[0]][0] for name in SHOWN], SHOWN)),),
    )  # fmt: skip


_COLUMNS = (
    "fault", "system", "runs", "fooled", "frames wrong, called tracking, unnamed: most of a run", "all of them (%)",
    "tracking (%)", "frames until right again: median, longest",
)  # fmt: skip
_NOTES = (
    f"Fooled: more than {drives.FOOLED_FRAMES} frames in a row wrong, called tracking, and the true pose not named as "
    "the twin at the other end of the field. Rates have Wilson's interval of 95 %.",
    f"Robots as built, observation level, 10 frames per second: {SECONDS:g} s of straight-tracks; in play: "
    f"{COMPASS_RUNS} runs of match per seed, with shoves and eight robots. Faults of odometry are those of the "
    "measuring wheels as well.",
    f"Kidnaps in play: every {drives.KIDNAP_EVERY_S:g} s in full view, {drives.KIDNAP_M:g} m or 30° away or more and "
    f"not within {drives.TWIN_M:g} m of the twin. Right: tracked within {100 * drives.NEAR_M:.0f} cm and 10° in one of "
    f"the {drives.WITHIN_FRAMES} frames from the first at the new place; in the row's other columns are frames in a "
    "row wrong while tracking, and of the kidnaps that were not right how many were searching then.",
    "A compass that is half a turn off from the first frame can't be told from a right one: both ends are named.",
)


def _fooled(tracks: Sequence[Track]) -> int:
    return sum(drives.longest(track.unnamed) > drives.FOOLED_FRAMES for track in tracks)


def _cells(fault: LaidIn, tracks: Sequence[Track]) -> Row:
    unnamed = [int(np.count_nonzero(track.unnamed)) for track in tracks]
    return (
        str(len(tracks)),
        rate(_fooled(tracks), len(tracks)),
        str(max(unnamed)),
        f"{100.0 * sum(unnamed) / sum(len(track.times_s) for track in tracks):.2f}",
        f"{100.0 * np.mean([track.tracking.mean() for track in tracks]):.0f}",
        _back(tracks, fault.end_s) if fault.end_s < SECONDS else NONE,
    )


def _back(tracks: Sequence[Track], time_s: float) -> str:
    """Frames until found again from a time on: median, longest."""
    back = [track.frames_until_found(time_s) for track in tracks]
    known = [frames for frames in back if frames is not None]
    if not known:
        return "never"
    return f"{np.median(known):g}, {max(known)}" + (f"; {len(back) - len(known)} never" if None in back else "")


def _kidnap_cells(kidnaps: Sequence[Kidnapped]) -> Row:
    missed = [kidnap for kidnap in kidnaps if not kidnap.right]
    return (
        str(len(kidnaps)),
        rate(sum(kidnap.wrong > drives.FOOLED_FRAMES for kidnap in kidnaps), len(kidnaps)),
        str(max(kidnap.wrong for kidnap in kidnaps)),
        NONE,
        f"{sum(kidnap.searching for kidnap in missed)} of {len(missed)} not right are searching",
        f"right within {drives.WITHIN_FRAMES}: {rate(len(kidnaps) - len(missed), len(kidnaps))}",
    )


def _figure(tracks: Sequence[Track], titles: Sequence[str]) -> Figure:
    """Error (red) and stated deviation (blue) over time; dots where the pose is not called tracked."""
    figure, axes = new_figure(1, len(tracks), (12.0, 3.6), titles, ("time (s)", ""))
    for each, track in zip(axes, tracks, strict=True):
        each.semilogy(track.times_s, 100.0 * track.distances_m, color=RED, linewidth=0.9, label="error")
        each.semilogy(track.times_s, 100.0 * track.deviations_m, color=BLUE, linewidth=0.9, label="±")
        doubted = track.times_s[~track.tracking]
        each.semilogy(doubted, np.full(len(doubted), 0.05), "k.", markersize=3, label="searching")
    axes[0].set_ylabel("cm")
    axes[0].legend(frameon=False)
    return figure
