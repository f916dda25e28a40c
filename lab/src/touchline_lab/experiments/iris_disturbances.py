"""iris-disturbances: a covered camera, a slip of the wheels, a drifting gyro, one at a time. No figure of the paper."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from touchline_lab.experiments.drives import Drive, drive_of
from touchline_lab.experiments.harness import NONE, ExperimentResult, Headline, Row, gathered, seed_range
from touchline_lab.experiments.injections import SLIP_S, covered, gyro_drifting, slipped
from touchline_lab.experiments.iris_runs import FORMS, FUSION, IDEAL, ODOMETRY, IrisDrive, drive, open_iris
from touchline_lab.experiments.scenes import BLUE, RED, new_figure
from touchline_lab.simulation.scenario import open_scenario

START_S, SECONDS = 8.0, 18.0
COVERED_S, SLIP_M, DRIFT_RAD_S = 3.0, 0.3, math.radians(1.0)
FAR_M, NEAR_M, BACK_S = 0.3, 0.1, 2.0
FIELDS = ("indoor-9x6", "msl-18x12")
KINDS = ("nothing", "covered", "slip", "drift")
SCENARIOS = ("tour-20", "match")
ON_IMAGES, SAME = "on images", "the same robots at the observation level"
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


Outcomes = dict[tuple[str, str, str], list[Outcome]]  # by form, field and disturbance


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
    direction = float(np.random.default_rng([case.seed, 5]).uniform(-math.pi, math.pi))
    kinds: dict[str, tuple[Callable[[Drive], Drive], float]] = {
        "nothing": (lambda taken: taken, 0.0),
        "covered": (lambda taken: covered(taken, START_S, COVERED_S), COVERED_S),
        "slip": (lambda taken: slipped(taken, START_S, SLIP_M, direction), SLIP_S),
        "drift": (lambda taken: gyro_drifting(taken, START_S, DRIFT_RAD_S), 0.0),
    }
    disturb, lasts_s = kinds[kind]
    return outcome_of(drive(disturb(_taken(case)), case.seed, paper), START_S + lasts_s)


@lru_cache(maxsize=1)
def _taken(case: Case) -> Drive:
    """A scenario without shoves; kept for the next disturbance of the same drive."""
    changes = (*case.changes, "disturbances.shove_every_s=0", f"field={case.field}")
    return drive_of(*open_iris(open_scenario(case.scenario, case.seed, SECONDS, changes), case.level, case.seed))


def outcome_of(driven: IrisDrive, ends_s: float) -> Outcome:
    """What became of a drive whose disturbance ends then."""
    track = driven.fused
    if not driven.found or track.times_s[0] > START_S:
        return Outcome(driven)
    period_s, distances_m = float(np.median(np.diff(track.times_s))), track.distances_m
    return Outcome(
        driven,
        round(period_s * np.count_nonzero(distances_m > FAR_M), 6),
        float(distances_m[track.times_s >= ends_s + BACK_S].max()),
        round(period_s * np.count_nonzero(~track.tracking), 6),  # whoever searches is lost, too
        float(distances_m.max()),
    )


def iris_disturbances(seeds: int) -> ExperimentResult:
    """Every kind of disturbance on both fields, slowly and in play."""
    rendered = min(seeds, RENDERED)
    outcomes = gathered(_as_points, list(product(FIELDS, SCENARIOS, seed_range(seeds))), "drives")
    shown = [(*place, seed) for place in zip(FIELDS, SCENARIOS, strict=True) for seed in seed_range(rendered)]
    outcomes |= gathered(_on_images, shown, "drives on images")
    for (k, field), kind in product(enumerate(FIELDS), KINDS):
        outcomes[SAME, field, kind] = outcomes["as built", field, kind][k * seeds :][:rendered]
    forms = (*FORMS, ON_IMAGES, SAME)
    missed = {form: sum(not one.found for found in _of(outcomes, form).values() for one in found) for form in forms}
    return ExperimentResult(
        "A covered camera, a slip of the wheels, a drifting gyro: the fused pose of iris-fusion",
        ("field", "disturbance", "kept: its form here", "kept", "on images", "the same robots as points",
         "ideal", "farthest off (cm)", "more than 30 cm off (s)", "farthest off from 2 s after it (cm)", "lost (s)"),
        [_row(field, kind, outcomes) for field in FIELDS for kind in KINDS],
        Headline("drives kept: within 30 cm but for 0.5 s after a slip, 10 cm after 2 s, lost for 1 s at most, "
                 "undisturbed never", NONE,
                 "; ".join(f"{form} {_kept(_of(outcomes, form))}" for form in forms)),
        (
            f"Each drive is disturbed once, after {START_S:g} s: the camera covered for {COVERED_S:g} s; the wheels "
            f"roll {100 * SLIP_M:.0f} cm within 0.15 s that the robot doesn't go; from then on the gyro shows "
            f"{math.degrees(DRIFT_RAD_S):g} degree per second more, beside its own bias. Scenarios {SCENARIOS[0]} "
            f"(1.2 m/s) and {SCENARIOS[1]} (3 m/s among eight robots, without shoves), robots as built, 10 images per "
            "second, at the observation level with the geometry and the errors of their own eyes and the noise of real "
            f"images; {rendered} robots also on rendered images, {SCENARIOS[0]} on {FIELDS[0]} and "
            f"{SCENARIOS[1]} on {FIELDS[1]}. "
            "The last four columns are the worst of all drives of robots as built as points.",
            *(f"In {count} drives ({form}) the robot was not found in time; they count as not kept, and the "
              "last four columns leave them out." for form, count in missed.items() if count and form != SAME),
        ),
        (("errors", _errors_figure(outcomes)),),
    )  # fmt: skip


def _as_points(drive: tuple[str, str, int]) -> dict[tuple[str, str, str], Outcome]:
    field, scenario, seed = drive
    built, ideal = (Case(scenario, field, seed, changes=changes) for changes in ((), IDEAL))
    forms = {"as built": (built, False), "its form here": (built, True), "ideal": (ideal, False)}
    return {(form, field, kind): disturbed_drive(kind, *how) for form, how in forms.items() for kind in KINDS}


def _on_images(drive: tuple[str, str, int]) -> dict[tuple[str, str, str], Outcome]:
    field, scenario, seed = drive
    return {(ON_IMAGES, field, kind): disturbed_drive(kind, Case(scenario, field, seed, "images")) for kind in KINDS}


def _of(outcomes: Outcomes, form: str, *place: str) -> Outcomes:
    """Those of a form, and of a field and disturbance."""
    return {key: found for key, found in outcomes.items() if key[: 1 + len(place)] == (form, *place)}


def _kept(outcomes: Outcomes) -> str:
    every = [outcome.is_kept(kind) for (_, _, kind), found in outcomes.items() for outcome in found]
    return f"{sum(every)} of {len(every)}"


def _row(field: str, kind: str, outcomes: Outcomes) -> Row:
    """How many were kept, and the worst of each figure."""
    kept = [_kept(_of(outcomes, form, field, kind)) for form in ("its form here", "as built", ON_IMAGES, SAME, "ideal")]
    found = [outcome for outcome in outcomes["as built", field, kind] if outcome.found]
    figures = np.array([(100.0 * o.largest_m, o.far_s, 100.0 * o.back_m, o.lost_s) for o in found]).reshape(-1, 4)
    return (field, kind, *kept, *(f"{column.max():.1f}" if found else NONE for column in figures.T))


def _errors_figure(outcomes: Outcomes) -> Figure:
    """Distance from the truth over the time since the disturbance: fusion red, odometry alone blue."""
    figure, axes = new_figure(1, 3, (12.0, 3.6), KINDS[1:], ("time since it began (s)", ""))
    for each, kind in zip(axes, KINDS[1:], strict=True):
        drives = [outcome.drive for field in FIELDS for outcome in outcomes["as built", field, kind]]
        for driven, (system, color) in product(drives, ((ODOMETRY, BLUE), (FUSION, RED))):
            track = driven.tracks[system]
            each.plot(track.times_s - START_S, 100.0 * track.distances_m, color=color, linewidth=0.6, alpha=0.6)
        each.set(xlim=(-2.0, 8.0), ylim=(0.0, 100.0))
    axes[0].set_ylabel("distance from the truth (cm)")
    return figure
