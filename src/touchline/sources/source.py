"""What every source of frames offers: recordings of any format, and later a live robot."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from touchline.geometry import FloatArray, Pose
from touchline.sources.problems import ProblemLog
from touchline.sources.tables import StampArray
from touchline.types import Frame, Samples

if TYPE_CHECKING:
    from touchline.camera import Camera
    from touchline.field import FieldModel


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


class Source(Protocol):
    """Frames in the order of time, with what is known about where they come from."""

    @property
    def name(self) -> str:
        """What the recording is called."""

    @property
    def rate_hz(self) -> float:
        """Nominal image rate."""

    @property
    def sequence(self) -> Mapping[str, Any]:
        """The description as it was written (sequence.yaml)."""

    @property
    def field(self) -> FieldModel:
        """The marked field."""

    @property
    def camera_kind(self) -> str:
        """`omni`, `pinhole`, `fisheye` or `none`."""

    @property
    def camera_file(self) -> Path | None:
        """The camera model's file, if there is one."""

    @property
    def camera(self) -> Camera:
        """The camera model; InputError if there is none."""

    @property
    def wheel_directions_rad(self) -> tuple[float, float] | None:
        """Rolling directions of the measuring wheels a and b in the robot frame; None where nobody says."""

    @property
    def truth(self) -> Truth | None:
        """The true poses, where they are known. For evaluation only."""

    @property
    def events(self) -> Sequence[Mapping[str, Any]]:
        """What happened (slip, kidnap, …). For evaluation only."""

    @property
    def problems(self) -> ProblemLog:
        """What was odd so far: at opening, and during the latest pass over the frames."""

    @property
    def image_stamps(self) -> StampArray:
        """Stamps of all frames (ns), int64 (N,)."""

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[Frame]: ...
