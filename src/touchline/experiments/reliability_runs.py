"""The runs of `reliability`: who calls a wrong pose tracking, and how soon it is right again."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from touchline.experiments.faults import Drive
from touchline.geometry import FloatArray, Pose, wrap_angle, wrap_angles
from touchline.simulation.run import Simulation
from touchline.simulation.scenario import open_scenario
from touchline.systems import RobotSetup, open_system
from touchline.types import Estimate, Status

WRONG_M, WRONG_RAD = 0.5, 0.5
RIGHT_M, RIGHT_RAD = 0.3, math.radians(10.0)
FOOLED_FRAMES = 5  # so many frames in a row wrong while tracking are too many
WITHIN_FRAMES = 10
KIDNAP_EVERY_S = 3.0
KIDNAP_M, KIDNAP_RAD, TWIN_M = 1.0, math.radians(30.0), 0.5  # kidnaps that count: so far, and not to the twin


class LaidIn(Protocol):
    """A fault from start_s until before end_s."""

    @property
    def name(self) -> str: ...
    @property
    def start_s(self) -> float: ...
    @property
    def end_s(self) -> float: ...
    def laid_into(self, drive: Drive, rng: np.random.Generator) -> Drive:
        """The drive with the fault in it."""
        ...


class Outcome(NamedTuple):
    """One run of N frames: times_s, errors_m, deviations_m that the system states, all (N,); and of each frame whether
    it was called tracking, was wrong, was right, whether the pose at the other end of the field was named, and whether
    the told one is at the other end (N,).
    """

    times_s: FloatArray
    errors_m: FloatArray
    deviations_m: FloatArray
    tracking: npt.NDArray[np.bool_]
    off: npt.NDArray[np.bool_]
    near: npt.NDArray[np.bool_]
    twin_named: npt.NDArray[np.bool_]
    flipped: npt.NDArray[np.bool_]

    @property
    def wrong(self) -> npt.NDArray[np.bool_]:
        """(N,) whether it was called tracking while wrong."""
        return self.tracking & self.off

    @property
    def unnamed(self) -> npt.NDArray[np.bool_]:
        """(N,) the same, and the true pose was not at the other end and named."""
        return self.wrong & ~self.twin_named

    @property
    def right(self) -> npt.NDArray[np.bool_]:
        """(N,) whether it was called tracking and right."""
        return self.tracking & self.near

    def frames_until_right(self, time_s: float) -> int | None:
        """Frames from a time on until it is right; None if it never is."""
        right = self.right[int(np.searchsorted(self.times_s, time_s)) :]
        return int(np.argmax(right)) if right.any() else None


@lru_cache(maxsize=8)
def driven(scenario: str, seed: int, seconds: float, *changes: str) -> tuple[Drive, RobotSetup, tuple[float, ...]]:
    """One drive of a scenario, its robot, and the times of its kidnaps (s)."""
    made = Simulation(open_scenario(scenario, seed, seconds, changes), level="points")
    setup = RobotSetup(made.field, made.camera, made.wheel_directions_rad)
    kidnaps_s = tuple(float(event["t"]) for event in made.events if event["kind"] == "kidnap")
    return Drive(list(made), np.asarray(made.truth.poses), made.field), setup, kidnaps_s


def followed(system: str, setup: RobotSetup, drive: Drive, seed: int) -> Outcome:
    """What a system makes of a drive."""
    told = open_system(system, setup, None, np.random.default_rng(seed))
    return outcome(drive, [told.step(frame) for frame in drive.frames])


def outcome(drive: Drive, estimates: Sequence[Estimate]) -> Outcome:
    """Estimates beside the truth."""
    poses = np.array([estimate.pose for estimate in estimates])
    errors_m, turned = _errors(poses, drive.truth)
    twins_m, twins_turned = _errors(poses * np.array([-1.0, -1.0, 1.0]) + np.array([0.0, 0.0, np.pi]), drive.truth)
    return Outcome(
        drive.times_s,
        errors_m,
        np.array([math.sqrt(np.trace(estimate.covariance[:2, :2])) for estimate in estimates]),
        np.array([estimate.status is Status.TRACKING for estimate in estimates]),
        (errors_m > WRONG_M) | (turned > WRONG_RAD),
        (errors_m < RIGHT_M) & (turned < RIGHT_RAD),
        np.array([_names(e, Pose(*truth)) for e, truth in zip(estimates, drive.truth.tolist(), strict=True)]),
        (twins_m < WRONG_M) & (twins_turned < WRONG_RAD),
    )


def _errors(poses: FloatArray, truth: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(N,) distances and absolute turns of poses (N, 3) from the truth (N, 3)."""
    errors = poses - truth
    return np.hypot(errors[:, 0], errors[:, 1]), np.abs(wrap_angles(errors[:, 2]))


def _names(estimate: Estimate, truth: Pose) -> bool:
    """Whether the true pose is the other end of the told one and among the hypotheses."""
    return estimate.pose.mirrored().distance_to(truth) < WRONG_M and any(
        h.pose.distance_to(truth) < WRONG_M for h in estimate.hypotheses
    )


class Kidnapped(NamedTuple):
    """One kidnap in play. right: within so many frames; wrong: most frames in a row called tracking while wrong."""

    right: bool
    wrong: int
    searching: bool


def kidnaps_of(drive: Drive, times_s: Sequence[float], found: Outcome) -> list[Kidnapped]:
    """Of every kidnap that counts what came of it until the next one."""
    begins = np.searchsorted(drive.times_s, times_s).tolist()
    ends = [*begins[1:], len(drive.times_s)]
    told = []
    for begin, end in zip(begins, ends, strict=True):
        if end - begin < WITHIN_FRAMES or not counts(Pose(*drive.truth[begin - 1]), Pose(*drive.truth[begin])):
            continue
        until = begin + WITHIN_FRAMES
        told.append(
            Kidnapped(
                bool(found.right[begin:until].any()),
                longest(found.wrong[begin:end]),
                not found.wrong[until - 1],
            )
        )
    return told


def counts(old: Pose, new: Pose) -> bool:
    """Whether a kidnap is far enough, and not to the pose that looks the same."""
    far = old.distance_to(new) >= KIDNAP_M or abs(wrap_angle(old.heading - new.heading)) >= KIDNAP_RAD
    return far and new.distance_to(old.mirrored()) >= TWIN_M


def longest(marked: npt.NDArray[np.bool_]) -> int:
    """Most frames in a row that are marked, of (N,)."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], marked, [False])).astype(np.int8)))
    return int((edges[1::2] - edges[::2]).max(initial=0))
