"""Where a robot stands in a state of the game: priors by name, for `reset`."""

from __future__ import annotations

import math

import numpy as np

from touchline.errors import InputError
from touchline.field import FieldModel
from touchline.geometry import Pose
from touchline.messages import did_you_mean
from touchline.types import Prior

GAME_STATES = ("kick-off", "walk-in", "penalty shot", "penalty keeper", "fallen", "picked up")
_BEFORE_MARK_M = 1.0  # the shooter stands so far from the penalty mark, facing the opponent goal
_SHOT = np.diag(np.square([0.7, 0.7, 0.5]))  # (m, m, rad)²
_KEEPER = np.diag(np.square([0.3, 0.7, 0.5]))
_FALLEN = np.diag(np.square([0.4, 0.4, math.pi]))  # what a fall adds to the last pose: it may get up facing anywhere


def game_prior(state: str, field: FieldModel, last: Prior) -> Prior:
    """The prior of a named state. last: the pose before it with its covariance, or a Prior without one.

    kick-off and walk-in: somewhere in the own half. penalty shot: before the opponent's penalty mark, facing the goal.
    penalty keeper: on the own goal line. fallen: about where it was, facing anywhere. picked up: nothing is known.
    Raises InputError for any other name, and on a field without penalty marks for a penalty shot.
    """
    if state in ("kick-off", "walk-in"):
        return Prior(own_half=True)
    if state == "penalty shot":
        marks = [float(x) for x, y, _ in field.discs if x > 1.0 and abs(y) < 0.5]
        if not marks:
            raise InputError(f"penalty shot: the field {field.name} has no penalty mark")
        return Prior(Pose(max(marks) - _BEFORE_MARK_M, 0.0, 0.0), covariance=_SHOT)
    if state == "penalty keeper":
        return Prior(Pose(-0.5 * field.length, 0.0, 0.0), covariance=_KEEPER)
    if state == "fallen":
        known = np.zeros((3, 3)) if last.covariance is None else last.covariance
        return Prior() if last.pose is None else Prior(last.pose, covariance=known + _FALLEN)
    if state == "picked up":
        return Prior()
    raise InputError(f"state: {did_you_mean(str(state), list(GAME_STATES))}")
