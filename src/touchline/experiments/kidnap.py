"""lu2013-kidnap (figure 9) and xiong-kidnap (figure 8): the robot is carried elsewhere and finds back."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from touchline.experiments.kidnap_play import (
    COLUMNS,
    CYCLES,
    EVERY_S,
    RIGHT_M,
    WITHIN,
    PlayKidnap,
    Row,
    is_right,
    kidnaps_in_play,
    play_rate,
    play_row,
)
from touchline.experiments.progress import computed, follow
from touchline.experiments.result import ExperimentResult, Headline, rate, spread
from touchline.experiments.scenes import (
    BLUE,
    FIELD,
    RED,
    field_axes,
    new_figure,
    random_place,
    the_camera,
    the_views,
)
from touchline.field import FieldModel, open_field
from touchline.geometry import Pose, wrap_angle
from touchline.systems import RobotSetup, open_system, paper_settings
from touchline.systems.nubot_mcl import NubotMcl
from touchline.systems.nubot_mti import NubotMti
from touchline.types import Frame, LinePoints, Observation, Prior, Samples, Status, empty_points

PERIOD_S = 0.1
SPEED_M_S = 0.3
BEFORE = 6  # frames at the old place
COVERED = 3  # covered images while the robot is carried, as in the papers
PER_SEED = 40


@dataclass(frozen=True, eq=False, slots=True)
class Kidnap:
    """One kidnap. waited: frames at the new place until it was no longer tracked as if nothing was; None: it never was.

    right (CYCLES,): whether the robot was tracked within 30 cm and 10 degrees in each frame from the first one that
    shows the new place. found: its pose after the tenth, beside the true one.
    """

    old: Pose
    new: Pose
    waited: int | None
    right: npt.NDArray[np.bool_]
    found: Pose
    truth: Pose

    @property
    def success(self) -> bool:
        """Whether it was right at the tenth frame."""
        return bool(self.right[WITHIN - 1])

    @property
    def cycles(self) -> int | None:
        """Frames until it was right for the first time."""
        return int(np.argmax(self.right)) + 1 if self.right.any() else None


class Carried:
    """A robot that drives slowly ahead, is carried, and drives on; wheels and gyro feel only the driving."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.index = 0
        self.odometry = Pose(0.0, 0.0, 0.0)

    def frame(self, pose: Pose, compass_error_rad: float, covered: bool) -> Frame:
        """The next frame, seen from a pose: line points, odometry with 2 % of noise, gyro, a compass with 0.5°."""
        points: LinePoints = empty_points() if covered else the_views().observe(pose, self.rng)
        stamp_ns = np.array([round(1e9 * PERIOD_S * self.index)], dtype=np.int64)
        compass = pose.heading + compass_error_rad + math.radians(0.5) * self.rng.standard_normal()
        self.index += 1
        return Frame(
            int(stamp_ns[0]),
            observation=Observation(int(stamp_ns[0]), points),
            odometry=Samples(stamp_ns, np.array([self.odometry])),
            gyro=Samples(stamp_ns, 0.002 * self.rng.standard_normal((1, 3))),
            compass=Samples(stamp_ns, np.array([[wrap_angle(compass)]])),
        )

    def drive(self, pose: Pose) -> Pose:
        """One image period ahead; returns the new true pose."""
        step_m = SPEED_M_S * PERIOD_S
        felt = Pose(step_m * (1.0 + 0.02 * self.rng.standard_normal()), 0.0, 0.002 * self.rng.standard_normal())
        self.odometry = self.odometry.compose(felt)
        return pose.compose(Pose(step_m, 0.0, 0.0))


def kidnap(
    system_name: str,
    field: FieldModel,
    old: Pose,
    new: Pose,
    error_rad: float,
    covered: int,
    seed: Sequence[int],
    paper: bool = False,
) -> Kidnap:
    """Track at the old place, carry to the new one with so many covered images, count frames from the first one there.

    error_rad: of the compass at the new place; tracking had corrected it at the old one. paper: in its own form.
    """
    rng = np.random.default_rng(seed)
    system = _system(system_name, field, rng, paper)
    system.reset(Prior(pose=old))
    robot = Carried(rng)
    pose = old
    for _ in range(BEFORE):
        system.step(robot.frame(pose, 0.0, covered=False))
        pose = robot.drive(pose)
    pose = new
    before = system.failure.failures
    noticed = [
        system.step(robot.frame(pose, error_rad, covered=True)).status is not Status.TRACKING for _ in range(covered)
    ]
    waited = 0 if any(noticed) or system.failure.failures > before else None
    right = []
    found, truth = system.tracker.filter.pose, pose
    for number in range(CYCLES):
        estimate = system.step(robot.frame(pose, error_rad, covered=False))
        if waited is None and (estimate.status is not Status.TRACKING or system.failure.failures > before):
            waited = number
        right.append(is_right(estimate, pose))
        if number == WITHIN - 1:
            found, truth = estimate.pose, pose
        pose = robot.drive(pose)
    return Kidnap(old, new, waited, np.array(right), found, truth)


def _system(name: str, field: FieldModel, rng: np.random.Generator, paper: bool) -> NubotMti | NubotMcl:
    """The system that is examined, with its parts at hand: how often it has failed is not in its estimates."""
    system = open_system(name, RobotSetup(field, the_camera()), paper_settings(name) if paper else None, rng)
    assert isinstance(system, NubotMti | NubotMcl)
    return system


def random_kidnaps(system_name: str, seed: int, error_deg: float, covered: int, paper: bool = False) -> list[Kidnap]:
    """So many kidnaps per seed between random places 2 m apart or more; the compass errs by ± error_deg."""
    field = open_field(FIELD)
    rng = np.random.default_rng([seed, 9])
    done: list[Kidnap] = []
    while len(done) < PER_SEED:
        old, new = random_place(field, rng, 0.5), random_place(field, rng)
        if old.distance_to(new) < 2.0:
            continue
        error = math.radians(error_deg) * float(rng.choice([-1.0, 1.0]))
        of_seed = (seed, len(done), round(10 * error_deg))
        done.append(kidnap(system_name, field, old, new, error, covered, of_seed, paper))
    return done


Condition = tuple[float, int]  # the compass's error (degrees), covered images
Runs = dict[Condition, list[list[Kidnap]]]


def _all_runs(system: str, conditions: Sequence[Condition], seeds: int) -> tuple[Runs, list[Row]]:
    """Of each condition and seed the random kidnaps of a lone robot as designed; their rows."""
    ours: Runs = {condition: [] for condition in conditions}
    paper: Runs = {condition: [] for condition in conditions}
    tasks = [(system, seed, condition) for condition in conditions for seed in range(seeds)]
    for (_, _, condition), found in zip(tasks, computed(_random, tasks, "runs of kidnaps"), strict=True):
        ours[condition].append(found[0])
        paper[condition].append(found[1])
    return ours, [
        _summary(f"alone, as designed, compass off by {error:g}°, {_covering(covered)}", ours[error, covered],
                 paper[error, covered])
        for error, covered in conditions
    ]  # fmt: skip


def _random(task: tuple[str, int, Condition]) -> tuple[list[Kidnap], list[Kidnap]]:
    """Ours, and the paper's form."""
    system, seed, condition = task
    return random_kidnaps(system, seed, *condition), random_kidnaps(system, seed, *condition, paper=True)


def _in_play(system: str, seeds: int) -> tuple[dict[int, list[PlayKidnap]], list[Row]]:
    """By covered images the kidnaps in matches of robots as built; their rows."""
    found, rows = {}, []
    for covered in (COVERED, 0):
        tasks = [(system, seed, covered) for seed in range(seeds)]
        matches = list(computed(_match, tasks, f"matches with kidnaps {_covering(covered)}"))
        ours, paper, ideal = ([one for match in matches for one in match[form]] for form in range(3))
        found[covered] = ours
        rows.append(play_row(f"in play, {_covering(covered)}", ours, paper, ideal))
    return found, rows


def _match(task: tuple[str, int, int]) -> tuple[list[PlayKidnap], list[PlayKidnap], list[PlayKidnap]]:
    """Ours, the paper's form, the ideal robot."""
    return kidnaps_in_play(*task), kidnaps_in_play(*task, paper=True), kidnaps_in_play(*task, ideal=True)


def lu2013_kidnap(seeds: int) -> ExperimentResult:
    """In play; then figure 9's two kidnaps and random ones with compasses that err by 5, 10 and 20 degrees."""
    play, rows = _in_play("nubot-mcl", seeds)
    conditions = [(5.0, COVERED), (10.0, COVERED), (20.0, COVERED), (5.0, 0)]
    runs, alone = _all_runs("nubot-mcl", conditions, seeds)
    field = open_field(FIELD)
    pairs = [(Pose(-6.0, -3.0, 0.5), Pose(5.5, 3.5, 2.5)), (Pose(6.0, -4.0, -2.0), Pose(-3.0, 2.5, 1.0))]
    shown = [kidnap("nubot-mcl", field, a, b, math.radians(5.0), COVERED, (0, k)) for k, (a, b) in enumerate(pairs)]
    return ExperimentResult(
        "lu2013-kidnap",
        f"Figure 9 of Lu et al. 2013: kidnapped robots find back by particles; {PER_SEED} random kidnaps per seed",
        seeds,
        COLUMNS,
        (*rows, *alone),
        Headline("kidnaps in play right 10 frames after: covered; in full view", "2 of 2 shown",
                 f"{play_rate(play[COVERED])}; {play_rate(play[0])}"),
        _NOTES,
        (
            ("figure9", _field_figure(field, shown)),
            ("curve", _curve_figure({f"{e:g}°, {_covering(c)}": runs[e, c] for e, c in conditions})),
        ),
    )  # fmt: skip


def xiong_kidnap(seeds: int) -> ExperimentResult:
    """Figure 8's five pairs at crossings of lines, kidnaps in play, and random ones."""
    field = open_field(FIELD)
    shown = []
    places = _crossing_places(field)
    for k in follow(range(5), "kidnaps between crossings"):
        old, new = places[2 * k], places[2 * k + 1]
        shown.append(kidnap("nubot-mti", field, old, new, math.radians(3.0), COVERED, (8, k)))
    pairs = [
        (f"alone, as designed, {'BDFHJ'[k]} → {'CEGIK'[k]}: ({one.new.x:.2f}, {one.new.y:.2f}) m", "–", "found", "–",
         f"{100 * one.found.distance_to(one.truth):.1f} cm off" if one.success else "not found", str(one.cycles),
         str(one.cycles), "–", "–", "–")
        for k, one in enumerate(shown)
    ]  # fmt: skip
    play, rows = _in_play("nubot-mti", seeds)
    _, alone = _all_runs("nubot-mti", [(5.0, COVERED), (20.0, COVERED), (5.0, 0)], seeds)
    return ExperimentResult(
        "xiong-kidnap",
        f"Figure 8 of Xiong et al.: five kidnaps between crossings of lines, and {PER_SEED} random ones per seed",
        seeds,
        COLUMNS,
        (*rows, *pairs, *alone),
        Headline("kidnaps in play right within 10 frames: covered; in full view", "5 of 5 shown",
                 f"{play_rate(play[COVERED])}; {play_rate(play[0])}; between crossings "
                 f"{sum(one.success for one in shown)} of 5"),
        _NOTES,
        (("figure8", _field_figure(field, shown)),),
    )  # fmt: skip


_NOTES = (
    f"Right: tracked within {100 * RIGHT_M:.0f} cm and 10°. Frames count from the first at the new place; rates "
    f"have Wilson's interval of 95 %. Covered: {COVERED} images show nothing while the robot is carried; in full view "
    "the system has to notice by itself.",
    f"In play: the scenario match at the observation level, robots as built, one per seed, eight others about; carried "
    f"anywhere every {EVERY_S:g} s. The compass errs as simulated, by 5° (root mean square, drift, places). A kidnap "
    "counts if the robot was right before it; the last column says how many did not. Beside it the same matches with "
    "the system's preset `paper`, and with ideal robots.",
    "Alone, as designed: observation level, the papers' mirror, nobody else, 0.3 m/s with 2 % of odometry noise. The "
    "compass is right at the old place and errs by that angle, to one side or the other, at the new one. One that is "
    "never noticed counts as right only if the robot is tracked at its new place all the same: matching has led it "
    "there.",
)


def _covering(covered: int) -> str:
    return "covered" if covered else "in full view"


def _rate(runs: Sequence[Sequence[Kidnap]]) -> str:
    """Share right at the tenth frame, over the seeds' runs."""
    every = [one.success for run in runs for one in run]
    return rate(sum(every), len(every))


def _summary(name: str, runs: Sequence[Sequence[Kidnap]], paper: Sequence[Sequence[Kidnap]]) -> Row:
    """A row over the seeds' runs."""
    every = [one for run in runs for one in run]
    waited = [one.waited for one in every if one.waited is not None]
    unnoticed = len(every) - len(waited)
    unwell = sum(not one.success for one in every if one.waited is None)
    noticed = f"median {np.median(waited):.0f}, longest {max(waited)}" if waited else "never"
    cycles = [one.cycles for one in every if one.cycles is not None]
    return (
        name,
        noticed + (f"; {unnoticed} of {len(every)} never, {unwell} of them wrong" if unnoticed else ""),
        "–",
        _rate(paper),
        _rate(runs),
        spread([float(np.mean([one.cycles or CYCLES for one in run])) for run in runs]),
        f"{max(cycles)}" if cycles else "–",
        *["–"] * 3,
    )


def _crossing_places(field: FieldModel) -> list[Pose]:
    """Ten crossings of lines, far apart in turn, facing various ways."""
    points = sorted({(round(c.x, 3), round(c.y, 3)) for c in field.crossings if not c.curved})
    chosen = [points[k] for k in np.linspace(0, len(points) - 1, 10).astype(int)]
    order = [0, 5, 6, 1, 2, 7, 8, 3, 4, 9]
    return [Pose(chosen[k][0], chosen[k][1], wrap_angle(0.7 * i)) for i, k in enumerate(order)]


def _field_figure(field: FieldModel, kidnaps: Sequence[Kidnap]) -> Figure:
    """As the papers' figures: arrows from place to place, red where the robot found itself, blue where it was."""
    figure, (axes,) = new_figure(width_in=8.0, height_in=5.8)
    field_axes(axes, field)
    letters = iter("ABCDEFGHIJKLMN" if len(kidnaps) < 5 else "BCDEFGHIJK")
    for one in kidnaps:
        for place in (one.old, one.new):
            axes.annotate(next(letters), (place.x, place.y), xytext=(7, 7), textcoords="offset points", fontsize=10)
        axes.annotate("", (one.new.x, one.new.y), (one.old.x, one.old.y), arrowprops={"arrowstyle": "->", "alpha": 0.5})
        axes.plot(one.truth.x, one.truth.y, "o", color=BLUE, markersize=9, zorder=3)
        axes.plot(one.found.x, one.found.y, "o", color=RED, markersize=5, zorder=4)
    return figure


def _curve_figure(kidnaps: dict[str, list[list[Kidnap]]]) -> Figure:
    figure, (axes,) = new_figure()
    lowest = 100.0
    for name, runs in kidnaps.items():
        shares = 100.0 * np.mean([one.right for run in runs for one in run], axis=0)
        axes.plot(np.arange(1, CYCLES + 1), shares, "o-", markersize=3, label=name)
        lowest = min(lowest, float(shares.min()))
    axes.set_xlabel("frames at the new place")
    axes.set_ylabel("right (%)")
    axes.set_ylim(max(0.0, 10.0 * math.floor(lowest / 10.0 - 0.5)), 101.0)
    axes.legend(frameon=False, title="compass off by")
    return figure
