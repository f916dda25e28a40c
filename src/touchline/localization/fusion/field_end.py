"""At which end of a symmetric field the robot is, as log-odds of the pose against its twin, with their evidence."""

from __future__ import annotations

import math

from touchline.geometry import wrap_angle
from touchline.localization.fusion.field_side import COMPASS_FALSE

TOLD = 6.0  # log-odds of an end that a person tells: one in four hundred is wrong
COMPASS = math.log((1.0 - COMPASS_FALSE) / COMPASS_FALSE)  # of one that a compass tells
MEMORY_S = 2.0  # time over which a compass has to say the same, so that a moment's fault tells nothing
NEAR_RAD, FAR_RAD = math.pi / 4.0, 0.75 * math.pi  # errors of a compass at the right end, and at the wrong one
REFUTED = -2.0  # log-odds from which the twin is taken


class FieldEnd:
    """Whether the pose is at its end or its twin is. symmetric: whether the field's lines leave that open."""

    def __init__(self, symmetric: bool) -> None:
        self.symmetric = symmetric
        self.reset()

    def reset(self, told: bool = False) -> None:
        """Nothing is known, or a person has told the end."""
        self.told = TOLD if told else 0.0
        self.compass = 0.0

    def begin(self, told: bool, compass_error_rad: float | None) -> None:
        """A pose was found anew: what speaks for its end at once."""
        self.reset(told)
        self.compass = _speaks(compass_error_rad)

    def update(self, compass_error_rad: float | None, seconds: float) -> None:
        """What the compass says of the pose now; None: nothing."""
        if compass_error_rad is not None:
            self.compass += (_speaks(compass_error_rad) - self.compass) * min(seconds / MEMORY_S, 1.0)

    def turn(self) -> None:
        """The twin is the pose from now on; what was told, was told wrongly."""
        self.told, self.compass = 0.0, -self.compass

    @property
    def is_refuted(self) -> bool:
        """Whether the twin is the pose."""
        return self.symmetric and self.told + self.compass <= REFUTED

    @property
    def probability(self) -> float:
        """Of the pose, against its twin."""
        return 1.0 / (1.0 + math.exp(-self.told - self.compass)) if self.symmetric else 1.0


def _speaks(error_rad: float | None) -> float:
    """Log-odds for the pose's end, of a compass that differs by an angle from its heading."""
    if error_rad is None:
        return 0.0
    error = abs(wrap_angle(error_rad))
    return COMPASS if error < NEAR_RAD else -COMPASS if error > FAR_RAD else 0.0
