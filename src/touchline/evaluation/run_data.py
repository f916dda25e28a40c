"""What a report draws: the estimates of a run, the truth, the errors and what happened, with what follows from them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from touchline.evaluation.estimates import EstimateTable
from touchline.evaluation.metrics import Errors, signed_errors, within
from touchline.evaluation.summary import SaidPhrase
from touchline.field import FieldModel
from touchline.geometry import BoolArray, FloatArray, IntArray
from touchline.types import Samples, Status

RIGHT_M, RIGHT_RAD = 0.3, float(np.radians(10.0))
WRONG_M, WRONG_RAD = 0.5, 0.5
_CARRIED_M = 0.5  # in one step of the truth, if it is also far more than usual
_CARRIED_STEPS = 10.0
_KIDNAP = "kidnap"


class Event(NamedTuple):
    """Something that happened to the robot: its time (s since the first frame) and what it was."""

    t_s: float
    kind: str


class WrongTracking(NamedTuple):
    """How long a pose was called tracking that was more than 0.5 m or 0.5 rad off: frames, and seconds."""

    frames: int
    seconds: float


@dataclass(frozen=True, eq=False)
class RunData:
    """The estimates and the truth (values (M, 3), m and rad) where it is known.

    black_ns: first and last stamp of every stretch of black images. events: what happened, as the recording tells it:
    mappings with `t` (s, on the clock of the stamps) and `kind`. said: what the system said.
    """

    table: EstimateTable
    field: FieldModel
    truth: Samples | None = None
    black_ns: Sequence[tuple[int, int]] = ()
    events: Sequence[Mapping[str, Any]] = ()
    said: Sequence[SaidPhrase] = ()

    @cached_property
    def errors(self) -> Errors | None:
        """The errors of all estimates that have a truth; None without truth."""
        return None if self.truth is None else signed_errors(self.table.trajectory, self.truth)

    @property
    def first_located(self) -> int:
        """The row of the first located estimate; the number of rows if there is none."""
        located = self.table.has_status(Status.TRACKING)
        return int(np.argmax(located)) if located.any() else len(self.table)

    def errors_since_located(self) -> Errors | None:
        """The errors from the first located estimate on; None if there are none."""
        if self.errors is None:
            return None
        begun = self.errors.rows >= self.first_located
        if not begun.any():
            return None
        return Errors(self.errors.rows[begun], self.errors.stamp_ns[begun], self.errors.values[begun])

    def seconds(self, stamp_ns: IntArray) -> FloatArray:
        """Time since the first frame (s)."""
        start = self.table.trajectory.stamp_ns[0] if len(self.table) else 0
        return (stamp_ns - start) / 1e9

    def happened(self) -> list[Event]:
        """What the recording tells, in the order of time; where it tells no kidnap, those that the truth shows."""
        start_s = 1e-9 * self.table.trajectory.stamp_ns[0] if len(self.table) else 0.0
        happened = [Event(float(event["t"]) - start_s, str(event["kind"])) for event in self.events]
        if not any(event.kind == _KIDNAP for event in happened) and self.truth is not None:
            carried = carried_rows(self.truth.values)
            happened += [Event(float(t), _KIDNAP) for t in self.seconds(self.truth.stamp_ns[carried])]
        return sorted(happened)

    def kidnaps_s(self) -> list[float]:
        """When the robot was carried elsewhere (s since the first frame)."""
        return [event.t_s for event in self.happened() if event.kind == _KIDNAP]

    def recoveries_s(self) -> list[float | None]:
        """After each kidnap, the time (s) until it is tracked within 30 cm and 10° again; None: not until the next."""
        kidnaps = self.kidnaps_s()
        if self.errors is None or not kidnaps:
            return []
        times = self.seconds(self.errors.stamp_ns)
        right = self._tracked() & (self.errors.position_m() < RIGHT_M)
        right &= np.abs(self.errors.values[:, 2]) < RIGHT_RAD
        found = []
        for begin, end in zip(kidnaps, [*kidnaps[1:], np.inf], strict=True):
            again = times[right & (times >= begin) & (times < end)]
            found.append(float(again[0] - begin) if len(again) else None)
        return found

    def wrong_while_tracking(self) -> WrongTracking | None:
        """How long a wrong pose was called tracking; None without truth. Black images do not count."""
        if self.errors is None or not len(self.errors.rows):
            return None
        wrong = (self.errors.position_m() > WRONG_M) | (np.abs(self.errors.values[:, 2]) > WRONG_RAD)
        wrong &= self._tracked() & ~within(self.errors.stamp_ns, self.black_ns)
        steps = np.diff(self.table.trajectory.stamp_ns)
        frame_s = 1e-9 * float(np.median(steps)) if len(steps) else 0.0
        return WrongTracking(int(wrong.sum()), float(wrong.sum()) * frame_s)

    def _tracked(self) -> BoolArray:
        """Which frames with an error (M,) were tracked."""
        assert self.errors is not None
        return self.table.has_status(Status.TRACKING)[self.errors.rows]


def carried_rows(poses: FloatArray) -> IntArray:
    """Rows of true poses (N, 3), in m, to which the robot did not drive: it was carried there."""
    steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    usual = float(np.median(steps)) if len(steps) else 0.0
    return np.flatnonzero(steps > max(_CARRIED_M, _CARRIED_STEPS * usual)) + 1
