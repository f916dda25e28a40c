"""Whether images are stamped late, which nobody told, and by how much: what of the filter's delay is believed.

The delay is a state of the filter (`JointFilter`), learned from every start, stop and turn. Nothing is corrected by
it until it is sure: a robot whose stamps are right loses nothing by the noise of a state that it does not need. Stamps
that seem too early are an odometry that comes late; to correct them would take the motion after the stamp, which nobody
knows yet.
"""

from __future__ import annotations

UNKNOWN_S = 0.06  # standard deviation of the delay, at first
MIN_S = 0.012  # that is corrected: 4 cm at 3 m/s
SURE = 4.0  # standard deviations from none
LASTING = 5  # images
DOUBTED = 2.0  # standard deviations from none, or less than half of MIN_S, from which it is none after all
WANDERING_S = 0.01  # standard deviation of stamps on arrival about their mean: drivers, buses, other processes
SAID_EVERY = 200  # images


class ImageDelay:
    """`late_s`: how late images are stamped, as far as it is believed, else 0; `deviation_s`: standard deviation."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Nothing is known."""
        self.late_s, self.deviation_s = 0.0, 0.0
        self._sure, self._since_said = 0, SAID_EVERY

    @property
    def wandering_s(self) -> float:
        """Standard deviation of a stamp about the mean: of stamps on arrival alone."""
        return WANDERING_S if self.late_s else 0.0

    def update(self, late_s: float, deviation_s: float) -> str | None:
        """What a filter has found by an image. What is to be told: at first and every SAID_EVERY images."""
        if self.late_s:
            if late_s < max(DOUBTED * deviation_s, 0.5 * MIN_S):
                self.reset()
        else:
            self._sure = self._sure + 1 if late_s > max(SURE * deviation_s, MIN_S) else 0
        if not self.late_s and self._sure < LASTING:
            return None
        self.late_s, self.deviation_s = late_s, deviation_s
        self._since_said += 1
        if self._since_said <= SAID_EVERY:
            return None
        self._since_said = 0
        return f"images are stamped {1e3 * late_s:.0f} ± {1e3 * deviation_s:.0f} ms too late: corrected"
