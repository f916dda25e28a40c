"""The results of a run as messages of ROS: pose with covariance, map → odom, diagnostics."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable

import numpy as np

from touchline.evaluation.estimates import PROBABILITIES, PROTECTION, statistics_of
from touchline.evaluation.run import Run
from touchline.evaluation.run_folder import ESTIMATES
from touchline.geometry import FloatArray, Pose, Pose3, wrap_angles
from touchline.sources import ProblemLog, Recording
from touchline.sources.bags.standard import BASE, MAP, ODOM, StandardMessages
from touchline.sources.bags.table_rows import Rows, read_rows
from touchline.sources.bags.with_rosbags import Codec
from touchline.sources.bags.writing import BagWriter, epoch_ns
from touchline.sources.tables import open_table, read_blocks, to_number, to_stamps
from touchline.types import Samples, Status

POSE_TOPIC = "/touchline/pose"
_LEVELS = {Status.TRACKING: 0, Status.SEARCHING: 1, Status.LOST: 2}
_UPPER = ("cov_xx", "cov_xy", "cov_xt", "cov_yy", "cov_yt", "cov_tt")
_VALUES = (
    "residual_m",
    "points",
    "mode",
    *PROBABILITIES,
    *PROTECTION,
    "statistics",
    "perception_ms",
    "localization_ms",
)
_REACH_NS = 200_000_000  # an odometry sample farther away tells nothing of an image


def write_results(run: Run, writer: BagWriter, codec: Codec, on_image: Callable[[], None] | None = None) -> None:
    """Write every estimate of a run, on the clock of the bag that its recording came from, and close the bag.

    The transform is map → odom where the recording has odometry at the image's time, else map → base (REP 105).
    Raises InputError if the recording is no longer where it was.
    """
    recording = run.recording()
    epoch, odometry = epoch_ns(recording), _odometry(recording)
    make = StandardMessages(codec)
    columns: tuple[str, ...] = ()

    def write(topic: str, kind: str, stamp_ns: int, message: object) -> None:
        writer.write(topic, kind, max(stamp_ns, 0), codec.encode(kind, message))

    for rows in read_rows(run.folder / ESTIMATES):
        if rows.header:
            columns = rows.cells
            continue
        cells = dict(zip(columns, next(csv.reader([rows.text])), strict=False))
        stamp_ns, pose = rows.stamp_ns + epoch, _pose(cells)
        if pose is None:
            continue
        full = _covariance(cells)
        message = make.pose(stamp_ns, *pose, covariance=full)
        write(POSE_TOPIC, "geometry_msgs/msg/PoseWithCovarianceStamped", stamp_ns, message)
        child, placed = _map_from(pose, odometry, rows)
        moved = Pose3.from_roll_pitch_yaw(0.0, 0.0, placed.heading, (placed.x, placed.y, 0.0))
        write("/tf", "tf2_msgs/msg/TFMessage", stamp_ns, make.transform(stamp_ns, MAP, child, moved))
        status = cells.get("status", "")
        level = _LEVELS.get(Status(status), 2) if status in tuple(Status) else 2
        values = {name: cells[name] for name in _VALUES if cells.get(name)} | statistics_of(cells.get("statistics", ""))
        message = ": ".join(filter(None, (status, cells.get("reason"))))
        diagnostics = make.diagnostics(stamp_ns, level, message, values)
        write("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", stamp_ns, diagnostics)
        if on_image is not None:
            on_image()
    writer.close()


def _pose(cells: dict[str, str]) -> Pose | None:
    values = [to_number(cells.get(name, "")) for name in ("x", "y", "theta")]
    found = [value for value in values if value is not None and math.isfinite(value)]
    return Pose(*found) if len(found) == 3 else None


def _covariance(cells: dict[str, str]) -> FloatArray:
    """(36,) of x, y, z, roll, pitch, yaw; 0 off the plane."""
    xx, xy, xt, yy, yt, tt = (to_number(cells.get(name, "")) or 0.0 for name in _UPPER)
    full = np.zeros((6, 6))
    full[np.ix_((0, 1, 5), (0, 1, 5))] = [[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]]
    return full.ravel()


def _odometry(recording: Recording) -> Samples | None:
    """All of odometry.csv; None where there is none that can be read."""
    if "odometry.csv" not in recording.sensor_files:
        return None
    table = open_table(recording.file("odometry.csv"), ("t", "x", "y", "theta"))
    blocks = [block.values for block in read_blocks(table, ("t", "x", "y", "theta"), ProblemLog())]
    if not blocks:
        return None
    rows = np.concatenate(blocks)
    order = np.argsort(rows[:, 0], kind="stable")
    return Samples(to_stamps(rows[order, 0]), rows[order, 1:])


def _map_from(pose: Pose, odometry: Samples | None, rows: Rows) -> tuple[str, Pose]:
    """The frame that is placed in the map, and where."""
    if odometry is None:
        return BASE, pose
    stamps, stamp = odometry.stamp_ns, rows.stamp_ns
    after = min(int(np.searchsorted(stamps, stamp)), len(stamps) - 1)
    before = max(after - 1, 0) if stamps[after] > stamp else after
    if min(abs(int(stamps[after]) - stamp), abs(int(stamps[before]) - stamp)) > _REACH_NS:
        return BASE, pose
    step_ns = int(stamps[after] - stamps[before])
    step = odometry.values[after] - odometry.values[before]
    step[2] = wrap_angles(step[2:])[0]
    at = odometry.values[before] + ((stamp - int(stamps[before])) / step_ns if step_ns else 0.0) * step
    return ODOM, pose.compose(Pose(*at.tolist()).inverse())
