"""What a suite holds: one table of conditions, cameras and fields, and the drive of each row's robots."""

from __future__ import annotations

import hashlib
import math
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from touchline.config import Settings, load_settings
from touchline.errors import InputError
from touchline.geometry import BoolArray, FloatArray, Pose
from touchline.messages import did_you_mean
from touchline.types import Frame, Prior, Samples
from touchline_lab.experiments import clutter, injections
from touchline_lab.experiments import schulz_runs as humanoids
from touchline_lab.experiments.drives import Drive, drive_of
from touchline_lab.experiments.injections import Change, Fault, both
from touchline_lab.simulation.observation.feature_noise import PINHOLE_FEATURES
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

FOLDER = Path(__file__).parent
MIRROR, HUMANOID = "mirror", "humanoid"
TRACKS = MIRROR, HUMANOID
MORE_S = 30.0  # so much more of a drive is simulated where robots are carried into it
AREAS = 8  # target areas of a walk
LOWER_RAD = math.radians(3.0)
_GARBAGE = both(clutter.false_crossings(1.0), clutter.false_lines(4))


def _lower(drive: Drive, wrong: BoolArray, rng: injections.Random) -> Drive:
    return injections.looking_lower(drive, LOWER_RAD, PINHOLE_FEATURES.height_m)


CHANGES: Mapping[str, Change] = {
    "kidnapped": injections.elsewhere(1.0, 9.0),
    "fall": injections.falls(1, 0.0, _GARBAGE),
    "compass turned": injections.turned_compass,
    "compass stuck": injections.stuck_compass,
    "left half hidden": clutter.thinned(lambda at, rng: at[:, 1] <= 0.0),
    "one in ten seen": clutter.thinned(lambda at, rng: rng.random(len(at)) < 0.1),
    "100 ms late": injections.stepped(0.1),
    "camera 3 deg lower": _lower,
    "robots and nets": clutter.shown(clutter.all_of(clutter.robots, clutter.nets), ratio=(0.2, 0.4)),
    "bars and cables": clutter.shown(clutter.standing(clutter.bars)),
    "30 % false crossings": clutter.false_crossings(0.3),
    "bars of nets": clutter.false_lines(4),
}
"""What a row's `faults` name."""


class FaultRow(Settings):
    """One fault of a row: begins and lasts a time drawn between, the latter even by its logarithm."""

    name: str = Field(..., description="one of CHANGES")
    start_s: tuple[float, float] = Field((0.0, 0.0), description="when it begins (s)")
    lasts_s: tuple[float, float] | None = Field(None, description="how long (s); none: to the end")

    def drawn(self, rng: np.random.Generator) -> Fault:
        """The fault as it befalls a robot."""
        if self.name not in CHANGES:
            raise InputError(f"fault '{self.name}' is unknown; {did_you_mean(self.name, list(CHANGES))}")
        start_s = float(rng.uniform(*self.start_s))
        lasts_s = math.inf if self.lasts_s is None else math.exp(rng.uniform(*np.log(self.lasts_s)))
        return Fault(self.name, start_s, start_s + lasts_s, CHANGES[self.name])


class Row(Settings):
    """One cell of the suite: a condition on a camera and a field."""

    track: Literal["mirror", "humanoid"] = Field(..., description="which camera")
    condition: str = Field(..., description="what is tried")
    field: str = Field("msl-18x12", description="a preset of `touchline fields`")
    scenario: str = Field("match", description="of a mirror robot's drive")
    changes: tuple[str, ...] = Field((), description="of the scenario, KEY=VALUE")
    built: bool = Field(True, description="a humanoid as built; else as simulated, nobody close by")
    seconds: float = Field(30.0, gt=1, description="length of a drive (s)")
    start_known: bool = Field(True, description="whether the start is told, within 0.3 m and 10 degrees")
    either_end: bool = Field(False, description="nothing tells the ends apart: both are right, until the next event")
    faults: tuple[FaultRow, ...] = ()
    recording: str = Field("", description="a public recording instead: one drive, on images")

    @property
    def name(self) -> str:
        """Of its files, without the robot."""
        return "-".join((self.track, *self.condition.split(), *self.field.split()))

    def rng(self, robot: int) -> np.random.Generator:
        """Of what befalls one robot."""
        return np.random.default_rng([robot, zlib.crc32(self.name.encode())])


class Suite(Settings):
    """A suite with its version: rows, and which robots are for what."""

    name: str
    tuning: tuple[int, int] = Field((0, 30), description="robots that settings may be chosen on: first, end")
    judging: tuple[int, int] = Field((100, 130), description="robots that results are of")
    release: tuple[int, int] = Field((200, 230), description="robots that nobody looks at before a release")
    rows: tuple[Row, ...] = ()

    def entries(self, first: int, count: int) -> Iterator[Entry]:
        """Every row with every robot; a recording has one."""
        for row in self.rows:
            for robot in range(first, first + (1 if row.recording else count)):
                yield Entry(row, robot)


def suite_names() -> list[str]:
    """Those that come with Touchline."""
    return sorted(path.stem for path in FOLDER.glob("*.yaml"))


def open_suite(name: str) -> Suite:
    """A suite by its name, or from a YAML file of one's own. Raises InputError for an unknown name and a wrong file."""
    path = FOLDER / f"{name}.yaml" if name in suite_names() else Path(name)
    if not path.is_file():
        raise InputError(f"suite '{name}' is unknown; {did_you_mean(name, suite_names())}")
    return load_settings(Suite, path)


@dataclass(frozen=True)
class Entry:
    """A row on one robot: one drive."""

    row: Row
    robot: int

    @property
    def name(self) -> str:
        """Of its folder and of its result's file."""
        return f"{self.row.name}-{self.robot}"

    @cached_property
    def faults(self) -> tuple[Fault, ...]:
        """What befalls it."""
        rng = self.row.rng(self.robot)
        return tuple(fault.drawn(rng) for fault in self.row.faults)

    def drive(self) -> Drive | None:
        """What the robot sees and measures; None for a recording, whose frames are its files."""
        return None if self.row.recording else _drive_of(self)

    def moments_s(self, drive: Drive) -> list[float]:
        """From when on (s) the robot has to find itself again: the start, where none is told, kidnaps, falls."""
        found = [] if self.row.start_known else [float(drive.times_s[0])]
        found += drive.times_of("kidnap")
        found += [fault.start_s for fault in self.faults if fault.name == "kidnapped"]
        found += [fault.start_s + injections.FALL_S for fault in self.faults if fault.name == "fall"]
        return [moment for moment in found if moment < drive.times_s[-1]]


def _drive_of(entry: Entry) -> Drive:
    row, robot = entry.row, entry.robot
    carried = any(fault.name == "kidnapped" for fault in entry.faults)
    seconds = row.seconds + (MORE_S if carried else 0.0)
    if row.track == MIRROR:
        changes = (f"field={row.field}", *row.changes)
        drive = drive_of(Simulation(open_scenario(row.scenario, robot, seconds, changes), level="points"))
    else:
        built = humanoids.AS_BUILT if row.built else humanoids.AS_SIMULATED
        areas = humanoids.random_areas(row.field, robot, AREAS)
        drive = humanoids.walk(row.field, built, robot, seconds, (*areas, *row.changes))
    rng = row.rng(robot + 1_000_000)
    for fault in entry.faults:
        drive = fault.laid_into(drive, rng)
    drive = drive.until(row.seconds)
    start = humanoids.start_about(Pose(*drive.truth[0].tolist()), robot)
    return replace(drive, prior=Prior(start) if row.start_known else None)


def digest(drive: Drive) -> str:
    """A hash of all that a system is given, rounded to 1e-6: the same on every machine."""
    rounded = hashlib.sha256()
    for frame in drive.frames:
        for numbers in _numbers(frame):
            rounded.update(np.rint(1e6 * numbers[np.isfinite(numbers)]).astype(np.int64).tobytes())
    return rounded.hexdigest()[:16]


def _numbers(frame: Frame) -> Iterator[FloatArray]:
    yield np.array([frame.stamp_ns / 1e9])
    if (seen := frame.observation) is not None:
        yield from (seen.points.positions_m, seen.lines.ends_m, seen.crossings.positions_m)
        yield from (seen.crossings.orientations_rad, seen.landmarks.positions_m)
    logs: list[Samples | None] = [frame.odometry, frame.wheels, frame.gyro, frame.compass, frame.tilt]
    yield from (log.values for log in logs if log is not None)
