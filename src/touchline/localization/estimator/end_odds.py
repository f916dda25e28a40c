"""At which end of a symmetric field the robot is, as log-odds of the pose against its twin, with their evidence."""

from __future__ import annotations

import math
from collections.abc import Sequence

from touchline.geometry import Pose
from touchline.localization.estimator.compass_witness import CompassWitness, speaks_for
from touchline.types import Evidence

TOLD = 6.0  # log-odds of an end that a person tells: one in four hundred is wrong
MEMORY_S = 2.0  # time over which others have to say the same, so that a moment's fault tells nothing
FORGET_S = 10.0  # after which what others said and don't repeat has lost most of its weight
FIRST_WORD = 0.25  # share of what somebody says first that counts at once
REFUTED = -2.0  # log-odds from which the twin is taken
JUMP_IMAGES = 2  # after a jump, in which a compass that turns round has turned with it


class EndOdds:
    """Whether the pose is at its end or its twin is. symmetric: whether the field's lines leave that open.

    `undecided`: a jump has left it open, and neither end is clearly likelier yet.
    """

    def __init__(self, symmetric: bool) -> None:
        self.symmetric = symmetric
        self.compass = CompassWitness()
        self.reset()

    def reset(self, told: bool = False) -> None:
        """Nothing is known, or a person has told the end."""
        self._forget(told)
        self.compass.reset()
        self.undecided = False

    def _forget(self, told: bool) -> None:
        self.told = TOLD if told else 0.0
        self.others: dict[str, float] = {}
        self._silent_s: dict[str, float] = {}
        self._jumping = 0
        self._spoke: int | None = None

    def begin(self, told: bool, compass_error_rad: float | None) -> None:
        """A pose was found anew: what speaks for its end at once."""
        self._forget(told)
        self.compass.begin(compass_error_rad)
        self._spoke = speaks_for(compass_error_rad)
        self.undecided = False

    def jumped(self) -> None:
        """The pose has just jumped, as by a shove. One that was carried to near its twin's place looks just so; but its
        compass, which agreed until then, turns round.
        """
        self._jumping = JUMP_IMAGES if self._spoke == 1 else 0

    def update(self, compass_error_rad: float | None, seconds: float) -> None:
        """What the compass says of the pose now; None: nothing."""
        self._spoke = speaks_for(compass_error_rad)
        if self._jumping and self._spoke == -1 and self.log_odds > -REFUTED:
            self._forget(False)
            self.compass.doubt()
            self.undecided = True
        else:
            self.compass.hear(compass_error_rad, seconds)
        self._jumping = max(self._jumping - 1, 0)
        self.undecided = self.undecided and abs(self.log_odds) < -REFUTED

    def hear(self, evidence: Sequence[Evidence], pose: Pose, seconds: float) -> None:
        """What others say of the pose now. Each one counts once, however often it repeats itself: it errs as one."""
        self.others = {source: value * math.exp(-seconds / FORGET_S) for source, value in self.others.items()}
        self._silent_s = {source: silent_s + seconds for source, silent_s in self._silent_s.items()}
        for one in evidence:
            speaks = one.log_likelihood(pose) - one.log_likelihood(pose.mirrored())
            before, silent_s = self.others.get(one.source, 0.0), self._silent_s.get(one.source, FIRST_WORD * MEMORY_S)
            self.others[one.source] = before + (speaks - before) * min(silent_s / MEMORY_S, 1.0)
            self._silent_s[one.source] = 0.0

    def turn(self) -> None:
        """The twin is the pose from now on; what was told, was told wrongly."""
        self.told = 0.0
        self._spoke = None if self._spoke is None else -self._spoke
        self.compass.turn()
        self.others = {source: -value for source, value in self.others.items()}

    @property
    def log_odds(self) -> float:
        """Of the pose, against its twin."""
        return self.told + self.compass.log_odds + sum(self.others.values())

    @property
    def is_refuted(self) -> bool:
        """Whether the twin is the pose."""
        return self.symmetric and self.log_odds <= REFUTED

    @property
    def against(self) -> tuple[str, ...]:
        """Who speaks against the pose, the one that weighs most first."""
        said = {"the compass": self.compass.log_odds, **self.others}
        return tuple(source for source in sorted(said, key=lambda one: said[one]) if said[source] < 0.0)

    @property
    def probability(self) -> float:
        """Of the pose, against its twin."""
        return 1.0 / (1.0 + math.exp(-self.log_odds)) if self.symmetric else 1.0
