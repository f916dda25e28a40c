"""own-ablations: what each part of our own system brings, by leaving it out. No figure of a paper."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from touchline import palette
from touchline.geometry import Pose
from touchline.localization.camera_errors.base import Lean
from touchline.localization.estimator.filter import Filter
from touchline.motion import CompassTrackSettings, MotionHistory, OdometrySettings
from touchline.systems import open_system
from touchline.systems.touchline import Touchline
from touchline.types import Prior
from touchline_lab.experiments import harness
from touchline_lab.experiments.drives import (
    KIDNAPS,
    WITHIN_FRAMES,
    Drive,
    Kidnapped,
    Track,
    driven,
    kidnaps_of,
    track_of,
)
from touchline_lab.experiments.own import FROM_S, HALF, KIDNAP_SECONDS, LATE, MATCH, SECONDS, SHAKING, TRACKS, UNTOUCHED
from touchline_lab.experiments.own_points import OWN
from touchline_lab.experiments.scenes import new_figure

KIDNAP_RUNS = {"full view": 1, "a sector of 120°": 2}  # of a seed
_SECTOR = ("camera.black_sectors_deg=[[120,360]]",)


class Part(NamedTuple):
    """What is left out. settings: of the system without it; swap: what stands in its place; drive: of the scenario."""

    name: str
    settings: Mapping[str, Any] = {}
    swap: Callable[[Touchline], None] = lambda system: None
    drive: tuple[str, ...] = ()


def _without_search(system: Touchline) -> None:
    finds_nothing: Any = SimpleNamespace(modes=lambda *_: ())
    system.watch.search = finds_nothing


def _with_one_hypothesis(system: Touchline) -> None:
    system.bank.max_members = 1


def _without_shoves(system: Touchline) -> None:
    sees_none: Any = SimpleNamespace(apply=lambda *_: None, gate=math.inf)
    system.bank.shoves = sees_none


def _without_delay(system: Touchline) -> None:
    system.initial = system.initial._replace(delay_s=0.0)
    system.bank.start = Filter(Pose(0.0, 0.0, 0.0), system.settings.start_covariance, system.initial)


def _with_scales_as_noise(system: Touchline) -> None:
    system.history = MotionHistory(OdometrySettings(), CompassTrackSettings())


def _without_lean(system: Touchline) -> None:
    system.open_parts(replace(system.errors, lean=Lean(0.0, 0.0, 0.0, 1.0)))


_NO_SCALES = {f"odometry.{way}_scale": 0.0 for way in ("forward", "sideways", "turn")}  # as states
_NEVER_IN_DOUBT = {"min_explained": 0.01, "search_every": 1000, "blind_frames": 1000, "min_probability": 0.51}
PARTS = (
    Part("nothing"),
    Part("search of the whole field", swap=_without_search),
    Part("hypotheses: one pose alone", swap=_with_one_hypothesis),
    Part("odometry's scales as states", _NO_SCALES, _with_scales_as_noise),
    Part("test for shoves", swap=_without_shoves),
    Part("lean of each image", swap=_without_lean),
    Part("self-calibration", {"self_calibration": False}),
    Part("failure detection", _NEVER_IN_DOUBT, _without_search),
    Part("late images: each applied when it arrives", swap=_without_delay, drive=("camera.stamped=arrived",)),
)
CONDITIONS = (TRACKS, HALF, MATCH, SHAKING, UNTOUCHED, LATE)
COLUMNS = (
    "left out", *(f"{condition.name}: mean; median; 99 % (cm)" for condition in CONDITIONS),
    "wrong, called tracking (%)",
    *(f"kidnaps, {view}: {what}" for view in KIDNAP_RUNS
      for what in (f"right within {WITHIN_FRAMES} frames", "wrong, called tracking (%)")),
)  # fmt: skip


class Driven(NamedTuple):
    """Of one drive: mean and 99 % of the errors of its tracked frames (cm), NaN without one, the share of all frames
    that were wrong and called tracking (%), and its kidnaps. Of a run with kidnaps only such count as wrong beside
    which the true pose was not named.
    """

    mean_cm: float
    p99_cm: float
    wrong: float
    kidnaps: Sequence[Kidnapped] = ()


Found = Mapping[tuple[str, str], Sequence[Driven]]  # by part, and by condition or view


def own_ablations(seeds: int) -> harness.ExperimentResult:
    """The same robots with each part left out in turn."""
    found: dict[tuple[str, str], list[Driven]] = {}
    for of_robot in harness.computed(without_parts, harness.seed_range(seeds), "robots"):
        for part, where, one in of_robot:
            found.setdefault((part, where), []).append(one)
    return page(found)


def without_parts(seed: int) -> list[tuple[str, str, Driven]]:
    """Part, condition or view, and what came of it, of one robot's drives and its runs with kidnaps."""
    drives = [(c.name, c.scenario, seed, SECONDS, c.changes) for c in CONDITIONS]
    for view, runs in KIDNAP_RUNS.items():
        changes: tuple[str, ...] = KIDNAPS if view == "full view" else (*KIDNAPS, *_SECTOR)
        drives += [(view, "match", run, KIDNAP_SECONDS, changes) for run in range(runs * seed, runs * (seed + 1))]
    found = []
    for where, scenario, number, seconds, changes in drives:
        for part in PARTS:
            drive = driven(scenario, number, seconds, *changes, *part.drive)
            track = track_of(drive, [*map(without(part, drive, number).step, drive.frames)])
            found.append((part.name, where, _told(drive, track, where in KIDNAP_RUNS)))
    return found


def without(part: Part, drive: Drive, seed: int) -> Touchline:
    """Our own system without a part, told where a drive begins."""
    system = open_system(OWN, drive.setup, part.settings, np.random.default_rng(seed))
    assert isinstance(system, Touchline)
    part.swap(system)
    system.reset(Prior(Pose(*drive.truth[0].tolist())))
    return system


def _told(drive: Drive, track: Track, kidnapped: bool) -> Driven:
    wrong = 100.0 * float((track.unnamed if kidnapped else track.wrong).mean())
    errors_cm = 100.0 * track.part(track.tracking & (track.times_s >= FROM_S)).distances_m
    if len(errors_cm) == 0:
        return Driven(float("nan"), float("nan"), wrong, kidnaps_of(drive, track))
    return Driven(float(errors_cm.mean()), float(np.quantile(errors_cm, 0.99)), wrong, kidnaps_of(drive, track))


def page(found: Found) -> harness.ExperimentResult:
    """The table, headline and picture."""
    untouched = [[one.mean_cm for one in found[part.name, UNTOUCHED.name]] for part in PARTS]
    worst = 1 + int(np.argmax([np.median(robots) for robots in untouched[1:]]))
    return harness.ExperimentResult(
        f"Our own system, {OWN}, with parts of it left out",
        COLUMNS,
        [_row(part.name, found) for part in PARTS],
        harness.Headline(f"{UNTOUCHED.name}: {OWN}; without {PARTS[worst].name} (mean, median over robots, cm)",
                 harness.NONE,
                 "; ".join(f"{harness.interval(untouched[k])}, {np.median(untouched[k]):.2f}" for k in (0, worst))),
        (_NOTES,),
        (("parts", _picture(found)),),
    )  # fmt: skip


_NOTES = (
    f"The same robots as built as in own, {SECONDS:g} s at 10 Hz at the observation level, each told where it starts; "
    f"errors of tracked frames from {FROM_S:g} s on; the median is over robots, of their means: one that is lost does "
    "not move it. Wrong: more than 0.5 m or 0.5 rad off, of all frames of these "
    f"drives. Kidnaps in play: {' and '.join(map(str, KIDNAP_RUNS.values()))} runs of {KIDNAP_SECONDS:g} s for each "
    "seed; there wrong where the true pose is not named as the twin beside. Without a search nobody who is lost "
    "is found again; with one pose alone a search's likeliest takes its place as soon as it explains more; the "
    "odometry's scales that are no states are noise; without failure detection a pose is never doubted and never "
    "searched for. Late images: stamped on arrival, and the delay, 60 ms where nothing else is said, is not found out. "
    "In the picture the medians over robots, over those with nothing left out."
)


def _row(part: str, found: Found) -> harness.Row:
    of = [found[part, condition.name] for condition in CONDITIONS]
    cells = [
        f"{harness.interval([o.mean_cm for o in each])}; {np.median([o.mean_cm for o in each]):.2f}; "
        f"{harness.interval([o.p99_cm for o in each], 1)}"
        for each in of
    ]
    cells.append(f"{np.mean([one.wrong for each in of for one in each]):.2f}")
    for view in KIDNAP_RUNS:
        kidnaps = [one.right for run in found[part, view] for one in run.kidnaps]
        cells += [harness.rate(sum(kidnaps), len(kidnaps)), harness.interval([run.wrong for run in found[part, view]])]
    return part, *cells


def _picture(found: Found) -> Figure:
    """Mean errors under each condition over those of the whole system, and kidnaps, with a part left out."""
    figure, (left, right) = new_figure(1, 2, (13.0, 4.2))
    heights = np.arange(len(PARTS))
    for condition, tint in zip(CONDITIONS, palette.SERIES, strict=False):
        means = [float(np.median([one.mean_cm for one in found[part.name, condition.name]])) for part in PARTS]
        ratios = [mean / means[0] for mean in means]
        left.plot(ratios, heights, "o", color=tint, markersize=6, alpha=0.85, label=condition.name)
    left.set(xscale="log", xlabel="error (median over robots) over that of the whole system")
    for n, (view, tint) in enumerate(zip(KIDNAP_RUNS, palette.SERIES, strict=False)):
        kidnaps = [[one.right for run in found[part.name, view] for one in run.kidnaps] for part in PARTS]
        right.barh(heights + 0.36 * (n - 0.5), 100.0 * np.array([*map(np.mean, kidnaps)]), 0.32, color=tint, label=view)
    right.set_xlabel(f"kidnaps right within {WITHIN_FRAMES} frames (%)")
    for axis, names in ((left, [part.name for part in PARTS]), (right, [""] * len(PARTS))):
        axis.set_yticks(heights, names)
        axis.set_ylim(len(PARTS) - 0.5, -0.5)
        axis.legend(frameon=True, fontsize=8)
    return figure
