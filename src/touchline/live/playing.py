"""A recording sent as the robot would: every sample and image at its time."""

import heapq
import itertools
import math
import time
from collections.abc import Callable, Iterator

from touchline.live.heard import Picture, Reading
from touchline.sources import Recording
from touchline.sources.observations import OBSERVATIONS
from touchline.types import Frame, Samples

_SENSORS = {"odometry": "odometry", "wheels": "wheels", "gyro": "gyro", "compass": "compass", "tilt": "attitude"}


def play(
    recording: Recording,
    send: Callable[[Reading | Picture], None],
    speed: float = 1.0,
    stop: Callable[[], bool] = lambda: False,
    delay_s: float = 0.0,
) -> int:
    """Send everything at its time, as fast as it was recorded times speed; returns how many images were sent.

    delay_s: by which images come later than they were taken.
    """
    begun_s, first_ns, sent = time.monotonic(), None, 0
    for due_ns, event in _in_order(recording, round(1e9 * delay_s)):
        first_ns = due_ns if first_ns is None else first_ns
        while (wait_s := begun_s + (due_ns - first_ns) / 1e9 / speed - time.monotonic()) > 0.0 and not stop():
            time.sleep(min(wait_s, 0.1))
        if stop():
            break
        send(event)
        sent += isinstance(event, Picture)
    return sent


def _in_order(recording: Recording, delay_ns: int) -> Iterator[tuple[int, Reading | Picture]]:
    """What is sent and when (ns), in the order of time."""
    waiting: list[tuple[int, int, Reading | Picture]] = []
    order = itertools.count()
    own_detector = recording.table(OBSERVATIONS) is not None
    for index, frame in enumerate(recording.again(None if own_detector else ())):
        events: list[Reading | Picture] = [*_readings(frame), *_pictures(recording, index, frame)]
        for event in events:
            late_ns = delay_ns if isinstance(event, Picture) else 0
            heapq.heappush(waiting, (event.stamp_ns + late_ns, next(order), event))
        while waiting and waiting[0][0] <= frame.stamp_ns:
            yield waiting[0][0], heapq.heappop(waiting)[2]
    while waiting:
        yield waiting[0][0], heapq.heappop(waiting)[2]


def _readings(frame: Frame) -> Iterator[Reading]:
    for name, sensor in _SENSORS.items():
        samples: Samples | None = getattr(frame, name)
        if samples is None:
            continue
        for stamp_ns, values in zip(samples.stamp_ns.tolist(), samples.values.tolist(), strict=True):
            if not any(map(math.isnan, values)):  # an empty cell
                yield Reading(sensor, stamp_ns, tuple(values))


def _pictures(recording: Recording, index: int, frame: Frame) -> Iterator[Picture]:
    """One, unless nothing is there of this frame."""
    data = recording.image_bytes(index) if frame.observation is None else None
    if data is not None or frame.observation is not None:
        yield Picture(frame.stamp_ns, data, frame.observation, frame.base_from_camera)
