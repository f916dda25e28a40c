"""ground_truth.tum: the true poses, for evaluation only."""

import math
from array import array
from pathlib import Path

import numpy as np

from touchline.files.opened import text_lines
from touchline.geometry import wrap_angles
from touchline.messages import counted
from touchline.sources.problems import ProblemKind, ProblemLog
from touchline.sources.sensors import rows_in_order
from touchline.sources.source import Truth
from touchline.sources.tables import MAX_TIME_S, RowError, StampArray, read_cell
from touchline.types import MAX_VALUE

TRUTH = "ground_truth.tum"
TUM_COLUMNS = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")


def read_truth(path: Path, image_stamps: StampArray, log: ProblemLog) -> Truth | None:
    """The poses of a TUM file (`t x y z qx qy qz qw` a line, # for comments); None if there is no usable line.

    Broken lines, times out of order and another length than the images' go to the log.
    """
    rows, lines = array("d"), array("q")
    for number, text in enumerate(text_lines(path, errors="replace"), start=1):
        if not text.strip() or text.startswith("#"):
            continue
        try:
            rows.extend(_pose_row(text))
            lines.append(number)
        except RowError as error:
            log.add(error.kind, path.name, f"{error}; the pose is left out", line=number)
    table = np.array(rows).reshape(-1, 4)
    stamps, keep = rows_in_order(path.name, table[:, 0], np.array(lines), log, "; the pose is left out")
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


def _pose_row(text: str) -> tuple[float, float, float, float]:
    """t, x, y, heading of one line. Raises RowError for a broken one."""
    cells = text.split()
    if len(cells) != len(TUM_COLUMNS):
        raise RowError(f"has {len(cells)} values, expected 8 ({' '.join(TUM_COLUMNS)})")
    limits = [MAX_TIME_S, *[MAX_VALUE] * 7]
    time_s, x, y, _, qx, qy, qz, qw = map(read_cell, TUM_COLUMNS, cells, limits)
    if math.hypot(qz, qw) < 1e-6:
        raise RowError("needs a rotation about z")
    return time_s, x, y, heading_of(qx, qy, qz, qw)


def heading_of(qx: float, qy: float, qz: float, qw: float) -> float:
    """Yaw (rad) of a quaternion of any length but zero; 2 atan2(qz, qw) if the robot stands upright."""
    return math.atan2(2.0 * (qw * qz + qx * qy), qw * qw + qx * qx - qy * qy - qz * qz)
