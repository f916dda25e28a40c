"""camera_pose.csv: where the camera of a moving head is at an image's time."""

from collections.abc import Iterator

import numpy as np

from touchline.geometry import FloatArray, Pose3, wrap_angles
from touchline.sources.problems import ProblemLog
from touchline.sources.sensors import SensorStream
from touchline.sources.tables import Table
from touchline.types import Samples

CAMERA_POSES = "camera_pose.csv"
COLUMNS = ("x", "y", "z", "roll", "pitch", "yaw")
_REACH_NS = 100_000_000  # a head moves on: a row that is farther away tells nothing of an image


class CameraPoses:
    """The poses of a table, read lazily and asked for at growing times."""

    def __init__(self, table: Table, log: ProblemLog) -> None:
        self._stream = SensorStream(table, COLUMNS, log)
        self._blocks: Iterator[Samples] = iter(self._stream)
        self._rows = Samples(np.zeros(0, dtype=np.int64), np.zeros((0, len(COLUMNS))))

    def at(self, stamp_ns: int) -> Pose3 | None:
        """`base_from_camera` between the rows before and after; None where no row lies within 0.1 s."""
        while not len(self._rows) or self._rows.stamp_ns[-1] < stamp_ns:
            block = next(self._blocks, None)
            if block is None:
                break
            last = max(len(self._rows) - 1, 0)  # the row before may be needed beside the first of this block
            self._rows = Samples(
                np.concatenate((self._rows.stamp_ns[last:], block.stamp_ns)),
                np.concatenate((self._rows.values[last:], block.values)),
            )
        stamps = self._rows.stamp_ns
        if not len(stamps) or np.abs(stamps - stamp_ns).min() > _REACH_NS:
            return None
        after = min(int(np.searchsorted(stamps, stamp_ns)), len(stamps) - 1)
        before = max(after - 1, 0) if stamps[after] > stamp_ns else after
        step_ns = int(stamps[after] - stamps[before])
        ratio = (stamp_ns - int(stamps[before])) / step_ns if step_ns else 0.0
        row = between(self._rows.values[before], self._rows.values[after], ratio)
        roll, pitch, yaw = row[3:].tolist()
        return Pose3.from_roll_pitch_yaw(roll, pitch, yaw, row[:3])

    def drain(self) -> None:
        """Read to the end of the file, so that its last rows are checked as well."""
        self._stream.drain()


def between(first: FloatArray, second: FloatArray, ratio: float) -> FloatArray:
    """(6,) position and angles at a ratio of the way; angles go the shorter way."""
    step = second - first
    step[3:] = wrap_angles(step[3:])
    return np.asarray(first + ratio * step)
