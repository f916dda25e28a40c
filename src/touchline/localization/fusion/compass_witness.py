"""What a compass says of the end of the field, as log-odds: a witness that now and then fails for a while.

A robot that is followed from image to image does not change its end. So a compass that says otherwise has failed, and
such faults end by themselves, or it was false when the end was found. If faults last as long as they please (an
exponential law), the log-odds of the two go down by the same for every second of contradiction and up for every second
of agreement.
"""

from __future__ import annotations

import math

from touchline.geometry import wrap_angle
from touchline.localization.fusion.field_side import COMPASS_FALSE

TOLD = math.log((1.0 - COMPASS_FALSE) / COMPASS_FALSE)  # log-odds of an end that a compass tells
FIRST_S = 2.0  # until it has said the same for so long, a compass tells nothing for certain
FAULT_S = 5.0  # by which a contradiction has to last longer for each unit of log-odds
MOST = TOLD + 60.0 / FAULT_S  # a minute of agreement
SUSPECT_S = 1.0  # of contradiction, after which a compass is not asked where a lost robot is
IGNORED_S = 30.0  # for so long, or until it changes its mind
NEAR_RAD, FAR_RAD = math.pi / 4.0, 0.75 * math.pi  # errors of a compass at the right end, and at the wrong one


class CompassWitness:
    """Log-odds of the pose's end against the other by the compass alone."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Nothing was heard."""
        self.log_odds = 0.0
        self._heard_s = self._against_s = self._ignored_s = 0.0
        self._ignored = 0

    @property
    def is_suspect(self) -> bool:
        """Whether it has just failed: it is not asked where a lost robot is."""
        return self._ignored_s > 0.0 or self._against_s >= SUSPECT_S

    def begin(self, error_rad: float | None) -> None:
        """A pose was found anew that a compass differs from: its word counts at once, unless it had just failed."""
        suspect = self._ignored_s if self._ignored_s > 0.0 else IGNORED_S * (self._against_s >= SUSPECT_S)
        self.reset()
        speaks = _speaks(error_rad)
        if suspect > 0.0:
            self._ignored_s, self._ignored = suspect, speaks
        else:
            self.log_odds = TOLD * speaks

    def hear(self, error_rad: float | None, seconds: float) -> None:
        """What it says of the pose now; None: nothing. seconds: since it was heard last."""
        speaks = _speaks(error_rad)
        if self._ignored_s > 0.0:
            self._ignored_s -= seconds
            if speaks in (0, self._ignored):
                return
            self._ignored_s = 0.0  # it has changed its mind
        if speaks == 0:
            return
        self._heard_s += seconds
        if self._heard_s <= FIRST_S:
            self.log_odds += (TOLD * speaks - self.log_odds) * min(seconds / FIRST_S, 1.0)
            return
        self.log_odds = max(min(self.log_odds + speaks * seconds / FAULT_S, MOST), -MOST)
        against = speaks * self.log_odds < 0.0
        self._against_s = max(self._against_s + seconds if against else self._against_s - seconds, 0.0)

    def turn(self) -> None:
        """The twin is the pose from now on."""
        self.log_odds = -self.log_odds
        self._ignored = -self._ignored
        self._against_s = 0.0


def _speaks(error_rad: float | None) -> int:
    """1 for the pose's end, -1 against it, 0 for neither, of a compass that differs by an angle from its heading."""
    if error_rad is None:
        return 0
    error = abs(wrap_angle(error_rad))
    return 1 if error < NEAR_RAD else -1 if error > FAR_RAD else 0
