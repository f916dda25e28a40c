"""Kidnaps in play: a match among eight robots, in which the robot is carried elsewhere every few seconds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from touchline.experiments.result import rate, spread
from touchline.geometry import Pose, wrap_angle
from touchline.simulation.run import Simulation
from touchline.simulation.scenario import open_scenario
from touchline.systems import RobotSetup, open_system, paper_settings
from touchline.types import Estimate, Frame, Status

EVERY_S, SECONDS = 4.0, 100.0
CYCLES, WITHIN = 15, 10
RIGHT_M, RIGHT_RAD = 0.3, float(np.radians(10.0))
LONG = 5  # frames: so long a wrong pose may pass for tracked
COLUMNS = (
    "kidnaps", "noticed after (frames)", "paper", "right at frame 10: its form here", "right at frame 10",
    "frames until right", "longest", "tracked though wrong for more than 5 frames", "ideal: right at frame 10",
    "wrong before: ours, its form, ideal",
)  # fmt: skip
Row = tuple[str, ...]


@dataclass(frozen=True, eq=False, slots=True)
class PlayKidnap:
    """What a system said in each frame (CYCLES,) from the first at the new place on: right; tracked though wrong.

    before: whether it was right in the last frame before; only then a kidnap counts.
    """

    before: bool
    right: npt.NDArray[np.bool_]
    fooled: npt.NDArray[np.bool_]


def is_right(estimate: Estimate, truth: Pose) -> bool:
    """Whether a robot is tracked within 30 cm and 10 degrees of the truth."""
    turned = abs(wrap_angle(estimate.pose.heading - truth.heading))
    near = estimate.pose.distance_to(truth) < RIGHT_M and turned < RIGHT_RAD
    return near and estimate.status is Status.TRACKING


def kidnaps_in_play(system: str, seed: int, covered: int, ideal: bool = False, paper: bool = False) -> list[PlayKidnap]:
    """The kidnaps of one match, each with so many covered images; a robot as built or ideal, paper: in its own form."""
    simulation, frames = _match(seed, covered, ideal)
    setup = RobotSetup(simulation.field, simulation.camera, simulation.wheel_directions_rad)
    localizer = open_system(system, setup, paper_settings(system) if paper else None, np.random.default_rng(seed))
    estimates = [localizer.step(frame) for frame in frames]
    right = np.array([is_right(e, simulation.truth[k]) for k, e in enumerate(estimates)])
    fooled = np.array([e.status is Status.TRACKING for e in estimates]) & ~right
    carried = [float(event["t"]) for event in simulation.track.events if event["kind"] == "kidnap"]
    first = np.searchsorted(simulation.image_times_s, carried)
    return [
        PlayKidnap(bool(right[k - covered - 1]), right[k : k + CYCLES], fooled[k : k + CYCLES])
        for k in first
        if k + CYCLES <= len(frames)
    ]


@lru_cache(maxsize=1)
def _match(seed: int, covered: int, ideal: bool) -> tuple[Simulation, tuple[Frame, ...]]:
    """A match and its frames, kept for the next system that takes them."""
    changes = [f"disturbances.kidnap_every_s={EVERY_S:g}", f"disturbances.covered_images={covered}"]
    changes += ["ideal=true"] if ideal else []
    simulation = Simulation(open_scenario("match", seed, SECONDS, changes), "points")
    return simulation, tuple(simulation)


def play_row(name: str, ours: Sequence[PlayKidnap], paper: Sequence[PlayKidnap], ideal: Sequence[PlayKidnap]) -> Row:
    """A row of COLUMNS: the kidnaps of robots that were right before, ours and the paper's form as built, ideal."""
    kidnaps = [one for one in ours if one.before]
    until = [int(np.argmax(one.right)) + 1 for one in kidnaps if one.right.any()]
    fooled = sum(_longest(one.fooled) > LONG for one in kidnaps)
    longest = f"{max(until, default=0)}" if len(until) == len(kidnaps) else f"over {CYCLES}"
    left_out = ", ".join(str(sum(not one.before for one in some)) for some in (ours, paper, ideal))
    return (
        name, "–", "–", play_rate(paper), play_rate(ours), spread(until), longest, f"{fooled} of {len(kidnaps)}",
        play_rate(ideal), left_out,
    )  # fmt: skip


def play_rate(kidnaps: Sequence[PlayKidnap]) -> str:
    """Share right at the tenth frame, of those that counted."""
    counted = [bool(one.right[WITHIN - 1]) for one in kidnaps if one.before]
    return rate(sum(counted), len(counted))


def _longest(true: npt.NDArray[np.bool_]) -> int:
    """Length of the longest run of true."""
    ends = np.flatnonzero(np.diff(np.concatenate(([0], true.astype(np.int8), [0]))))
    return int((ends[1::2] - ends[::2]).max(initial=0))
