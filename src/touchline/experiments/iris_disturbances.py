"""iris-disturbances: a covered camera, a slip of the wheels, a drifting gyro, one at a time. No figure of the paper."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from touchline.experiments.iris_eyes import open_iris
from touchline.experiments.iris_runs import FORMS, IDEAL, Disturb, IrisDrive, covered, drifting, drive, slipped
from touchline.experiments.progress import follow
from touchline.experiments.result import ExperimentResult, Headline
from touchline.experiments.scenes import BLUE, RED, new_figure
from touchline.geometry import FloatArray
from touchline.simulation.run import Simulation
from touchline.simulation.scenario import open_scenario
from touchline.systems import RobotSetup
from touchline.types import Frame, Status

START_S, SECONDS = 8.0, 18.0
COVERED_S, SLIP_M, DRIFT_RAD_S = 3.0, 0.3, math.radians(1.0)
FAR_M, NEAR_M, BACK_S = 0.3, 0.1, 2.0
FIELDS = ("indoor-9x6", "msl-18x12")
KINDS = ("nothing", "covered", "slip", "drift")
SCENARIOS = ("tour-20", "match")
_SAME = "the same robots at the observation level"
RENDERED = 2  # robots whose images are rendered


@dataclass(frozen=True, eq=False, slots=True)
class Outcome:
    """What a disturbance did to the fused pose.

    far_s: how long the pose was more than 30 cm off; back_m: largest error from 2 s after the end on; lost_s: how long
    the status was lost; largest_m: largest error of all. Infinite if the robot was not found before the disturbance.
    """

    drive: IrisDrive
    far_s: float = math.inf
    back_m: float = math.inf
    lost_s: float = math.inf
    largest_m: float = math.inf

    @property
    def found(self) -> bool:
        """Whether the robot was found before the disturbance."""
        return math.isfinite(self.largest_m)

    def is_kept(self, kind: str) -> bool:
        """Whether the pose was as good as it must be under such a disturbance."""
        far_s, lost_s = (0.5 if kind == "slip" else 0.0), (0.0 if kind == "nothing" else 1.0)
        return self.far_s <= far_s and self.back_m <= NEAR_M and self.lost_s <= lost_s

    @property
    def times_s(self) -> FloatArray:
        """Time since the disturbance began (N,)."""
        since: FloatArray = self.drive.stamp_ns / 1e9 - START_S
        return since


Outcomes = dict[tuple[str, str], list[Outcome]]  # by field and disturbance


class Case(NamedTuple):
    """One drive: scenario, field, seed, level (`images` or `points`) and changes to the robot as built."""

    scenario: str
    field: str
    seed: int
    level: str = "points"
    changes: tuple[str, ...] = ()


def disturbed_drive(kind: str, case: Case, paper: bool = False) -> Outcome:
    """One drive with a disturbance that begins 8 s after its start; nothing else happens in it.

    kind: one of KINDS. paper: by the paper's own form. Raises KeyError for another kind.
    """
    simulation, setup, taken = _taken(case)
    wheels = simulation.wheel_directions_rad
    direction = float(np.random.default_rng([case.seed, 5]).uniform(-math.pi, math.pi))
    known: dict[str, tuple[Disturb, float]] = {
        "nothing": (covered(START_S, 0.0), 0.0),
        "covered": (covered(START_S, COVERED_S), COVERED_S),
        "slip": (slipped(START_S, SLIP_M, direction, wheels), 0.15),
        "drift": (drifting(START_S, DRIFT_RAD_S), 0.0),
    }
    disturb, lasts_s = known[kind]
    driven = drive(map(disturb, taken), simulation.truth.samples(), setup, case.seed, paper)
    return _outcome(driven, START_S + lasts_s)


@lru_cache(maxsize=1)
def _taken(case: Case) -> tuple[Simulation, RobotSetup, tuple[Frame, ...]]:
    """A scenario without shoves and its frames; kept for the next disturbance of the same drive."""
    scenario = open_scenario(case.scenario, case.seed, SECONDS, case.changes)
    disturbances = scenario.disturbances.model_copy(update={"shove_every_s": 0.0})
    changed = scenario.model_copy(update={"field": case.field, "disturbances": disturbances})
    simulation, setup = open_iris(changed, case.level, case.seed)
    return simulation, setup, tuple(simulation)


def _outcome(driven: IrisDrive, ends_s: float) -> Outcome:
    times_s = driven.stamp_ns / 1e9
    if not driven.found or times_s[0] > START_S:
        return Outcome(driven)
    distances_m = driven.distances_m("sensor fusion")
    period_s = float(np.median(np.diff(times_s)))
    lost = np.array([status is not Status.TRACKING for status in driven.statuses])  # whoever searches is lost, too
    return Outcome(
        driven,
        round(period_s * np.count_nonzero(distances_m > FAR_M), 6),
        float(distances_m[times_s >= ends_s + BACK_S].max()),
        round(period_s * np.count_nonzero(lost), 6),
        float(distances_m.max()),
    )


def iris_disturbances(seeds: int) -> ExperimentResult:
    """Every kind of disturbance on both fields, slowly and in play."""
    outcomes: dict[str, Outcomes] = {
        form: {(field, kind): [] for field in FIELDS for kind in KINDS} for form in (*FORMS, "on images", _SAME)
    }
    places = list(product(FIELDS, SCENARIOS))
    for (field, name), seed in follow(list(product(places, range(seeds))), "drives"):
        for form, changes in (("as built", ()), ("ideal", IDEAL)):
            for kind in KINDS:
                case = Case(name, field, seed, changes=changes)
                outcomes[form][field, kind].append(disturbed_drive(kind, case))
                if form == "as built":
                    outcomes["its form here"][field, kind].append(disturbed_drive(kind, case, paper=True))
    for field, name in follow(list(zip(FIELDS, SCENARIOS, strict=True)), "drives on images"):
        for seed, kind in product(range(min(seeds, RENDERED)), KINDS):
            outcomes["on images"][field, kind].append(disturbed_drive(kind, Case(name, field, seed, "images")))
            same = outcomes["as built"][field, kind][SCENARIOS.index(name) * seeds + seed]
            outcomes[_SAME][field, kind].append(same)
    missed = {form: sum(not o.found for found in each.values() for o in found) for form, each in outcomes.items()}
    return ExperimentResult(
        "iris-disturbances",
        "A covered camera, a slip of the wheels, a drifting gyro: the fused pose of iris-fusion",
        seeds,
        ("field", "disturbance", "kept: its form here", "kept", "on images", "the same robots as points",
         "ideal", "farthest off (cm)", "more than 30 cm off (s)", "farthest off from 2 s after it (cm)", "lost (s)"),
        tuple(_row(field, kind, outcomes) for field in FIELDS for kind in KINDS),
        Headline("drives kept: within 30 cm but for 0.5 s after a slip, 10 cm after 2 s, lost for 1 s at most, "
                 "undisturbed never", "–",
                 "; ".join(f"{form} {_kept(each)}" for form, each in outcomes.items())),
        (
            f"Each drive is disturbed once, after {START_S:g} s: the camera covered for {COVERED_S:g} s; the wheels "
            f"roll {100 * SLIP_M:.0f} cm within 0.15 s that the robot doesn't go; from then on the gyro shows "
            f"{math.degrees(DRIFT_RAD_S):g} degree per second more, beside its own bias. Scenarios {SCENARIOS[0]} "
            f"(1.2 m/s) and {SCENARIOS[1]} (3 m/s among eight robots, without shoves), robots as built, 10 images per "
            "second, at the observation level with the geometry and the errors of their own eyes and the noise of real "
            f"images; {min(seeds, RENDERED)} robots also on rendered images, {SCENARIOS[0]} on {FIELDS[0]} and "
            f"{SCENARIOS[1]} on {FIELDS[1]}. "
            "The last four columns are the worst of all drives of robots as built as points.",
            *(f"In {count} drives ({form}) the robot was not found in time; they count as not kept, and the "
              "last four columns leave them out." for form, count in missed.items() if count and form != _SAME),
        ),
        (("errors", _errors_figure(outcomes["as built"])),),
    )  # fmt: skip


def _kept(outcomes: Outcomes) -> str:
    every = [outcome.is_kept(kind) for (_, kind), found in outcomes.items() for outcome in found]
    return f"{sum(every)} of {len(every)}"


def _row(field: str, kind: str, outcomes: Mapping[str, Outcomes]) -> tuple[str, ...]:
    """How many were kept, and the worst of each figure."""
    shown = ("its form here", "as built", "on images", _SAME, "ideal")
    kept = [_kept({(field, kind): outcomes[form][field, kind]}) for form in shown]
    found = [outcome for outcome in outcomes["as built"][field, kind] if outcome.found]
    figures = np.array([(100.0 * o.largest_m, o.far_s, 100.0 * o.back_m, o.lost_s) for o in found]).reshape(-1, 4)
    worst = [f"{column.max():.1f}" if found else "–" for column in figures.T]
    return (field, kind, *kept, *worst)


def _errors_figure(outcomes: Outcomes) -> Figure:
    """Distance from the truth over the time since the disturbance: fusion red, odometry alone blue."""
    figure, axes = new_figure(1, 3, width_in=12.0, height_in=3.6)
    for each, kind in zip(axes, KINDS[1:], strict=True):
        for field in FIELDS:
            for outcome in outcomes[field, kind]:
                for system, color in (("odometry", BLUE), ("sensor fusion", RED)):
                    distances = 100.0 * outcome.drive.distances_m(system)
                    each.plot(outcome.times_s, distances, color=color, linewidth=0.6, alpha=0.6)
        each.set_title(kind, fontsize=10)
        each.set_xlabel("time since it began (s)")
        each.set_xlim(-2.0, 8.0)
        each.set_ylim(0.0, 100.0)
    axes[0].set_ylabel("distance from the truth (cm)")
    return figure
