"""Frames whose stamps run backwards: dropped, or a new start of the system that keeps its pose."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

from touchline.motion import FrameOrder, frame_order
from touchline.types import Estimate, Frame, Prior, Status, System

_POSE_KEPT = 10  # frames without tracking after which the last pose says nothing of where the robot is: one second


class OrderedSystem:
    """A system that takes frames of any order and never raises for it: what the runner and live use step.

    A frame older than the newest by up to a second is dropped: its estimate is the last one again, status searching.
    One that is older still comes from a clock that was set back: the system starts anew there with the pose that it
    tracked last as its prior, and this frame's status is searching.
    """

    def __init__(self, system: System, prior: Prior | None = None) -> None:
        """prior: what the system has been reset with."""
        self.system = system
        self.counts: Counter[FrameOrder] = Counter()
        """How many frames of each order there were."""
        self.order = FrameOrder.NEXT
        """The order of the last frame."""
        self._prior = prior or Prior()
        self._last: Estimate | None = None
        self._untracked = 0

    def reset(self, prior: Prior | None = None) -> None:
        """Forget everything but the prior; the counts stay."""
        self.system.reset(prior)
        self._prior, self._last, self._untracked = prior or Prior(), None, 0

    def step(self, frame: Frame) -> Estimate:
        """Take one frame. The estimate of a dropped frame has the stamp of the newest one."""
        self.order = FrameOrder.NEXT if self._last is None else frame_order(frame.stamp_ns, self._last.stamp_ns)
        self.counts[self.order] += 1
        if self.order is FrameOrder.LATE and self._last is not None:
            return replace(self._last, status=Status.SEARCHING)
        if self.order is FrameOrder.CLOCK_SET_BACK:
            self.system.reset(self._prior)
        estimate = self.system.step(frame)
        self._remember(estimate)
        if self.order is FrameOrder.CLOCK_SET_BACK:
            estimate = replace(estimate, status=Status.SEARCHING)
        self._last = estimate
        return estimate

    def _remember(self, estimate: Estimate) -> None:
        """What a new start would begin with: the pose tracked last, or what was told as long as none was."""
        if estimate.status is Status.TRACKING:
            self._prior, self._untracked = Prior(estimate.pose), 0
        elif self._prior.pose is not None:
            self._untracked += 1
            if self._untracked > _POSE_KEPT:
                self._prior = Prior()
