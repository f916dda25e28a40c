"""lu2013-kidnap (figure 9) and xiong-kidnap (figure 8): the robot is carried elsewhere and finds back.

In play: a match among eight robots, in which the robot is carried elsewhere every few seconds.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from matplotlib.figure import Figure

from touchline.field import FieldModel, open_field
from touchline.geometry import BoolArray, Pose, wrap_angle
from touchline.published.nubot_mcl.system import NubotMcl
from touchline.published.nubot_mti.system import NubotMti
from touchline.systems import RobotSetup, open_system, paper_settings
from touchline.types import Estimate, Frame, LinePoints, Observation, Prior, Samples, Status
from touchline_lab.experiments.drives import FOOLED_FRAMES, NEAR_M, NEAR_RAD, driven, followed, longest
from touchline_lab.experiments.harness import (
    NONE,
    ExperimentResult,
    Headline,
    Row,
    follow,
    gathered,
    rate,
    seed_range,
    spread,
)
from touchline_lab.experiments.scenes import BLUE, FIELD, RED, new_figure, random_place, the_camera, the_views

PERIOD_S, SPEED_M_S = 0.1, 0.3
BEFORE = 6  # frames at the old place
COVERED = 3  # covered images while the robot is carried, as in the papers
PER_SEED = 40
EVERY_S, SECONDS = 4.0, 100.0  # in play
CYCLES, WITHIN = 15, 10
COLUMNS = (
    "kidnaps", "noticed after (frames)", "paper", "right at frame 10: its form here", "right at frame 10",
    "frames until right", "longest", "tracked though wrong for more than 5 frames", "ideal: right at frame 10",
    "wrong before: ours, its form, ideal",
)  # fmt: skip
OURS, PAPER, IDEAL = "ours", "its form", "ideal"


@dataclass(frozen=True, eq=False, slots=True)
class Kidnap:
    """One kidnap. waited: frames at the new place until it was no longer tracked as if nothing was; None: it never was.

    right (CYCLES,): whether the robot was tracked within 30 cm and 10 degrees in each frame from the first one that
    shows the new place. found: its pose after the tenth, beside the true one.
    """

    old: Pose
    new: Pose
    waited: int | None
    right: BoolArray
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
        points: LinePoints = LinePoints.none() if covered else the_views().observe(pose, self.rng)
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
    places: tuple[Pose, Pose],
    error_rad: float,
    covered: int,
    seed: Sequence[int],
    paper: bool = False,
) -> Kidnap:
    """Track at the old place, carry to the new one with so many covered images, count frames from the first one there.

    places: old and new, on the 18 x 12 m field. error_rad: of the compass at the new place; tracking had corrected it
    at the old one. paper: in its own form.
    """
    rng = np.random.default_rng(seed)
    setup, settings = RobotSetup(open_field(FIELD), the_camera()), paper_settings(system_name) if paper else None
    system = open_system(system_name, setup, settings, rng)
    assert isinstance(system, NubotMti | NubotMcl)  # how often it has failed is not in its estimates
    old, pose = places
    system.reset(Prior(pose=old))
    robot, here = Carried(rng), old
    for _ in range(BEFORE):
        system.step(robot.frame(here, 0.0, covered=False))
        here = robot.drive(here)
    before = system.following.failure.failures
    hidden = [system.step(robot.frame(pose, error_rad, covered=True)) for _ in range(covered)]
    noticed = [system.following.failure.failures > before or any(one.status is not Status.TRACKING for one in hidden)]
    right = []
    found, truth = system.following.tracker.filter.pose, pose
    for number in range(CYCLES):
        estimate = system.step(robot.frame(pose, error_rad, covered=False))
        noticed.append(estimate.status is not Status.TRACKING or system.following.failure.failures > before)
        right.append(_is_right(estimate, pose))
        if number == WITHIN - 1:
            found, truth = estimate.pose, pose
        pose = robot.drive(pose)
    waited = max(noticed.index(True) - 1, 0) if any(noticed) else None
    return Kidnap(*places, waited, np.array(right), found, truth)


def _is_right(estimate: Estimate, truth: Pose) -> bool:
    """Whether a robot is tracked within 30 cm and 10 degrees of the truth."""
    turned = abs(wrap_angle(estimate.pose.heading - truth.heading))
    near = estimate.pose.distance_to(truth) < NEAR_M and turned < NEAR_RAD
    return near and estimate.status is Status.TRACKING


def random_kidnaps(system_name: str, seed: int, error_deg: float, covered: int, paper: bool = False) -> list[Kidnap]:
    """So many kidnaps per seed between random places 2 m apart or more; the compass errs by ± error_deg."""
    field = open_field(FIELD)
    rng = np.random.default_rng([seed, 9])
    done: list[Kidnap] = []
    while len(done) < PER_SEED:
        places = random_place(field, rng, 0.5), random_place(field, rng)
        if places[0].distance_to(places[1]) < 2.0:
            continue
        error = math.radians(error_deg) * float(rng.choice([-1.0, 1.0]))
        of_seed = (seed, len(done), round(10 * error_deg))
        done.append(kidnap(system_name, places, error, covered, of_seed, paper))
    return done


Condition = tuple[float, int]  # the compass's error (degrees), covered images


def _random(task: tuple[str, Condition, int]) -> dict[tuple[Condition, str], list[Kidnap]]:
    """Ours, and the paper's form."""
    system, condition, seed = task
    return {(condition, form): random_kidnaps(system, seed, *condition, form == PAPER) for form in (OURS, PAPER)}


def _alone(
    system: str, conditions: Sequence[Condition], seeds: int
) -> tuple[dict[tuple[Condition, str], list[list[Kidnap]]], list[Row]]:
    """Of each condition and seed the random kidnaps of a lone robot as designed; their rows."""
    tasks = [(system, condition, seed) for condition in conditions for seed in seed_range(seeds)]
    runs = gathered(_random, tasks, "runs of kidnaps")
    return runs, [
        _row(f"alone, as designed, compass off by {error:g}°, {_covering(covered)}", runs[(error, covered), OURS],
             runs[(error, covered), PAPER])
        for error, covered in conditions
    ]  # fmt: skip


@dataclass(frozen=True, eq=False, slots=True)
class PlayKidnap:
    """What a system said in each frame (CYCLES,) from the first at the new place on: right; tracked though wrong.

    before: whether it was right in the last frame before; only then a kidnap counts.
    """

    before: bool
    right: BoolArray
    fooled: BoolArray


def kidnaps_in_play(system: str, seed: int, covered: int, ideal: bool = False, paper: bool = False) -> list[PlayKidnap]:
    """The kidnaps of one match, each with so many covered images; a robot as built or ideal, paper: in its own form."""
    changes = [f"disturbances.kidnap_every_s={EVERY_S:g}", f"disturbances.covered_images={covered}"]
    drive = driven("match", seed, SECONDS, *changes, *(["ideal=true"] if ideal else []))
    track = followed(system, drive, seed, paper_settings(system) if paper else None)
    right, fooled = track.found, track.tracking & ~track.found
    first = np.searchsorted(drive.times_s, drive.times_of("kidnap"))
    return [
        PlayKidnap(bool(right[k - covered - 1]), right[k : k + CYCLES], fooled[k : k + CYCLES])
        for k in first
        if k + CYCLES <= len(right)
    ]


def _match(task: tuple[str, int, int]) -> dict[tuple[int, str], list[PlayKidnap]]:
    forms = {OURS: (False, False), PAPER: (False, True), IDEAL: (True, False)}
    return {(task[2], form): kidnaps_in_play(*task, *how) for form, how in forms.items()}


def _in_play(system: str, seeds: int) -> tuple[list[str], list[Row]]:
    """Kidnaps in matches, covered and in full view: how many are right, and their rows."""
    rates, rows = [], []
    for covered in (COVERED, 0):
        tasks = [(system, seed, covered) for seed in seed_range(seeds)]
        matches = gathered(_match, tasks, f"matches with kidnaps {_covering(covered)}")
        ours, paper, ideal = (list(chain(*matches[covered, form])) for form in (OURS, PAPER, IDEAL))
        rates.append(_play_rate(ours))
        rows.append(_play_row(f"in play, {_covering(covered)}", ours, paper, ideal))
    return rates, rows


def _play_row(name: str, ours: Sequence[PlayKidnap], paper: Sequence[PlayKidnap], ideal: Sequence[PlayKidnap]) -> Row:
    """The kidnaps of robots that were right before, ours and the paper's form as built, ideal."""
    kidnaps = [one for one in ours if one.before]
    until = [int(np.argmax(one.right)) + 1 for one in kidnaps if one.right.any()]
    fooled = sum(longest(one.fooled) > FOOLED_FRAMES for one in kidnaps)
    last = f"{max(until, default=0)}" if len(until) == len(kidnaps) else f"over {CYCLES}"
    left_out = ", ".join(str(sum(not one.before for one in some)) for some in (ours, paper, ideal))
    return (
        name, NONE, NONE, _play_rate(paper), _play_rate(ours), spread(until), last, f"{fooled} of {len(kidnaps)}",
        _play_rate(ideal), left_out,
    )  # fmt: skip


def _play_rate(kidnaps: Sequence[PlayKidnap]) -> str:
    """Share right at the tenth frame, of those that counted."""
    counted = [bool(one.right[WITHIN - 1]) for one in kidnaps if one.before]
    return rate(sum(counted), len(counted))


def lu2013_kidnap(seeds: int) -> ExperimentResult:
    """In play; then figure 9's two kidnaps and random ones with compasses that err by 5, 10 and 20 degrees."""
    rates, rows = _in_play("nubot-mcl", seeds)
    conditions = [(5.0, COVERED), (10.0, COVERED), (20.0, COVERED), (5.0, 0)]
    runs, alone = _alone("nubot-mcl", conditions, seeds)
    pairs = [(Pose(-6.0, -3.0, 0.5), Pose(5.5, 3.5, 2.5)), (Pose(6.0, -4.0, -2.0), Pose(-3.0, 2.5, 1.0))]
    shown = [kidnap("nubot-mcl", pair, math.radians(5.0), COVERED, (0, k)) for k, pair in enumerate(pairs)]
    return ExperimentResult(
        f"Figure 9 of Lu et al. 2013: kidnapped robots find back by particles; {PER_SEED} random kidnaps per seed",
        COLUMNS,
        (*rows, *alone),
        Headline("kidnaps in play right 10 frames after: covered; in full view", "2 of 2 shown", "; ".join(rates)),
        _NOTES,
        (
            ("figure9", _field_figure(open_field(FIELD), shown)),
            ("curve", _curve_figure({f"{e:g}°, {_covering(c)}": runs[(e, c), OURS] for e, c in conditions})),
        ),
    )


def xiong_kidnap(seeds: int) -> ExperimentResult:
    """Figure 8's five pairs at crossings of lines, kidnaps in play, and random ones."""
    field = open_field(FIELD)
    places = _crossing_places(field)
    pairs = list(zip(places[::2], places[1::2], strict=True))
    shown = [
        kidnap("nubot-mti", pairs[k], math.radians(3.0), COVERED, (8, k))
        for k in follow(range(len(pairs)), "kidnaps between crossings")
    ]
    rows = [
        (f"alone, as designed, {'BDFHJ'[k]} → {'CEGIK'[k]}: ({one.new.x:.2f}, {one.new.y:.2f}) m", NONE, "found", NONE,
         f"{100 * one.found.distance_to(one.truth):.1f} cm off" if one.success else "not found", str(one.cycles),
         str(one.cycles), *[NONE] * 3)
        for k, one in enumerate(shown)
    ]  # fmt: skip
    rates, play = _in_play("nubot-mti", seeds)
    _, alone = _alone("nubot-mti", [(5.0, COVERED), (20.0, COVERED), (5.0, 0)], seeds)
    return ExperimentResult(
        f"Figure 8 of Xiong et al.: five kidnaps between crossings of lines, and {PER_SEED} random ones per seed",
        COLUMNS,
        (*play, *rows, *alone),
        Headline("kidnaps in play right within 10 frames: covered; in full view", "5 of 5 shown",
                 f"{'; '.join(rates)}; between crossings {sum(one.success for one in shown)} of 5"),
        _NOTES,
        (("figure8", _field_figure(field, shown)),),
    )  # fmt: skip


_NOTES = (
    f"Right: tracked within {100 * NEAR_M:.0f} cm and 10°. Frames count from the first at the new place; rates "
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


def _right(runs: Sequence[Sequence[Kidnap]]) -> str:
    """Share right at the tenth frame, over the seeds' runs."""
    every = [one.success for run in runs for one in run]
    return rate(sum(every), len(every))


def _row(name: str, runs: Sequence[Sequence[Kidnap]], paper: Sequence[Sequence[Kidnap]]) -> Row:
    """A row over the seeds' runs."""
    every = [one for run in runs for one in run]
    waited = [one.waited for one in every if one.waited is not None]
    unnoticed = [one.success for one in every if one.waited is None]
    noticed = f"median {np.median(waited):.0f}, longest {max(waited)}" if waited else "never"
    if unnoticed:
        noticed += f"; {len(unnoticed)} of {len(every)} never, {unnoticed.count(False)} of them wrong"
    until = spread([float(np.mean([one.cycles or CYCLES for one in run])) for run in runs])
    cycles = [one.cycles for one in every if one.cycles is not None]
    return name, noticed, NONE, _right(paper), _right(runs), until, f"{max(cycles)}" if cycles else NONE, *[NONE] * 3


def _crossing_places(field: FieldModel) -> list[Pose]:
    """Ten crossings of lines, far apart in turn, facing various ways."""
    points = sorted({(round(c.x, 3), round(c.y, 3)) for c in field.crossings if not c.curved})
    chosen = [points[k] for k in np.linspace(0, len(points) - 1, 10).astype(int)]
    order = [0, 5, 6, 1, 2, 7, 8, 3, 4, 9]
    return [Pose(chosen[k][0], chosen[k][1], wrap_angle(0.7 * i)) for i, k in enumerate(order)]


def _field_figure(field: FieldModel, kidnaps: Sequence[Kidnap]) -> Figure:
    """As the papers' figures: arrows from place to place, red where the robot found itself, blue where it was."""
    figure, (axes,) = new_figure(size_in=(8.0, 5.8), field=field)
    letters = iter("ABCDEFGHIJKLMN" if len(kidnaps) < 5 else "BCDEFGHIJK")
    for one in kidnaps:
        for place in (one.old, one.new):
            axes.annotate(next(letters), (place.x, place.y), xytext=(7, 7), textcoords="offset points", fontsize=10)
        axes.annotate("", (one.new.x, one.new.y), (one.old.x, one.old.y), arrowprops={"arrowstyle": "->", "alpha": 0.5})
        axes.plot(one.truth.x, one.truth.y, "o", color=BLUE, markersize=9, zorder=3)
        axes.plot(one.found.x, one.found.y, "o", color=RED, markersize=5, zorder=4)
    return figure


def _curve_figure(kidnaps: Mapping[str, Sequence[Sequence[Kidnap]]]) -> Figure:
    figure, (axes,) = new_figure(labels=("frames at the new place", "right (%)"))
    curves = {name: 100.0 * np.mean([o.right for run in runs for o in run], axis=0) for name, runs in kidnaps.items()}
    for name, shares in curves.items():
        axes.plot(np.arange(1, CYCLES + 1), shares, "o-", markersize=3, label=name)
    lowest = min(float(shares.min()) for shares in curves.values())
    axes.set_ylim(max(0.0, 10.0 * math.floor(lowest / 10.0 - 0.5)), 101.0)
    axes.legend(frameon=False, title="compass off by")
    return figure
