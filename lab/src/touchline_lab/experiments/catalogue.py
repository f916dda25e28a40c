"""The catalogue of faults: which there are, on which robots they are laid, when they begin and how long they last."""

import math
import zlib
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np

from touchline.geometry import Pose
from touchline.systems import RobotSetup
from touchline.types import Prior
from touchline_lab.experiments import injections
from touchline_lab.experiments import schulz_runs as humanoids
from touchline_lab.experiments.clutter import (
    all_of,
    anew,
    bars,
    blob,
    false_crossings,
    false_line,
    false_lines,
    nets,
    next_field,
    one_line,
    riding,
    ring,
    robots,
    shown,
    standing,
    thinned,
    uniform,
)
from touchline_lab.experiments.drives import Drive, drive_of, driven
from touchline_lab.experiments.injections import (
    Change,
    Fault,
    both,
    clock,
    compass,
    during,
    elsewhere,
    head,
    odometry,
    similar,
    stepped,
)
from touchline_lab.simulation.observation.feature_noise import PINHOLE_FEATURES
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

SECONDS, AFTER_S = 30.0, 10.0  # a drive; what is left of it after a fault of a stated length
START_S = (4.0, 8.0)  # when a fault begins
MORE_S = 30.0  # so much more of a drive is simulated: into it robots are carried
ROBOTS = 10
MIRROR, FEATURES, CLOUD = "mirror", "humanoid", "humanoid, points"

Lasts: TypeAlias = tuple[float, float] | None
ALWAYS: Lasts = None  # to the end; of every other robot from the first image on
PASSING: Lasts = (0.3, 60.0)  # a time between, even by its logarithm
EVENT: Lasts = (1.0, 3.0)
SHORT: Lasts = (0.3, 3.0)
THREE_FALLS: Lasts = (21.0, 21.0)


class Robot(NamedTuple):
    """A robot as built. start_known: whether it is told its start. moves: else it stands, or walks in place."""

    scenario: str
    changes: tuple[str, ...] = ()
    start_known: bool = True
    moves: bool = True


_HALF, _SLOW = "camera.black_sectors_deg=[[0,180]]", "motion.speed_m_s=0.5"
_KID, _HSL, _INDOOR, _FAST = "humanoid-kid-9x6", "hsl-s-9x6", "indoor-9x6", "motion.speed_m_s=0.45"
# what a robot that stands does not use, as if it had not been set
_UNUSED = ("motion.speed_m_s=1.2", "motion.acceleration_m_s2=2.0", "motion.turn_rad_s=2.0")
WALKERS = (
    Robot(_HSL), Robot(_KID), Robot(_HSL, (_FAST,)), Robot(_KID, (_FAST,)), Robot(_INDOOR),
    Robot(_HSL, ("motion.speed_m_s=0.12",)), Robot(_KID), Robot(_HSL), Robot(_INDOOR, (_FAST,)),
    Robot(_KID, ("motion.kind=walk-in-place", "motion.dwell_s=0", *_UNUSED), moves=False),
)  # fmt: skip
KINDS_OF_ROBOTS = {
    MIRROR: (
        Robot("straight-tracks"), Robot("match", start_known=False), Robot("match", (_SLOW,)),
        Robot("match", (_HALF,), start_known=False), Robot("tour-20"),
        Robot("straight-tracks", (_SLOW,), start_known=False), Robot("match"), Robot("straight-tracks", (_HALF,)),
        Robot("match", ("motion.speed_m_s=1.5",), start_known=False),
        Robot("match", ("motion.kind=stand", *_UNUSED), moves=False),
    ),
    FEATURES: WALKERS,
    CLOUD: WALKERS,
}  # fmt: skip


@lru_cache(maxsize=4)
def driven_by(kind: str, number: int, seed: int, seconds: float) -> Drive:
    """The drive of a robot of a kind."""
    robot = KINDS_OF_ROBOTS[kind][number % ROBOTS]
    if kind == MIRROR:
        drive = driven(robot.scenario, seed, seconds, *robot.changes)
    elif kind == FEATURES:
        drive = humanoids.walk(robot.scenario, humanoids.AS_BUILT, seed, seconds, robot.changes)
    else:
        drive = walk_of_points(robot.scenario, seed, seconds, robot.changes)
    start = humanoids.start_about(Pose(*drive.truth[0].tolist()), seed)
    return replace(drive, prior=Prior(start) if robot.start_known else None)


def walk_of_points(field: str, seed: int, seconds: float, changes: Sequence[str] = ()) -> Drive:
    """The walk of a humanoid of which a detector of its own finds line points."""
    among = (f"field={field}", *humanoids.AS_BUILT.changes, *changes)
    run = Simulation(open_scenario(humanoids.SCENARIO, seed, seconds, among), "points")
    return drive_of(run, RobotSetup(run.field, height_m=PINHOLE_FEATURES.height_m))


class Kind(NamedTuple):
    """A kind of fault, on a kind of robots. family: what is at fault."""

    robots: str
    family: str
    name: str
    change: Change
    lasts_s: Lasts

    @property
    def title(self) -> str:
        """Its name, and that of the robots."""
        return f"{self.robots}: {self.name}"

    def drawn(self, number: int, seed: int) -> Fault:
        """The fault as it befalls a robot."""
        rng = self.rng(number, seed)
        start_s = float(rng.uniform(*START_S))
        if self.lasts_s is None:
            return Fault(self.title, start_s if number % 2 else 0.0, math.inf, self.change)
        lasts_s = math.exp(rng.uniform(*np.log(self.lasts_s)))
        return Fault(self.title, start_s, start_s + lasts_s, self.change)

    def rng(self, number: int, seed: int) -> np.random.Generator:
        """What is random in it on a robot."""
        return np.random.default_rng([zlib.crc32(self.title.encode()), number, seed])


Case: TypeAlias = tuple[Kind, ...]  # faults that are laid into the same drives


class Laid(NamedTuple):
    """A robot's drive without the faults and with them, and from when until when (s) one of them lasts."""

    clean: Drive
    faulty: Drive
    start_s: float
    end_s: float


def laid(case: Case, number: int, seed: int) -> Laid:
    """A case on a robot."""
    fixed_s = max(0.0 if kind.lasts_s is None else kind.lasts_s[0] for kind in case)
    seconds = max(SECONDS, START_S[1] + fixed_s + AFTER_S)
    drive = driven_by(case[0].robots, number, seed, seconds + MORE_S)
    clean, drawn = drive.until(seconds), [kind.drawn(number, seed) for kind in case]
    for kind, fault in zip(case, drawn, strict=True):
        drive = fault.laid_into(drive, kind.rng(number, seed + 1))
    ends = drive.times_s >= seconds
    end = int(np.argmax(ends)) if ends.any() else len(clean.frames)
    faulty = replace(drive, frames=drive.frames[:end], truth=drive.truth[:end])
    return Laid(clean, faulty, min(fault.start_s for fault in drawn), max(fault.end_s for fault in drawn))


def pairs(count: int, robots: str, seed: int = 0) -> list[Case]:
    """Pairs of faults of different families on a kind of robots; those of the clock come last: the others need it."""
    rng = np.random.default_rng([seed, 25])
    kinds = [kind for kind in CATALOGUE if kind.robots == robots and kind.name != "none"]
    found: list[Case] = []
    while len(found) < count:
        one, other = (kinds[int(k)] for k in rng.choice(len(kinds), 2, replace=False))
        if one.family != other.family:
            found.append(tuple(sorted((one, other), key=lambda kind: kind.family == "clock")))
    return found


def _pan(at_s: float, start_s: float) -> float:
    return math.radians(60.0) * math.sin(2.0 * math.pi * 0.125 * (at_s - start_s))


def _nod(at_s: float, start_s: float) -> float:
    return math.radians(8.0) * math.sin(2.0 * math.pi * 0.3 * (at_s - start_s))


def _lower(angle_deg: float) -> Change:
    return head(nod_rad=lambda at_s, start_s: math.radians(angle_deg))


def _late_head(late_s: float) -> Change:
    return head(
        lambda at_s, start_s: _pan(at_s, start_s) - _pan(at_s - late_s, start_s),
        lambda at_s, start_s: _nod(at_s, start_s) - _nod(at_s - late_s, start_s),
    )


def _falls(seen: Change) -> Change:
    return injections.falls(3, 8.0, seen)


_ROBOTS_AND_NETS = shown(all_of(robots, nets), ratio=(0.2, 0.4))
_SPINNING = odometry((1.0, 1.0, 1.0), (2.0, 0.0, 0.0))
_HEAP, _FAR_HEAP = blob(1.0, 4.0), blob(20.0, 20.0)

Rows: TypeAlias = Sequence[tuple[str, str, Change, Lasts]]
"""Family, name, change, how long."""
_OF_ALL: Rows = (
    ("", "none", injections.both(), ALWAYS),
    ("odometry", "odometry turns the wrong way", odometry((1.0, 1.0, -1.0)), ALWAYS),
    ("odometry", "odometry goes the wrong way", odometry((-1.0, 1.0, 1.0)), ALWAYS),
    ("odometry", "odometry has all signs wrong", odometry((-1.0, -1.0, -1.0)), ALWAYS),
    ("odometry", "odometry × 1.3", odometry((1.3, 1.3, 1.3)), ALWAYS),
    ("odometry", "odometry frozen", odometry((0.0, 0.0, 0.0)), PASSING),
    ("odometry", "odometry missing", injections.dropped(1.0), PASSING),
    ("clock", "camera's clock 300 ms fast", stepped(0.3), ALWAYS),
    ("clock", "camera's clock 300 ms slow", stepped(-0.3), ALWAYS),
    ("image", "the same image with new stamps", injections.repeated, PASSING),
    ("image", "mirrored", similar(flipped=True), ALWAYS),
    ("image", "turned by 20°", similar(math.radians(20.0)), ALWAYS),
    ("field", "ranges × 1.1", similar(scale=1.1), ALWAYS),
    ("sight", "90 % of what is seen is dropped", thinned(lambda at, rng: rng.random(len(at)) >= 0.9), PASSING),
    ("sight", "camera covered", injections.unseen, PASSING),
    ("carried", "kidnapped", elsewhere(1.0, 9.0), EVENT),
    ("start", "wrong half told", injections.half_told, ALWAYS),
)
_OF_POINTS: Rows = (
    ("clutter", "a blob, standing, besides", shown(standing(_HEAP)), PASSING),
    ("clutter", "a blob, carried, instead", shown(riding(_HEAP), besides=False), PASSING),
    ("clutter", "uniform garbage, instead", shown(anew(uniform), besides=False), PASSING),
    ("clutter", "bars and cables, besides", shown(standing(bars)), PASSING),
    ("clutter", "20–40 % robots and nets", _ROBOTS_AND_NETS, ALWAYS),
)
_OF_MIRRORS: Rows = (
    ("odometry", "wheels spin, 2 m/s", _SPINNING, SHORT),
    ("odometry", "odometry × 1.15", odometry((1.15, 1.15, 1.15)), ALWAYS),
    ("odometry", "30 % of odometry dropped", injections.dropped(0.3), PASSING),
    ("gyro", "gyro turns the wrong way", injections.logged(injections.negated, "gyro"), ALWAYS),
    ("clock", "camera's clock 100 ms fast", stepped(0.1), ALWAYS),
    ("clock", "camera's clock 100 ms slow", stepped(-0.1), ALWAYS),
    ("clock", "camera's clock runs 3 % fast", clock(lambda since_s, rng: 0.03 * since_s), PASSING),
    ("clock", "camera's clock back an hour", stepped(-3600.0), PASSING),
    ("clock", "images 0–600 ms late at random", clock(lambda s, rng: rng.uniform(0.0, 0.6, len(s)), True), PASSING),
    ("clock", "stamps repeated", clock(lambda since_s, rng: -since_s), (0.3, 10.0)),
    ("clock", "stamps run backwards", clock(lambda since_s, rng: -2.0 * since_s), (0.3, 10.0)),
    ("sight", "1 Hz", injections.every(10), PASSING),
    ("image", "turned by 90°", similar(0.5 * math.pi), ALWAYS),
    ("image", "turned by 5°", similar(math.radians(5.0)), ALWAYS),
    ("image", "turned by 2°", similar(math.radians(2.0)), ALWAYS),
    ("image", "spinning, 0.5 rad/s", similar(rate_rad_s=0.5), PASSING),
    ("image", "camera 0.3 m farther ahead", injections.ahead(0.3), ALWAYS),
    ("field", "ranges × 0.9", similar(scale=0.9), ALWAYS),
    ("field", "ranges × 1.03", similar(scale=1.03), ALWAYS),
    ("field", "larger field told", injections.another_field("msl-22x14", "msl-18x12"), ALWAYS),
    ("field", "smaller field told", injections.another_field("hsl-m-14x9", "msl-18x12"), ALWAYS),
    ("field", "a neighbour field's lines only", shown(next_field, besides=False), PASSING),
    ("field", "a neighbour field's lines besides", shown(next_field), PASSING),
    ("sight", "half of the view covered", thinned(lambda at, rng: at[:, 1] > 0.0), PASSING),
    ("clutter", "a blob, standing, instead", shown(standing(_HEAP), besides=False), PASSING),
    ("clutter", "a blob, carried, besides", shown(riding(_HEAP)), PASSING),
    ("clutter", "a blob, carried, for a second", shown(riding(_HEAP), besides=False), (1.0, 1.0)),
    ("clutter", "a blob 20 m away, instead", shown(riding(_FAR_HEAP), besides=False), PASSING),
    ("clutter", "a ring of 1 m, instead", shown(riding(ring(1.0)), besides=False), PASSING),
    ("clutter", "a ring of 2 m, instead", shown(riding(ring(2.0)), besides=False), PASSING),
    ("clutter", "a ring of 1 m, besides", shown(riding(ring(1.0))), PASSING),
    ("clutter", "a ring of 2 m, besides", shown(riding(ring(2.0))), PASSING),
    ("clutter", "uniform garbage, besides", shown(anew(uniform)), PASSING),
    ("clutter", "all points at 10⁶ m", shown(anew(ring(1e6)), besides=False), PASSING),
    ("clutter", "bars and cables, instead", shown(standing(bars), besides=False), PASSING),
    ("clutter", "a false line, instead", shown(false_line, besides=False), PASSING),
    ("sight", "one line only", one_line, PASSING),
    ("compass", "compass turned for 1 s", injections.turned_compass, (1.0, 1.0)),
    ("compass", "compass turned for 10 s", injections.turned_compass, (10.0, 10.0)),
    ("compass", "compass turned for 60 s", injections.turned_compass, (60.0, 60.0)),
    ("compass", "compass turned for 120 s", injections.turned_compass, (120.0, 120.0)),
    ("compass", "compass turned at the start", injections.turned_compass, ALWAYS),
    ("compass", "compass stuck", injections.stuck_compass, PASSING),
    ("compass", "compass stuck for 60 s", injections.stuck_compass, (60.0, 60.0)),
    ("compass", "compass drifts, 5°/s", compass(lambda true, _, s, rng: true + math.radians(5.0) * s), PASSING),
    ("compass", "compass noisy", compass(lambda true, _, s, rng: true + rng.standard_normal(len(true))), PASSING),
    ("compass", "compass turned, camera covered", both(injections.turned_compass, injections.unseen), PASSING),
    ("odometry", "wheels spin, camera covered", both(_SPINNING, injections.unseen), SHORT),
    ("carried", "kidnapped, covered", elsewhere(1.0, 9.0, lifted=True), SHORT),
    ("carried", "shoved", elsewhere(0.2, 0.8), EVENT),
    ("compass", "kidnapped while the compass is turned",
     both(injections.turned_compass, during(0.5, 1.0, elsewhere(1.0, 9.0))), (8.0, 8.0)),
    ("compass", "kidnapped after the compass was turned",
     both(during(0.0, 0.75, injections.turned_compass), during(0.95, 1.0, elsewhere(1.0, 9.0))), (8.0, 8.0)),
)  # fmt: skip
_OF_WALKERS: Rows = (
    ("head", "head pans and nobody tells", head(_pan), ALWAYS),
    ("head", "head nods with the wrong sign", head(nod_rad=lambda at_s, start_s: 2.0 * _nod(at_s, start_s)), ALWAYS),
    ("head", "head pose frozen",
     head(lambda at_s, start_s: _pan(at_s + 1.0, start_s) - _pan(1.0, 0.0), _nod), PASSING),
    ("head", "head pose 150 ms late", _late_head(0.15), ALWAYS),
    ("head", "camera 3° lower", _lower(3.0), ALWAYS),
    ("head", "camera 5° lower", _lower(5.0), ALWAYS),
    ("head", "camera 5° higher", _lower(-5.0), ALWAYS),
    ("field", "larger field told", injections.another_field("humanoid-adult-14x9"), ALWAYS),
    ("field", "a similar field told", injections.another_field("hsl-s-9x6", "spl-9x6"), ALWAYS),
)  # fmt: skip
_OF_FEATURES: Rows = (
    ("carried", "three falls, garbage while lying", _falls(both(false_crossings(1.0), false_lines(4))), THREE_FALLS),
    ("clutter", "30 % of the crossings are none", false_crossings(0.3), PASSING),
    ("clutter", "60 % of the crossings are none", false_crossings(0.6), PASSING),
    ("clutter", "four bars of nets besides", false_lines(4), PASSING),
    ("clutter", "four bars of nets instead", false_lines(4, besides=False), PASSING),
    ("clutter", "false crossings instead", false_crossings(1.0), PASSING),
)  # fmt: skip
_FALLS_OF_CLOUDS: Rows = (
    ("carried", "three falls, garbage while lying", _falls(shown(anew(uniform), besides=False)), THREE_FALLS),
)
_FOR_CLOUDS = {"none", "mirrored", "ranges × 1.1", "odometry turns the wrong way", "camera's clock 300 ms fast"}


def _kinds(robots: str, *tables: Rows) -> tuple[Kind, ...]:
    return tuple(Kind(robots, *row) for rows in tables for row in rows)


CATALOGUE = (
    *_kinds(MIRROR, _OF_ALL, _OF_POINTS, _OF_MIRRORS),
    *_kinds(FEATURES, _OF_ALL, _OF_WALKERS, _OF_FEATURES),
    *_kinds(CLOUD, [row for row in _OF_ALL if row[1] in _FOR_CLOUDS], _OF_POINTS, _OF_WALKERS[:5], _FALLS_OF_CLOUDS),
)
