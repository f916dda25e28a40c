"""ground_truth.tum: the true poses, for evaluation only."""

from __future__ import annotations

import math
from array import array
from pathlib import Path

import numpy as np

from touchline.files.opened import text_lines
from touchline.geometry import wrap_angles
from touchline.messages import counted
from touchline.sources.problems import ProblemKind, ProblemLog
from touchline.sources.sensors import increasing_rows, report_disorder
from touchline.sources.source import Truth
from touchline.sources.tables import MAX_TIME_S, StampArray, to_number, to_stamps
from touchline.types import MAX_VALUE

TRUTH = "ground_truth.tum"
TUM_COLUMNS = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")


def read_truth(path: Path, image_stamps: StampArray, log: ProblemLog) -> Truth | None:
    """The poses of a TUM file (`t x y z qx qy qz qw` a line, # for comments); None if there is no usable line.

    Broken lines, times out of order and another length than the images' go to the log.
    """
    rows, lines = array("d"), array("q")
    for number, text in enumerate(text_lines(path, errors="replace"), start=1):
        row = _pose_row(path.name, number, text, log)
        if row is not None:
            rows.extend(row)
            lines.append(number)
    table = np.array(rows).reshape(-1, 4)
    stamps = to_stamps(table[:, 0])
    keep = increasing_rows(stamps)
    report_disorder(path.name, table[:, 0], np.array(lines), keep, log, "; the pose is left out")
    stamps, poses = stamps[keep], table[keep, 1:]
    if len(stamps) != len(image_stamps):
        what = f"holds {counted(len(stamps), 'usable pose')} for {counted(len(image_stamps), 'image')}"
        what += "; the nearest in time is used" if len(stamps) else ""
        log.add(ProblemKind.TRUTH, path.name, what)
    elif not np.array_equal(stamps, image_stamps):
        index = int(np.flatnonzero(stamps != image_stamps)[0])
        at_s, image_s = stamps[index] / 1e9, image_stamps[index] / 1e9
        what = f"pose {index} is at t = {at_s:.4f} s, its image at {image_s:.4f} s; the nearest in time is used"
        log.add(ProblemKind.TRUTH, path.name, what)
    return Truth(stamps, np.column_stack((poses[:, :2], wrap_angles(poses[:, 2])))) if len(stamps) else None


def _pose_row(file: str, number: int, text: str, log: ProblemLog) -> tuple[float, float, float, float] | None:
    """t, x, y, heading of one line; None for a comment, a blank line, or (reported) a broken one."""
    if not text.strip() or text.startswith("#"):
        return None
    cells = text.split()
    if len(cells) != len(TUM_COLUMNS):
        what = f"has {len(cells)} values, expected 8 ({' '.join(TUM_COLUMNS)}); the pose is left out"
        log.add(ProblemKind.BROKEN_ROW, file, what, line=number)
        return None
    values = []
    for name, cell in zip(TUM_COLUMNS, cells, strict=True):
        value = to_number(cell)
        if value is None:
            log.add(ProblemKind.BROKEN_ROW, file, f"{name} reads {cell[:30]!r}; the pose is left out", line=number)
            return None
        if not math.isfinite(value):
            log.add(ProblemKind.NOT_A_NUMBER, file, f"{name} is {value}; the pose is left out", line=number)
            return None
        values.append(value)
    time_s, x, y, _, qx, qy, qz, qw = values
    if abs(time_s) >= MAX_TIME_S or max(map(abs, values[1:])) >= MAX_VALUE or math.hypot(qz, qw) < 1e-6:
        what = "needs a time of a clock, metres and a rotation about z; the pose is left out"
        log.add(ProblemKind.BROKEN_ROW, file, what, line=number)
        return None
    return time_s, x, y, heading_of(qx, qy, qz, qw)


def heading_of(qx: float, qy: float, qz: float, qw: float) -> float:
    """Yaw (rad) of a quaternion of any length but zero; 2 atan2(qz, qw) if the robot stands upright."""
    return math.atan2(2.0 * (qw * qz + qx * qy), qw * qw + qx * qx - qy * qy - qz * qz)
