"""Whether the images of a robot that drives are stamped late, which nobody told."""

from __future__ import annotations

from collections import deque

import numpy as np

from touchline.geometry import Pose
from touchline.motion.delay import find_delay
from touchline.types import Estimate, Samples, Status

LOOKED_AT = 200  # poses after which it is looked for: 20 s at ten images a second
LATE_S = 0.04  # that is told: 8 cm at 2 m/s
SURE = 3.0  # standard deviations beyond that
_MOST_SAMPLES = 20_000  # of odometry
_NOWHERE = np.diag([1.0, 1.0, 1.0])


class DelayWatch:
    """Compares poses by the lines alone with the odometry, every LOOKED_AT images."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all."""
        self._stamps_ns: deque[int] = deque(maxlen=_MOST_SAMPLES)
        self._odometry: deque[list[float]] = deque(maxlen=_MOST_SAMPLES)
        self._seen: list[Estimate] = []

    def hear(self, odometry: Samples | None) -> None:
        """What odometry (x, y, theta) has measured since the image before."""
        if odometry is None:
            return
        for stamp_ns, row in zip(odometry.stamp_ns.tolist(), odometry.values.tolist(), strict=True):
            if not self._stamps_ns or stamp_ns > self._stamps_ns[-1]:
                self._stamps_ns.append(stamp_ns)
                self._odometry.append(row)

    def see(self, stamp_ns: int, pose: Pose) -> str | None:
        """The pose of an image by its lines alone. What is wrong with the stamps, or None: not known, or nothing."""
        self._seen.append(Estimate(stamp_ns, pose, _NOWHERE, Status.TRACKING))
        if len(self._seen) < LOOKED_AT:
            return None
        seen, stamps_ns, values = self._seen, np.array(self._stamps_ns, np.int64), np.array(self._odometry)
        self.reset()
        found = find_delay(seen, Samples(stamps_ns, values.reshape(-1, 3)))
        if found is None or abs(found.late_s) < LATE_S + SURE * found.deviation_s:
            return None
        late_ms, way = 1e3 * abs(found.late_s), "late" if found.late_s > 0.0 else "early"
        return f"images are stamped {late_ms:.0f} ± {1e3 * found.deviation_s:.0f} ms too {way}"
