"""What the referee says of the game and of one robot."""

from dataclasses import dataclass

from touchline.errors import InputError
from touchline.messages import did_you_mean

PHASES = ("initial", "ready", "set", "playing", "finished")
STAYS = "motion in set"  # the penalty for which nobody carries a robot away


@dataclass(frozen=True, slots=True)
class GameState:
    """What the referee says: phase, one of `PHASES`; whether it is the first half; penalty, in words, empty without.

    Raises InputError for another phase.
    """

    stamp_ns: int
    phase: str
    penalty: str = ""
    first_half: bool = True

    def __post_init__(self) -> None:
        if self.phase not in PHASES:
            raise InputError(f"game state: {did_you_mean(str(self.phase), list(PHASES))}")
