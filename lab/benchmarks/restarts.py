"""Robots whose program is killed in play and started again from its state file: where it says it is, and how soon.

    python lab/benchmarks/restarts.py [--runs 24] [--first 7000] [--away 1 2 4 10] [--robot humanoid] [--case went-on]

Nothing tells the ends of the field apart but the pose that is told at the start. went-on: the process alone ends, the
robot walks on, and its odometry, too; unfelt: the same without odometry. reboot: the robot stands meanwhile, its clock
and odometry begin anew. carried: the same, and it is put down elsewhere.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import numpy as np

from touchline.geometry import Pose
from touchline.live.state_file import StateFile, resume
from touchline.localizer import Localizer
from touchline.types import Estimate, Frame, Samples, Status
from touchline_lab.experiments import schulz_runs as humanoids
from touchline_lab.experiments.drives import WRONG_M, WRONG_RAD, Drive, driven
from touchline_lab.experiments.harness import wilson

FIRST = 7000  # number of the first drive; no constant was chosen on any from there on
PLAYED_S, WATCHED_S, SOON_S = 25.0, 15.0, 1.0
UNIX_S, CLOCK = 1.7e9, "touchline.live.state_file.time"
CASES = ("went-on", "unfelt", "reboot", "carried")
SENSORS = {"odometry": "add_odometry", "gyro": "add_gyro", "tilt": "add_attitude"}


class Restart(NamedTuple):
    """seen_s: from the first image that showed anything until it is tracked, inf if never. right: then. wrong: so many
    tracked images after it.
    """

    seen_s: float
    right: bool
    wrong: int


def drive_of(robot: str, number: int, away_s: float) -> Drive:
    """A walk or drive that is long enough."""
    seconds = PLAYED_S + away_s + WATCHED_S + 5.0
    if robot == "mirror":
        return driven("match", number, seconds)
    return humanoids.walk("hsl-s-9x6", humanoids.AS_BUILT, number, seconds, humanoids.random_areas("hsl-s-9x6", number))


def localizer_of(drive: Drive, robot: str) -> Localizer:
    """As the robot has it: without a compass."""
    settings = {"compass": False} if robot == "mirror" else None
    return Localizer(drive.field, drive.setup.camera, settings=settings)


def localized(localizer: Localizer, frame: Frame) -> Estimate:
    """What a live robot's program makes of a frame."""
    for name, add in SENSORS.items():
        samples = getattr(frame, name)
        for stamp_ns, row in () if samples is None else zip(samples.stamp_ns.tolist(), samples.values, strict=True):
            getattr(localizer, add)(stamp_ns, *row[:2] if name == "tilt" else row)
    return localizer.localize(frame.stamp_ns, observation=frame.observation, base_from_camera=frame.base_from_camera)


def map_from_odom(localizer: Localizer, frame: Frame) -> Pose | None:
    """As the loop of `touchline live` has it."""
    if frame.odometry is None:
        return None
    odometry = Pose(*frame.odometry.values[-1])
    return localizer.pose(int(frame.odometry.stamp_ns[-1])).pose.compose(odometry.inverse())


def begun_anew(frames: Iterator[Frame]) -> Iterator[Frame]:
    """With clock and odometry from zero."""
    origin: tuple[int, Pose] | None = None
    for frame in frames:
        samples = frame.odometry
        if origin is None and samples is not None:
            origin = int(samples.stamp_ns[0]), Pose(*samples.values[0])
        if origin is None:
            continue
        shift_ns, zero = origin[0] - 10**9, origin[1].inverse()
        moved = None if samples is None else Samples(
            samples.stamp_ns - shift_ns, np.array([zero.compose(Pose(*row)) for row in samples.values]))  # fmt: skip
        others = {name: None if (one := getattr(frame, name)) is None else Samples(one.stamp_ns - shift_ns, one.values)
                  for name in ("gyro", "tilt")}  # fmt: skip
        yield replace(frame, stamp_ns=frame.stamp_ns - shift_ns, odometry=moved, **others)


def restarted(robot: str, number: int, away_s: float, case: str) -> Restart | None:
    """One restart; None where nothing was tracked before it."""
    drive = drive_of(robot, number, away_s)
    times_s, truth = drive.times_s, drive.truth
    frames = [replace(frame, odometry=None, wheels=None) if case == "unfelt" else frame for frame in drive.frames]
    killed = int(np.searchsorted(times_s, PLAYED_S - 5.0 * np.random.default_rng([number, 28]).random()))
    again = {"reboot": killed, "carried": _farthest(drive, killed)}.get(case)
    again = int(np.searchsorted(times_s, times_s[killed] + away_s)) if again is None else again
    later = begun_anew(iter(frames[again:])) if case in ("reboot", "carried") else frames[again:]
    with tempfile.TemporaryDirectory() as folder, mock.patch(f"{CLOCK}.time") as unix:
        path = Path(folder) / "robot.json"
        played(localizer_of(drive, robot), drive, frames[:killed], path, unix)
        if not path.exists():
            return None
        second, begun_s = localizer_of(drive, robot), times_s[again]
        unix.return_value = away_unix_s = UNIX_S + times_s[killed - 1] + away_s
        resume(path, second)
        waited_s, first_s, was_right, wrong = np.inf, np.inf, False, 0
        for frame, true, time_s in zip(later, truth[again:], times_s[again:], strict=False):
            if time_s > begun_s + WATCHED_S:
                break
            unix.return_value = away_unix_s + time_s - begun_s
            found = localized(second, frame)
            first_s = min(first_s, time_s if found.points else np.inf)
            right = bool(found.pose.is_near(Pose(*true), WRONG_M, WRONG_RAD))
            if found.status is Status.TRACKING:
                wrong += not right
                waited_s, was_right = (time_s - first_s, right) if np.isinf(waited_s) else (waited_s, was_right)
    return Restart(waited_s, was_right, wrong)


def _farthest(drive: Drive, killed: int) -> int:
    """The index of the farthest place where the drive goes on for long enough."""
    away_m = np.hypot(*(drive.truth - drive.truth[killed])[:, :2].T)
    return int(np.argmax(away_m[: np.searchsorted(drive.times_s, drive.times_s[-1] - WATCHED_S)]))


def played(localizer: Localizer, drive: Drive, frames: list[Frame], path: Path, unix: mock.Mock) -> None:
    """Play until the process is killed; the state is written once a second."""
    localizer.reset(drive.truth[0])
    with mock.patch(f"{CLOCK}.monotonic") as now:
        kept = StateFile(path, localizer)
        for frame in frames:
            now.return_value = 1e-9 * frame.stamp_ns
            unix.return_value = UNIX_S + now.return_value
            kept.take(localized(localizer, frame), map_from_odom(localizer, frame))
            kept.close()


def line(found: list[Restart]) -> str:
    """What is printed of them."""
    decided = [one for one in found if np.isfinite(one.seen_s)]
    right = sum(one.right for one in decided)
    soon = sum(one.right and one.seen_s <= SOON_S for one in decided)
    low, high = wilson(right, len(decided)) if decided else (0.0, 1.0)
    times = [one.seen_s for one in decided] or [np.nan]
    return (
        f"{right} of {len(decided)} decided right [{100 * low:.0f}, {100 * high:.0f}] %, {len(found) - len(decided)} "
        f"open; within {SOON_S:g} s {soon} of {len(found)}; median {np.median(times):.2f} s, at worst "
        f"{max(times):.2f} s; {sum(one.wrong for one in found)} tracked images wrong"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=24)
    parser.add_argument("--first", type=int, default=FIRST)
    parser.add_argument("--away", type=float, nargs="+", default=[1.0, 2.0, 4.0, 10.0, 30.0])
    parser.add_argument("--robot", nargs="+", default=["humanoid", "mirror"])
    parser.add_argument("--case", nargs="+", default=list(CASES))
    given = parser.parse_args()
    for robot in given.robot:
        for case in given.case:
            for away_s in given.away:
                each = [restarted(robot, given.first + k, away_s, case) for k in range(given.runs)]
                print(
                    f"{robot}, {case}, {away_s:g} s away: {line([one for one in each if one is not None])}", flush=True
                )


if __name__ == "__main__":
    main()
