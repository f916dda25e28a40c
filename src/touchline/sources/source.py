"""What every source of frames offers: recordings of any format, and later a live robot."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from touchline.geometry import FloatArray, Pose
from touchline.sources.tables import StampArray
from touchline.types import Samples

if TYPE_CHECKING:
    pass


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
