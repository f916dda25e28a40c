"""own-ablations: what each part of our own system brings, by leaving it out. No figure of a paper."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from touchline import palette
from touchline.experiments.faults import Drive
from touchline.experiments.own_drives import FROM_S, HALF, LATE, MATCH, SECONDS, SHAKING, TRACKS, UNTOUCHED, Condition
from touchline.experiments.own_play import KIDNAP_SECONDS, KIDNAPS
from touchline.experiments.own_table import OWN
from touchline.experiments.progress import computed
from touchline.experiments.reliability_runs import WITHIN_FRAMES, Kidnapped, driven, kidnaps_of, outcome
from touchline.experiments.result import ExperimentResult, Headline, interval, rate
from touchline.experiments.scenes import new_figure
from touchline.geometry import FloatArray, Pose
from touchline.localization.search.pose_search import Known, Mode
from touchline.motion import CompassTrackSettings, MotionHistory, OdometrySettings
from touchline.systems import RobotSetup, open_system
from touchline.systems.touchline import Touchline
from touchline.types import Prior

KIDNAP_RUNS = {"full view": 1, "a sector of 120°": 2}  # of a seed
_SECTOR = ("camera.black_sectors_deg=[[120,360]]",)


class Part(NamedTuple):
    """What is left out. settings: of the system without it; change: of the system itself; drive: of the scenario."""

    name: str
    settings: Mapping[str, Any] = {}
    change: Callable[[Touchline], None] = lambda system: None
    drive: tuple[str, ...] = ()


class _NoSearch:
    """Finds nothing."""

    def everywhere(
        self, positions_m: FloatArray, covariances_m2: FloatArray, known: Sequence[Known], part: tuple[int, int]
    ) -> tuple[Mode, ...]:
        return ()


def _without_search(system: Touchline) -> None:
    system.search = _NoSearch()


def _with_one_hypothesis(system: Touchline) -> None:
    system.hypotheses.most = 1


def _without_shoves(system: Touchline) -> None:
    system.hypotheses.sees_shoves = False


def _without_delay(system: Touchline) -> None:
    system.unknown = system.unknown._replace(delay_s=0.0)
    system.hypotheses.start.unknown = system.unknown


def _with_scales_as_noise(system: Touchline) -> None:
    system.history = MotionHistory(OdometrySettings(), CompassTrackSettings())


def _without_lean(system: Touchline) -> None:
    system.hypotheses.head.shakes = False


_NO_SCALES = {f"odometry.{way}_scale": 0.0 for way in ("forward", "sideways", "turn")}  # as states
_NEVER_IN_DOUBT = {"min_explained": 0.01, "search_every": 1000, "blind_frames": 1000, "min_probability": 0.51}
PARTS = (
    Part("nothing"),
    Part("search of the whole field", change=_without_search),
    Part("hypotheses: one pose alone", change=_with_one_hypothesis),
    Part("odometry's scales as states", _NO_SCALES, _with_scales_as_noise),
    Part("test for shoves", change=_without_shoves),
    Part("lean of each image", change=_without_lean),
    Part("self-calibration", {"self_calibration": False}),
    Part("failure detection", _NEVER_IN_DOUBT, _without_search),
    Part("late images: each applied when it arrives", change=_without_delay, drive=("camera.stamped=arrived",)),
)
CONDITIONS = (TRACKS, HALF, MATCH, SHAKING, UNTOUCHED, LATE)
COLUMNS = (
    "left out", *(f"{condition.name}: mean; 99 % (cm)" for condition in CONDITIONS), "wrong, called tracking (%)",
    *(f"kidnaps, {view}: {what}" for view in KIDNAP_RUNS
      for what in (f"right within {WITHIN_FRAMES} frames", "wrong, called tracking (%)")),
)  # fmt: skip


class Driven(NamedTuple):
    """Of one drive: mean and 99 % of the errors of its tracked frames (cm), NaN without one, and the share of all
    frames that were wrong and called tracking (%).
    """

    mean_cm: float
    p99_cm: float
    wrong: float


class Kidnaps(NamedTuple):
    """Of one run: its kidnaps, and the share of its frames that were wrong, called tracking, and the true pose was not
    named beside (%).
    """

    kidnaps: Sequence[Kidnapped]
    wrong: float


def own_ablations(seeds: int) -> ExperimentResult:
    """The same robots with each part left out in turn."""
    drives: dict[tuple[str, str], list[Driven]] = {}
    kidnaps: dict[tuple[str, str], list[Kidnaps]] = {}
    for of_drives, of_kidnaps in computed(_all_without, range(seeds), "robots"):
        for part, condition, one in of_drives:
            drives.setdefault((part, condition), []).append(one)
        for part, view, found in of_kidnaps:
            kidnaps.setdefault((part, view), []).append(found)
    rows = [(*_cells(part.name, drives), *_kidnap_cells(part.name, kidnaps)) for part in PARTS]
    worst = max(PARTS[1:], key=lambda part: float(np.mean([one.mean_cm for one in drives[part.name, UNTOUCHED.name]])))
    return ExperimentResult(
        "own-ablations",
        f"Our own system, {OWN}, with parts of it left out",
        seeds,
        COLUMNS,
        tuple(rows),
        Headline(f"{UNTOUCHED.name}: {OWN}; without {worst.name} (cm)", "–",
                 "; ".join(interval([one.mean_cm for one in drives[part.name, UNTOUCHED.name]])
                           for part in (PARTS[0], worst))),
        (_NOTES,),
        (("parts", _picture(drives, kidnaps)),),
    )  # fmt: skip


_NOTES = (
    f"The same robots as built as in own, {SECONDS:g} s at 10 Hz at the observation level, each told where it starts; "
    f"errors of tracked frames from {FROM_S:g} s on. Wrong: more than 0.5 m or 0.5 rad off, of all frames of these "
    f"drives. Kidnaps in play: {' and '.join(map(str, KIDNAP_RUNS.values()))} runs of {KIDNAP_SECONDS:g} s for each "
    "seed; there wrong where the true pose is not named as the twin beside. Without a search nobody who is lost "
    "is found again; with one pose alone a search's likeliest takes its place as soon as it explains more; the "
    "odometry's scales that are no states are noise; without failure detection a pose is never doubted and never "
    "searched for. Late images: stamped on arrival, and the delay, 60 ms where nothing else is said, is not found out. "
    "In the picture the means over robots, over those with nothing left out."
)


def _all_without(seed: int) -> tuple[list[tuple[str, str, Driven]], list[tuple[str, str, Kidnaps]]]:
    return driven_without(seed), kidnapped_without(seed)


def driven_without(seed: int) -> list[tuple[str, str, Driven]]:
    """Part, condition and what came of it, of one robot."""
    found = []
    for condition in CONDITIONS:
        for part in PARTS:
            drive, setup, _ = driven(condition.scenario, seed, SECONDS, *condition.changes, *part.drive)
            found.append((part.name, condition.name, _followed(part, drive, setup, seed)))
    return found


def kidnapped_without(seed: int) -> list[tuple[str, str, Kidnaps]]:
    """Part, view and what came of the kidnaps, of one robot's runs."""
    found = []
    for view, runs in KIDNAP_RUNS.items():
        hidden = () if view == "full view" else _SECTOR
        for run in range(runs * seed, runs * (seed + 1)):
            for part in PARTS:
                drive, setup, times_s = driven("match", run, KIDNAP_SECONDS, *KIDNAPS, *hidden, *part.drive)
                system = without(part, setup, drive, run)
                came = outcome(drive, [system.step(frame) for frame in drive.frames])
                wrong = 100.0 * float(came.unnamed.mean())
                found.append((part.name, view, Kidnaps(kidnaps_of(drive, times_s, came), wrong)))
    return found


def without(part: Part, setup: RobotSetup, drive: Drive, seed: int) -> Touchline:
    """Our own system without a part, told where a drive begins."""
    system = open_system(OWN, setup, part.settings, np.random.default_rng(seed))
    assert isinstance(system, Touchline)
    part.change(system)
    system.reset(Prior(Pose(*drive.truth[0].tolist())))
    return system


def _followed(part: Part, drive: Drive, setup: RobotSetup, seed: int) -> Driven:
    system = without(part, setup, drive, seed)
    found = outcome(drive, [system.step(frame) for frame in drive.frames])
    errors_cm = 100.0 * found.errors_m[found.tracking & (drive.times_s >= FROM_S)]
    wrong = 100.0 * float(found.wrong.mean())
    if len(errors_cm) == 0:
        return Driven(float("nan"), float("nan"), wrong)
    return Driven(float(errors_cm.mean()), float(np.quantile(errors_cm, 0.99)), wrong)


def _cells(name: str, drives: Mapping[tuple[str, str], Sequence[Driven]]) -> tuple[str, ...]:
    of = [drives[name, condition.name] for condition in CONDITIONS]
    cells = [f"{interval([o.mean_cm for o in each])}; {interval([o.p99_cm for o in each], 1)}" for each in of]
    return name, *cells, f"{np.mean([one.wrong for each in of for one in each]):.2f}"


def _kidnap_cells(name: str, runs: Mapping[tuple[str, str], Sequence[Kidnaps]]) -> tuple[str, ...]:
    cells = []
    for view in KIDNAP_RUNS:
        kidnaps = [one for run in runs[name, view] for one in run.kidnaps]
        cells += [rate(sum(one.right for one in kidnaps), len(kidnaps)), interval([r.wrong for r in runs[name, view]])]
    return tuple(cells)


def _picture(
    drives: Mapping[tuple[str, str], Sequence[Driven]], kidnaps: Mapping[tuple[str, str], Sequence[Kidnaps]]
) -> Figure:
    """Mean errors under each condition over those of the whole system, and kidnaps, with a part left out."""
    figure, (left, right) = new_figure(1, 2, 13.0, 4.2)

    def mean(part: Part, condition: Condition) -> float:
        return float(np.mean([one.mean_cm for one in drives[part.name, condition.name]]))

    heights = np.arange(len(PARTS))
    for condition, tint in zip(CONDITIONS, palette.SERIES, strict=False):
        ratios = [mean(part, condition) / mean(PARTS[0], condition) for part in PARTS]
        left.plot(ratios, heights, "o", color=tint, markersize=6, alpha=0.85, label=condition.name)
    left.set_xscale("log")
    left.set_yticks(heights, [part.name for part in PARTS])
    left.set_xlabel("mean error over that of the whole system")
    for n, (view, tint) in enumerate(zip(KIDNAP_RUNS, palette.SERIES, strict=False)):
        shares = [
            100.0 * np.mean([one.right for run in kidnaps[part.name, view] for one in run.kidnaps]) for part in PARTS
        ]
        right.barh(heights + 0.36 * (n - 0.5), shares, 0.32, color=tint, label=view)
    right.set_yticks(heights, [""] * len(PARTS))
    right.set_xlabel(f"kidnaps right within {WITHIN_FRAMES} frames (%)")
    for axis in (left, right):
        axis.set_ylim(len(PARTS) - 0.5, -0.5)
        axis.legend(frameon=True, fontsize=8)
    return figure
