"""A robot's drive, what a system makes of it, and how that compares with the truth: under all experiments."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from touchline.config import Settings
from touchline.evaluation.metrics import ErrorTable, NothingToCompareError, error_table
from touchline.field import FieldModel
from touchline.geometry import BoolArray, FloatArray, IntArray, Pose, longest_run, wrap_angle, wrap_angles
from touchline.sources import Recording
from touchline.systems import RobotSetup, open_system
from touchline.systems.ordered import OrderedSystem
from touchline.types import Estimate, Frame, Prior, Samples, Status
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

NEAR_M, NEAR_RAD = 0.3, math.radians(10.0)  # within it a robot is found
WRONG_M, WRONG_RAD = 0.5, 0.5  # beyond it a pose is wrong
KIDNAP_M, KIDNAP_RAD, TWIN_M = 1.0, math.radians(30.0), 0.5  # kidnaps that count: so far, and not to the twin
KIDNAP_EVERY_S = 3.0
KIDNAPS = (f"disturbances.kidnap_every_s={KIDNAP_EVERY_S:g}", "disturbances.covered_images=0")
WITHIN_FRAMES, FOOLED_FRAMES = 10, 5  # found again in time; so many frames in a row wrong while tracking are too many


@dataclass(frozen=True, eq=False, slots=True)
class Drive:
    """What a robot saw and measured. setup: told to a system. truth (N, 3): x, y (m), heading (rad) at the frames.

    events: what happened to it, each with `t` (s) and `kind`. prior: what it is told at the start; None: nothing.
    """

    setup: RobotSetup
    frames: Sequence[Frame]
    truth: FloatArray
    events: Sequence[Mapping[str, Any]] = ()
    prior: Prior | None = None

    @property
    def field(self) -> FieldModel:
        """Where it drove."""
        return self.setup.field

    @property
    def times_s(self) -> FloatArray:
        """(N,) of the frames."""
        return np.array([frame.stamp_ns for frame in self.frames]) / 1e9

    def until(self, time_s: float) -> Drive:
        """The same, ending before a time."""
        end = int(np.searchsorted(self.times_s, time_s))
        return replace(self, frames=self.frames[:end], truth=self.truth[:end])

    def times_of(self, kind: str) -> list[float]:
        """When (s) events of a kind happened."""
        return [float(event["t"]) for event in self.events if event["kind"] == kind]


def drive_of(
    source: Simulation | Recording, setup: RobotSetup | None = None, frames: Sequence[Frame] | None = None
) -> Drive:
    """The drive that a run or a recording with truth holds. setup, frames: by default the source's own."""
    assert source.truth is not None, f"{source.name} holds its truth"
    setup = setup or RobotSetup(source.field, source.camera, source.wheel_directions_rad)
    return Drive(setup, tuple(source) if frames is None else frames, np.asarray(source.truth.poses), source.events)


@lru_cache(maxsize=8)
def driven(scenario: str, seed: int, seconds: float | None, *changes: str) -> Drive:
    """The drive of a scenario at the observation level; kept for the next system that takes it."""
    return drive_of(Simulation(open_scenario(scenario, seed, seconds, changes), level="points"))


def _no_rows() -> Any:
    return np.zeros(0)


@dataclass(frozen=True, eq=False, slots=True)
class Track:
    """Where a system said that a robot was, N poses, beside the truth, both (N, 3); tracking (N,): whether it believed.

    covariances (N, 3, 3) as it stated them; points (N,): how many it saw; twin_named (N,): whether the true pose was at
    the other end of the field and among the hypotheses.
    """

    times_s: FloatArray
    poses: FloatArray
    truth: FloatArray
    tracking: BoolArray
    covariances: FloatArray = field(default_factory=_no_rows)
    points: IntArray = field(default_factory=_no_rows)
    twin_named: BoolArray = field(default_factory=_no_rows)

    @property
    def errors(self) -> FloatArray:
        """(N, 3) pose minus truth, m, m, rad (wrapped)."""
        errors: FloatArray = self.poses - self.truth
        errors[:, 2] = wrap_angles(errors[:, 2])
        return errors

    @property
    def distances_m(self) -> FloatArray:
        """(N,) from the truth."""
        return np.hypot(*(self.poses - self.truth)[:, :2].T)

    @property
    def turns_rad(self) -> FloatArray:
        """(N,) absolute errors of the heading."""
        return np.abs(self.errors[:, 2])

    @property
    def deviations_m(self) -> FloatArray:
        """(N,) standard deviations of the position, as the system states them."""
        return np.sqrt(self.covariances[:, 0, 0] + self.covariances[:, 1, 1])

    @property
    def squares(self) -> FloatArray:
        """(N,) squared errors in the measure of the stated covariances."""
        errors = self.errors
        solved = np.linalg.solve(self.covariances, errors[:, :, None])[:, :, 0]
        return np.asarray(np.einsum("ni,ni->n", errors, solved), dtype=np.float64)

    def within(self, distance_m: float, turn_rad: float) -> BoolArray:
        """(N,) whether the pose is so near the truth."""
        return np.asarray((self.distances_m <= distance_m) & (self.turns_rad <= turn_rad))

    @property
    def found(self) -> BoolArray:
        """(N,) whether the robot is tracked within 30 cm and 10°."""
        return self.tracking & self.within(NEAR_M, NEAR_RAD)

    @property
    def wrong(self) -> BoolArray:
        """(N,) whether a pose is believed that is more than 0.5 m or 0.5 rad off."""
        return self.tracking & ~self.within(WRONG_M, WRONG_RAD)

    @property
    def unnamed(self) -> BoolArray:
        """(N,) the same, and the true pose was not at the other end and named."""
        return self.wrong & ~self.twin_named

    @property
    def turned(self) -> Track:
        """Each pose at the field's other end."""
        return replace(self, poses=self.poses * (-1.0, -1.0, 1.0) + (0.0, 0.0, math.pi))

    def part(self, kept: BoolArray) -> Track:
        """The frames that are kept (N,)."""
        names = ("times_s", "poses", "truth", "tracking", "covariances", "points", "twin_named")
        return Track(*(rows[kept] if len(rows) else rows for rows in (getattr(self, name) for name in names)))

    def tracked_from(self, start_s: float, end_s: float = math.inf) -> tuple[Track, float]:
        """The tracked frames from a time until before another, and their share of all frames in it."""
        counts = (self.times_s >= start_s) & (self.times_s < end_s)
        kept = counts & self.tracking
        return self.part(kept), float(kept.sum() / counts.sum())

    def table(self, located: BoolArray | None = None) -> ErrorTable | None:
        """Errors from the first frame on that is located (N,), by default tracked; None without any."""
        stamps = np.rint(1e9 * self.times_s).astype(np.int64)
        located = self.tracking if located is None else located
        try:
            return error_table(Samples(stamps, self.poses), Samples(stamps, self.truth), located=located)
        except NothingToCompareError:
            return None


def error_figures(tables: Sequence[ErrorTable | None], name: str, key: str) -> tuple[list[float], int]:
    """One figure of error tables, in cm or rad, and the decimals that it is printed with; of those that are known."""
    scale, decimals = (1.0, 4) if name == "heading" else (100.0, 2)
    return [scale * float(getattr(getattr(table, name), key)) for table in tables if table is not None], decimals


def track_of(drive: Drive, estimates: Sequence[Estimate]) -> Track:
    """Estimates of every frame beside the truth."""
    named = [
        estimate.pose.mirrored().distance_to(truth) < WRONG_M
        and any(hypothesis.pose.distance_to(truth) < WRONG_M for hypothesis in estimate.hypotheses)
        for estimate, truth in zip(estimates, (Pose(*truth) for truth in drive.truth.tolist()), strict=True)
    ]
    return Track(
        drive.times_s,
        np.array([estimate.pose for estimate in estimates]),
        drive.truth,
        np.array([estimate.status is Status.TRACKING for estimate in estimates]),
        np.array([estimate.covariance for estimate in estimates]),
        np.array([estimate.points for estimate in estimates]),
        np.array(named),
    )


def followed(
    system: str,
    drive: Drive,
    seed: int | Sequence[int],
    settings: Settings | Mapping[str, Any] | None = None,
    prior: Prior | None = None,
    forget_s: float = math.inf,
) -> Track:
    """What a system makes of a drive, beside the truth, as `estimates_of`."""
    return track_of(drive, estimates_of(system, drive, seed, settings, prior, forget_s))


def estimates_of(
    system: str,
    drive: Drive,
    seed: int | Sequence[int],
    settings: Settings | Mapping[str, Any] | None = None,
    prior: Prior | None = None,
    forget_s: float = math.inf,
) -> list[Estimate]:
    """What a system makes of a drive. prior: what it is told at the start; None: what the drive says.

    forget_s: when it is told that the robot may be anywhere.
    """
    localizer = OrderedSystem(open_system(system, drive.setup, settings, np.random.default_rng(seed)))
    prior = drive.prior if prior is None else prior
    if prior is not None:
        localizer.reset(prior)
    estimates = []
    for frame, time_s in zip(drive.frames, drive.times_s, strict=True):
        if time_s >= forget_s:
            localizer.reset()
            forget_s = math.inf
        estimates.append(localizer.step(frame))
    return estimates


def longest(marked: BoolArray) -> int:
    """Most frames in a row that are marked, of (N,)."""
    first, end = longest_run(marked)
    return end - first


@dataclass(frozen=True, slots=True)
class Kidnapped:
    """One kidnap in play. right: found within so many frames; wrong: most frames in a row believed while wrong."""

    right: bool
    wrong: int
    searching: bool


def kidnaps_of(drive: Drive, track: Track) -> list[Kidnapped]:
    """Of every kidnap that counts what came of it until the next one."""
    begins = np.searchsorted(drive.times_s, drive.times_of("kidnap")).tolist()
    found = []
    for begin, end in zip(begins, [*begins[1:], len(drive.times_s)], strict=False):
        until = begin + WITHIN_FRAMES
        if end >= until and counts(Pose(*drive.truth[begin - 1]), Pose(*drive.truth[begin])):
            right, wrong = bool(track.found[begin:until].any()), track.wrong[begin:end]
            found.append(Kidnapped(right, longest(wrong), not wrong[WITHIN_FRAMES - 1]))
    return found


def counts(old: Pose, new: Pose) -> bool:
    """Whether a kidnap is far enough, and not to the pose that looks the same."""
    far = old.distance_to(new) >= KIDNAP_M or abs(wrap_angle(old.heading - new.heading)) >= KIDNAP_RAD
    return far and new.distance_to(old.mirrored()) >= TWIN_M
