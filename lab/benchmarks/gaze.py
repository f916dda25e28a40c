"""A head that looks where `Estimate.look` says, beside one that sweeps from side to side.

python lab/benchmarks/gaze.py [--walks 50] [--first 5000]
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from touchline.geometry import deviation_m, deviation_rad
from touchline.systems import RobotSetup, open_system
from touchline.types import Estimate, Frame, Observation
from touchline_lab.experiments import schulz_runs as humanoids
from touchline_lab.experiments.drives import WRONG_M, WRONG_RAD, drive_of, track_of
from touchline_lab.experiments.harness import NONE, Row, interval, together
from touchline_lab.simulation.observation.feature_noise import PINHOLE_FEATURES
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

FIELD, SECONDS, FIRST = "hsl-s-9x6", 30.0, 5000  # number of the first walk; no constant was chosen on any from there on
WORN = 0.9  # share of lines and crossings that are not found: of what is easily seen any head knows where it is
BALL_S = 3.0  # so long the head watches the ball, where no line is seen, and so long the field, by turns
SWEEP_RAD, SWEEP_HZ, PAN_RAD_S = math.radians(60.0), 0.25, 3.0
HEADS = FOLLOWS, SWEEPS, AHEAD = "follows look", "sweeps", "looks ahead"
COLUMNS = (
    "head", "decided after (s)", "never", "tracked then (%)", "lost, a minute", "σ of position (cm)",
    "σ of heading (°)", "wrong, tracking (%)",
)  # fmt: skip


class Walked(NamedTuple):
    """decided_s: until one hypothesis is left, right but for the end; inf if never. Of the frames from then on: share
    that is tracked, losses a minute, means of standard deviations (m, rad). wrong: share of tracked frames.
    """

    decided_s: float
    tracked: float
    losses: float
    position_m: float
    heading_rad: float
    wrong: float


def walked(head: str, number: int) -> Walked:
    """One walk, begun anywhere, told nothing."""
    changes = (f"field={FIELD}", *humanoids.AS_BUILT.changes, *humanoids.random_areas(FIELD, number, 8))
    noise = PINHOLE_FEATURES.model_copy(
        update={name: (1.0 - WORN) * getattr(PINHOLE_FEATURES, name) for name in ("found_ratio", "line_ratio")}
    )
    simulation = Simulation(open_scenario(humanoids.SCENARIO, number, SECONDS, changes), "points", feature_noise=noise)
    setup = RobotSetup(simulation.field, height_m=PINHOLE_FEATURES.height_m)
    system = open_system("touchline", setup, None, np.random.default_rng(number))
    system.reset()
    pan_rad, estimates, frames = 0.0, list[Estimate](), list[Frame]()
    for index in range(len(simulation)):
        frame = simulation.frame(index)
        aim_rad = _aim(head, estimates[-1] if estimates else None, frame.stamp_ns / 1e9)
        most_rad = PAN_RAD_S / simulation.rate_hz
        pan_rad += min(max(aim_rad - pan_rad, -most_rad), most_rad)
        watches_ball = frame.stamp_ns / 1e9 % (2.0 * BALL_S) < BALL_S
        seen = Observation(frame.stamp_ns) if watches_ball else simulation.features(index, pan_rad)
        frames.append(replace(frame, observation=seen))
        estimates.append(system.step(frames[-1]))
    drive = drive_of(simulation, setup, frames)
    track = humanoids.either_end(track_of(drive, estimates))
    sure = np.array([sum(p or 0.0 for p in (e.probability, e.twin_probability)) > 0.9 for e in estimates])
    decided = np.flatnonzero(sure & track.within(WRONG_M, WRONG_RAD) & [e.explains_image for e in estimates])
    wrong = float(track.wrong.sum() / max(track.tracking.sum(), 1))
    if not len(decided):
        return Walked(math.inf, 0.0, math.nan, math.nan, math.nan, wrong)
    since = track.tracking[decided[0] :]
    rest = [e.covariance for e in estimates[decided[0] :] if e.status.value == "tracking"] or [
        np.full((3, 3), math.nan)
    ]
    losses = 60.0 * simulation.rate_hz * np.sum(since[:-1] & ~since[1:]) / len(since)
    return Walked(
        float(track.times_s[decided[0]]), float(since.mean()), float(losses),
        float(np.mean([deviation_m(c) for c in rest])), float(np.mean([deviation_rad(c) for c in rest])), wrong,
    )  # fmt: skip


def _aim(head: str, last: Estimate | None, time_s: float) -> float:
    """Where a head wants to look (rad)."""
    if head == SWEEPS:
        return SWEEP_RAD * math.sin(2.0 * math.pi * SWEEP_HZ * time_s)
    look = None if last is None or head == AHEAD else last.look
    if look is None:
        return 0.0 if head == AHEAD else SWEEP_RAD * math.sin(2.0 * math.pi * SWEEP_HZ * time_s)
    return look.bearing_rad


def _of_walk(number: int) -> dict[str, Walked]:
    return {head: walked(head, number) for head in HEADS}


_NOTES = (
    f"Humanoids as built walk for {SECONDS:g} s on {FIELD} at the observation level, begun anywhere, told nothing. "
    f"For {BALL_S:g} s of every {2.0 * BALL_S:g} s the head watches the ball and sees no line. Decided: a pose with "
    "its twin has 90 % and is right, but for the end. σ: as stated, means of the tracked images from then on. "
    f"{100.0 * WORN:.0f} % of the lines and crossings that an average robot finds are not found."
)


def _cells(head: str, walks: list[Walked]) -> Row:
    known = [one for one in walks if math.isfinite(one.decided_s)]
    return (
        head, interval([one.decided_s for one in known], 1) if known else NONE,
        f"{len(walks) - len(known)} of {len(walks)}",
        interval([100.0 * one.tracked for one in walks], 1),
        interval([one.losses for one in known], 1) if known else NONE,
        interval([100.0 * one.position_m for one in known if math.isfinite(one.position_m)], 1),
        interval([math.degrees(one.heading_rad) for one in known if math.isfinite(one.heading_rad)], 2),
        f"{100.0 * np.mean([one.wrong for one in walks]):.2f}",
    )  # fmt: skip


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--walks", type=int, default=10)
    parser.add_argument("--first", type=int, default=FIRST)
    given = parser.parse_args()
    found = together(_of_walk(number) for number in range(given.first, given.first + given.walks))
    print(*(" | ".join(row) for row in (COLUMNS, *(_cells(head, found[head]) for head in HEADS))), _NOTES, sep="\n")


if __name__ == "__main__":
    main()
