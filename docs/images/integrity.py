"""Makes the pictures of docs/integrity.md from drives of simulated robots as built, at the observation level.

python docs/images/integrity.py [FOLDER]
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from touchline.evaluation.protection import ALERT_LIMIT_M
from touchline.field import open_field
from touchline.geometry import FloatArray, Pose
from touchline.palette import BLACK, BLUE, ORANGE, VERMILLION
from touchline.systems import open_system
from touchline.types import Estimate, Frame, Observation, Prior, Samples, points_at
from touchline_lab.experiments import schulz_runs as humanoids
from touchline_lab.experiments.drives import Drive, driven, track_of
from touchline_lab.stanford import draw_stanford

SYSTEM = "touchline"
SEED, SECONDS, BEGIN_S = 3000, 20.0, 8.0
ROBOTS = range(6)
LATE_FRAMES = 3  # at 10 Hz


def main(folder: Path) -> None:
    """Write all pictures."""
    statistics().savefig(folder / "integrity-statistics.png", dpi=90)
    stanford().savefig(folder / "integrity-stanford.png", dpi=90)


Change = Callable[[Frame, list[Frame]], Frame]
"""A frame with a fault; the frames of the drive until now, as they were."""


def faulty(drive: Drive, change: Change) -> Drive:
    """The drive with a fault from BEGIN_S on."""
    seen: list[Frame] = []
    frames = []
    for frame in drive.frames:
        seen.append(frame)
        frames.append(frame if frame.stamp_ns < 1e9 * BEGIN_S else change(frame, seen))
    return replace(drive, frames=frames)


def showing(points: Callable[[FloatArray], FloatArray]) -> Change:
    """The line points (N, 2) are others, and nothing else is seen."""

    def change(frame: Frame, seen: list[Frame]) -> Frame:
        assert frame.observation is not None
        shown = points_at(points(frame.observation.points.positions_m))
        return replace(frame, observation=Observation(frame.stamp_ns, shown))

    return change


def of_frame(back: Callable[[list[Frame]], Frame]) -> Change:
    """What was seen in an earlier frame, with the stamp of this one."""

    def change(frame: Frame, seen: list[Frame]) -> Frame:
        old = back(seen).observation
        assert old is not None
        return replace(frame, observation=replace(old, stamp_ns=frame.stamp_ns))

    return change


def turning_back(drive: Drive) -> Drive:
    """Odometry whose steps turn the wrong way, from BEGIN_S on."""
    before = told = Pose(0.0, 0.0, 0.0)
    frames = []
    for frame in drive.frames:
        if frame.odometry is not None:
            rows = []
            for stamp_ns, row in zip(frame.odometry.stamp_ns, frame.odometry.values.tolist(), strict=True):
                x, y, turn = before.inverse().compose(Pose(*row))
                before, told = Pose(*row), told.compose(Pose(x, y, turn if stamp_ns < 1e9 * BEGIN_S else -turn))
                rows.append(told)
            frame = replace(frame, odometry=Samples(frame.odometry.stamp_ns, np.array(rows)))
        frames.append(frame)
    return replace(drive, frames=frames)


def garbage(points: FloatArray) -> FloatArray:
    """As many points anywhere."""
    return np.random.default_rng(len(points)).uniform(-6.0, 6.0, points.shape)


def turned(angle_rad: float) -> Callable[[FloatArray], FloatArray]:
    """Points as a camera sees them that has turned on its mount."""
    return Pose(0.0, 0.0, angle_rad).transform


FAULTS: dict[str, Callable[[Drive], Drive]] = {
    "odometry turns the wrong way": turning_back,
    "images 300 ms late": lambda drive: faulty(drive, of_frame(lambda seen: seen[-1 - LATE_FRAMES])),
    "images turned by 20°": lambda drive: faulty(drive, showing(turned(math.radians(20.0)))),
    "another field": lambda drive: replace(drive, setup=replace(drive.setup, field=open_field("msl-22x14"))),
    "garbage": lambda drive: faulty(drive, showing(garbage)),
    "ranges × 1.05": lambda drive: faulty(drive, showing(lambda points: 1.05 * points)),
    "a frozen image": lambda drive: faulty(
        drive, of_frame(lambda seen: next(frame for frame in seen if frame.stamp_ns >= 1e9 * BEGIN_S))
    ),
}
SHOWN = {  # statistic -> the fault that it is shown with
    "motion": "odometry turns the wrong way",
    "motion of late": "images 300 ms late",
    "explanation": "images turned by 20°",
    "share": "another field",
    "chance": "garbage",
    "repetition": "a frozen image",
}


def statistics() -> Figure:
    """Each statistic over one drive, clean and with a fault; and the protection level of one."""
    figure, axes = plt.subplots(4, 2, figsize=(11.0, 9.5), layout="constrained", sharex=True)
    clean = robot_with_a_mirror(0)
    known = run(clean)
    runs = {fault: run(FAULTS[fault](clean)) for fault in SHOWN.values()}
    for axis, (name, fault) in zip(axes.flat, SHOWN.items(), strict=False):
        for estimates, color, words in ((known, BLUE, "clean"), (runs[fault], VERMILLION, fault)):
            values = [estimate.statistics.get(name, np.nan) for estimate in estimates]
            axis.plot(clean.times_s, np.minimum(values, 3.0), color=color, label=words, linewidth=1.2)
        axis.axhline(1.0, color=BLACK, linewidth=0.8)
        axis.set_ylim(0.0, 3.05)
        title(axis, name, whole=fault == "another field")
    for axis, fault in zip(axes[-1], ("a frozen image", "odometry turns the wrong way"), strict=True):
        axis.semilogy(clean.times_s, track_of(clean, runs[fault]).distances_m, color=VERMILLION, label="error (m)")
        axis.semilogy(clean.times_s, levels(runs[fault]), color=BLUE, label="protection level (m)")
        title(axis, f"error and protection level: {fault}")
    for axis in axes[-1]:
        axis.set_xlabel("time (s)")
    return figure


def title(axis: Axes, name: str, whole: bool = False) -> None:
    """What is shown, and from when on the fault lasts; whole: all the time."""
    axis.axvspan(0.0 if whole else BEGIN_S, SECONDS, color=ORANGE, alpha=0.15, linewidth=0.0)
    axis.set_title(name, fontsize=10, loc="left")
    axis.legend(fontsize=8, loc="upper left")


def stanford() -> Figure:
    """Stanford diagrams of both cameras, of clean drives; and with the faults, of robots with a mirror."""
    figure, axes = plt.subplots(1, 3, figsize=(15.0, 5.2), layout="constrained")
    clean = [robot_with_a_mirror(number) for number in ROBOTS]
    panels = {
        "mirror, clean": clean,
        "humanoids, clean": [humanoid(number) for number in ROBOTS],
        "mirror, each fault of above": [lay(drive) for drive in clean for lay in FAULTS.values()],
    }
    for axis, (name, drives) in zip(axes, panels.items(), strict=True):
        begin_s = 0.0 if name.endswith("clean") else BEGIN_S + 0.15
        error_m, level_m = np.concatenate([bounds(drive, begin_s) for drive in drives]).T
        draw_stanford(axis, error_m, level_m, ALERT_LIMIT_M)
        axis.set_title(name, fontsize=10)
    return figure


def bounds(drive: Drive, begin_s: float) -> FloatArray:
    """(K, 2) errors given the end, and protection levels (m), of the tracked images from this time on."""
    estimates = run(drive)
    track = track_of(drive, estimates)
    error_m = np.minimum(track.distances_m, track.turned.distances_m)
    return np.column_stack((error_m, levels(estimates)))[track.tracking & (drive.times_s > begin_s)]


def robot_with_a_mirror(number: int) -> Drive:
    """One as built, in play."""
    return driven("match", SEED + number, SECONDS, "disturbances.kidnap_every_s=0")


def humanoid(number: int) -> Drive:
    """One as built, walking."""
    return humanoids.walk("hsl-s-9x6", humanoids.AS_BUILT, SEED + number, SECONDS)


def run(drive: Drive) -> list[Estimate]:
    """What the system makes of it, its start told."""
    system = open_system(SYSTEM, drive.setup)
    system.reset(Prior(Pose(*drive.truth[0].tolist())))
    return [system.step(frame) for frame in drive.frames]


def levels(estimates: list[Estimate]) -> FloatArray:
    """(N,) protection levels (m); NaN where there is none."""
    return np.array([estimate.protection_m for estimate in estimates], dtype=np.float64)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
