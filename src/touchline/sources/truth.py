"""ground_truth.tum: the true poses, for evaluation only."""

import math
from array import array
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from touchline.files.opened import text_lines
from touchline.geometry import FloatArray, Pose, wrap_angles
from touchline.messages import counted
from touchline.sources.problems import ProblemKind, ProblemLog
from touchline.sources.sensors import rows_in_order
from touchline.sources.tables import MAX_TIME_S, RowError, StampArray, read_cell
from touchline.types import MAX_VALUE, Samples

TRUTH = "ground_truth.tum"
TUM_COLUMNS = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")


@dataclass(frozen=True, eq=False, slots=True)
class Truth:
    """The true poses of the robot. stamp_ns: int64 (N,), strictly increasing. poses: float64 (N, 3) x, y (m),
    heading (rad) in the field frame.
    """

    stamp_ns: StampArray
    poses: FloatArray

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def __getitem__(self, index: int) -> Pose:
        return Pose(*self.poses[index].tolist())

    def samples(self) -> Samples:
        """The same as samples (N, 3) of x, y, heading."""
        return Samples(self.stamp_ns, self.poses)

    def nearest_index(self, stamp_ns: int) -> int:
        """Index of the pose whose stamp is nearest."""
        after = min(int(np.searchsorted(self.stamp_ns, stamp_ns)), len(self) - 1)
        before = max(after - 1, 0)
        return before if stamp_ns - self.stamp_ns[before] <= self.stamp_ns[after] - stamp_ns else after

    def nearest(self, stamp_ns: int) -> Pose:
        """The pose whose stamp is nearest."""
        return self[self.nearest_index(stamp_ns)]


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
