"""What the baselines read and write: an exported drive, and a CSV of poses. NumPy and PyYAML, nothing of Touchline."""

from __future__ import annotations

import csv
import math
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

HEADER = "t,x,y,theta,cov_xx,cov_xy,cov_xt,cov_yy,cov_yt,cov_tt,status"
STEP_M = 0.2  # between points that stand for a line that is seen


class Seen(NamedTuple):
    """One image. points (N, 2): on lines; markers: kind and place of crossings, posts; all in the robot frame (m).

    odometry: x, y, theta at the image; compass_rad: NaN where there is none.
    """

    t: str
    points: np.ndarray
    markers: list[tuple[str, float, float]]
    odometry: np.ndarray
    compass_rad: float


class Drive(NamedTuple):
    """An exported folder. start: x, y, heading; None where none is told."""

    name: str
    field: dict[str, Any]
    start: np.ndarray | None
    images: list[Seen]


def read_drive(folder: Path) -> Drive:
    """Read one."""
    field = yaml.safe_load((folder / "field.yaml").read_text())
    log = _table(folder / "odometry.csv")
    times, theta = log[:, 0], np.unwrap(log[:, 3])
    compass = _table(folder / "imu.csv")[:, [0, 3]]
    compass = compass[np.isfinite(compass[:, 1])]
    found: defaultdict[str, list[dict[str, str]]] = defaultdict(list)
    with (folder / "observations.csv").open() as file:
        for row in csv.DictReader(file):
            found[row["t"]].append(row)
    images = []
    for t, rows in found.items():
        at_s = float(t)
        odometry = np.array([np.interp(at_s, times, column) for column in (log[:, 1], log[:, 2], theta)])
        last = np.searchsorted(compass[:, 0], at_s, side="right") - 1
        heading = float(compass[last, 1]) if last >= 0 else math.nan
        images.append(Seen(t, _points(rows), _markers(rows), odometry, heading))
    start = None
    if (folder / "start.tum").is_file():
        _, x, y, _, _, _, qz, qw = map(float, (folder / "start.tum").read_text().split())
        start = np.array([x, y, 2.0 * math.atan2(qz, qw)])
    return Drive(folder.name, field, start, images)


def _table(path: Path) -> np.ndarray:
    return np.genfromtxt(path, delimiter=",", skip_header=1, ndmin=2)


def _points(rows: list[dict[str, str]]) -> np.ndarray:
    """Points on lines; of a line that is seen, every 20 cm one."""
    found = [[(float(row["x_m"]), float(row["y_m"]))] for row in rows if row["kind"] == "point"]
    for row in rows:
        if row["kind"] == "line":
            x, y, x2, y2 = (float(row[name]) for name in ("x_m", "y_m", "x2_m", "y2_m"))
            count = max(int(math.hypot(x2 - x, y2 - y) / STEP_M), 1)
            found.append([(x + (x2 - x) * k / count, y + (y2 - y) * k / count) for k in range(count + 1)])
    return np.array([place for places in found for place in places]).reshape(-1, 2)


def _markers(rows: list[dict[str, str]]) -> list[tuple[str, float, float]]:
    return [
        (row["kind"], float(row["x_m"]), float(row["y_m"])) for row in rows if row["kind"] in ("L", "T", "X", "post")
    ]


def moved(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """The motion between two poses of the odometry, in the robot frame (m, m, rad)."""
    dx, dy = after[:2] - before[:2]
    c, s = math.cos(before[2]), math.sin(before[2])
    return np.array([c * dx + s * dy, -s * dx + c * dy, after[2] - before[2]])


def composed(pose: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """A pose after a motion."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return pose + np.array([c * motion[0] - s * motion[1], s * motion[0] + c * motion[1], motion[2]])


def wrapped(angle: Any) -> Any:
    """In (-pi, pi]."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


Answer = tuple[np.ndarray, np.ndarray, bool]  # pose, covariance (3, 3), whether it is tracked


def write_answers(drive: Drive, answers: Iterator[Answer], folder: Path) -> None:
    """A line for each image."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = [HEADER]
    for seen, (pose, covariance, tracking) in zip(drive.images, answers, strict=True):
        numbers = [*pose[:2], wrapped(pose[2]), *covariance[np.triu_indices(3)]]
        status = "tracking" if tracking else "searching"
        lines.append(",".join([seen.t, *(f"{number:.9g}" for number in numbers), status]))
    (folder / f"{drive.name}.csv").write_text("\n".join(lines) + "\n")


def run_all(inputs: Path, results: Path, follow: Callable[[Drive], Iterator[Answer]], only: str = "") -> None:
    """Every drive of a folder of inputs that is not answered yet."""
    for folder in sorted(path for path in inputs.iterdir() if path.is_dir() and only in path.name):
        if not (results / f"{folder.name}.csv").is_file():
            drive = read_drive(folder)
            write_answers(drive, follow(drive), results)
