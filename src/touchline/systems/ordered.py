"""Frames whose stamps jump or run backwards: dropped, or a new start of the system that keeps its pose."""

from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from touchline.geometry import Pose
from touchline.motion import FrameClock, FrameOrder
from touchline.motion.samples import NANOSECONDS
from touchline.types import Estimate, Frame, Prior, Samples, Status, System

_POSE_KEPT = 10  # frames without tracking after which the last pose no longer locates the robot: one second
_MAX_DROPPED = 20  # frames whose samples wait: two seconds
_AHEAD_NS = int(1.0 * NANOSECONDS)  # samples may be newer than the image that they come with, by its delay
_SENSORS = ("odometry", "wheels", "gyro", "compass", "tilt")


class OrderedSystem:
    """A system that takes frames of any order and never raises for it: what the runner and live use step.

    A frame older than the newest by up to a second is dropped: its estimate is the last one again, status searching.
    So is one that is older still, or far ahead, until the next one confirms it: a broken stamp costs its own frame
    alone. The samples of dropped frames come with the next one. Once the second frame is older, the clock was set back:
    the system starts anew there with the pose that it tracked last as its prior, and this frame's status is searching.
    """

    def __init__(self, system: System, prior: Prior | None = None) -> None:
        """prior: what the system has been reset with."""
        self.system = system
        self.counts: Counter[FrameOrder] = Counter()
        """How many frames of each order there were."""
        self.order = FrameOrder.NEXT
        """The order of the last frame."""
        self._begin(prior)

    def reset(self, prior: Prior | None = None) -> None:
        """Forget everything but the prior; the counts stay. One that keeps something joins what is believed."""
        self.system.reset(prior)
        if prior is None or not prior.kept:
            self._begin(prior)

    def _begin(self, prior: Prior | None) -> None:
        self._prior = prior or Prior()
        self._tracked: Pose | None = None  # the prior of a new start, once there is one
        self._clock = FrameClock()
        self._last: Estimate | None = None
        self._dropped: deque[Frame] = deque(maxlen=_MAX_DROPPED)
        self._untracked = 0

    def step(self, frame: Frame) -> Estimate:
        """Take one frame. The estimate of a dropped frame has the stamp of the newest one."""
        self.order = self._clock.order(frame.stamp_ns)
        self.counts[self.order] += 1
        if self.order in (FrameOrder.LATE, FrameOrder.UNCONFIRMED) and self._last is not None:
            self._dropped.append(replace(frame, image=None, observation=None))
            return self._last.unconfirmed("the image's stamp is older than that of the one before, or far ahead")
        if self.order is FrameOrder.CLOCK_SET_BACK:
            self.system.reset(self._prior if self._tracked is None else Prior(self._tracked))
        if self._dropped:
            frame = with_samples_of(self._dropped, frame)
            self._dropped.clear()
        estimate = self.system.step(frame)
        self._remember(estimate)
        if self.order is FrameOrder.CLOCK_SET_BACK:
            estimate = estimate.unconfirmed("the clock was set back")
        self._last = estimate
        return estimate

    def _remember(self, estimate: Estimate) -> None:
        """What a new start would begin with: the pose tracked last, or the given prior as long as none was."""
        if estimate.status is Status.TRACKING:
            self._tracked, self._untracked = estimate.pose, 0
        elif self._tracked is not None or self._prior.pose is not None:
            self._untracked += 1
            if self._untracked > _POSE_KEPT:
                self._prior, self._tracked = Prior(), None


def with_samples_of(dropped: Iterable[Frame], frame: Frame) -> Frame:
    """A frame with the samples of those dropped before it, and what the referee said; what another clock has stamped is
    left out.
    """
    joined: dict[str, Any] = {}
    for sensor in _SENSORS:
        before = Samples.joined(getattr(each, sensor) for each in dropped)
        if before is not None:
            near = before.stamp_ns <= frame.stamp_ns + _AHEAD_NS
            near_before = Samples(before.stamp_ns[near], before.values[near])
            joined[sensor] = Samples.joined((near_before, getattr(frame, sensor)))
    said = tuple(state for each in dropped for state in each.game)
    return replace(frame, **joined, game=(*said, *frame.game))
