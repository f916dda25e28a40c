"""Where a robot stands in a state of the game: priors by name, for `reset`, and as the referee tells them.

None of them is a condition: the referee may be late, and may mean another robot.
"""

import math

import numpy as np

from touchline.errors import InputError
from touchline.field import FieldModel
from touchline.geometry import Pose
from touchline.messages import did_you_mean
from touchline.types import GameState, Prior, WeightedPose
from touchline.types.game import STAYS

GAME_STATES = (
    *("kick-off", "walk-in", "penalty shot", "penalty keeper", "fallen", "picked up"),
    *("penalised", "back from a penalty"),
)
_BEFORE_MARK_M = 1.0  # the shooter stands so far from the penalty mark, facing the opponent goal
_SHOT = np.diag(np.square([0.7, 0.7, 0.5]))  # (m, m, rad)²
_KEEPER = np.diag(np.square([0.3, 0.7, 0.5]))
_BACK = np.diag(np.square([0.4, 0.3, 0.3]))
_BACK_WEIGHT, _STOOD_WEIGHT = 0.32, 0.3  # of each touch line, and of where it stood: accidental penalties move nobody
_FALLEN = np.diag(np.square([0.4, 0.4, math.pi]))  # what a fall adds to the last pose: it may get up facing anywhere


def game_prior(state: str, field: FieldModel, last: Prior) -> Prior:
    """The prior of a named state. last: the pose before it with its covariance, or a Prior without one.

    kick-off and walk-in: somewhere in the own half. penalty shot: before the opponent's penalty mark, facing the goal.
    penalty keeper: on the own goal line. fallen: about where it was, facing anywhere. picked up: nothing is known.
    penalised: beside the field, or where it stood. back from a penalty: on either touch line at the height of the own
    penalty mark, facing the other touch line, or where it stood. These two join what is believed.
    Raises InputError for any other name, and on a field without penalty marks for a penalty shot.
    """
    if state in ("kick-off", "walk-in"):
        return Prior(own_half=True)
    if state == "penalty shot":
        mark_m = _penalty_mark_m(field)
        if mark_m is None:
            raise InputError(f"penalty shot: the field {field.name} has no penalty mark")
        return Prior(Pose(mark_m - _BEFORE_MARK_M, 0.0, 0.0), covariance=_SHOT)
    if state == "penalty keeper":
        return Prior(Pose(-0.5 * field.length, 0.0, 0.0), covariance=_KEEPER)
    if state == "fallen":
        known = np.zeros((3, 3)) if last.covariance is None else last.covariance
        return Prior() if last.pose is None else Prior(last.pose, covariance=known + _FALLEN)
    if state == "picked up":
        return Prior()
    if state == "penalised":
        return PENALISED
    if state == "back from a penalty":
        x = -(_penalty_mark_m(field) or 0.3 * field.length)
        poses = [Pose(x, side * 0.5 * field.width, -side * 0.5 * math.pi) for side in (1.0, -1.0)]
        sides = tuple(WeightedPose(pose, _BACK, _BACK_WEIGHT) for pose in poses)
        return Prior(poses=sides, kept=_STOOD_WEIGHT)
    raise InputError(f"state: {did_you_mean(str(state), list(GAME_STATES))}")


def _penalty_mark_m(field: FieldModel) -> float | None:
    """How far the penalty marks are from the centre; None without any."""
    marks = [float(x) for x, y, _ in field.discs if x > 1.0 and abs(y) < 0.5]
    return max(marks) if marks else None


PENALISED = Prior(kept=0.4)
AT_KICK_OFF = Prior(own_half=True, kept=1.0)  # who is tracked stays where it is, in the half where that is likelier
NEW_HALF = Prior(own_half=True)  # everybody is carried, and the ends change


class Referee:
    """Turns what the referee says, twice a second, into priors, each at its moment. `penalty`: the robot's by now."""

    def __init__(self, field: FieldModel) -> None:
        self._field = field
        self.reset()

    def reset(self) -> None:
        """Nothing has been said."""
        self.penalty = ""
        self._last: GameState | None = None

    @property
    def speaks(self) -> bool:
        """Whether anything has been said."""
        return self._last is not None

    def update(self, said: GameState) -> tuple[Prior, ...]:
        """The priors of what has changed, in their order."""
        last, self._last = self._last, said
        before, self.penalty = self.penalty, "" if said.penalty == STAYS else said.penalty
        priors: list[Prior] = []
        if last is not None and said.first_half != last.first_half:
            priors.append(NEW_HALF)
        if last is not None and last.phase == "initial" and said.phase in ("ready", "set", "playing"):
            priors.append(AT_KICK_OFF)  # one that was not received is made up for by the next state
        if self.penalty and not before:
            priors.append(PENALISED)
        if before and not self.penalty:
            priors.append(game_prior("back from a penalty", self._field, Prior()))
        return tuple(priors)
