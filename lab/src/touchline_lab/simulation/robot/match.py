"""A match: penalties, accidental ones, pick-ups, falls, half-time; and what the referee says meanwhile."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from touchline.field import FieldModel
from touchline.geometry import FloatArray
from touchline.types import GameState
from touchline.types.game import STAYS
from touchline_lab.simulation.robot.track import STEP_S

PENALTY, ACCIDENT, SET_MOTION, PICKED_UP, FALL, HALF_TIME = (
    *("penalty", "accidental penalty", STAYS, "picked up", "fall", "half-time"),
)
KINDS, SHARES = (PENALTY, ACCIDENT, SET_MOTION, PICKED_UP, FALL), (0.3, 0.1, 0.1, 0.1, 0.4)
LASTS_S = {PENALTY: (8.0, 20.0), ACCIDENT: (3.0, 8.0), SET_MOTION: (5.0, 10.0), PICKED_UP: (8.0, 20.0),
           FALL: (3.0, 8.0), HALF_TIME: (15.0, 25.0)}  # fmt: skip
CARRIED = (PENALTY, PICKED_UP, HALF_TIME)
SPACING_S = 12.0  # between the end of something and the next, at least
READY_S, SET_S, PLAYING_S = 3.0, 8.0, 10.0  # after the begin of a half
SAID_EVERY_S = 0.5
BACK_DEVIATIONS = 0.3, 0.15, math.radians(10.0)  # of where a robot is put down at a touch line
FALL_M, FALL_RAD = 0.3, math.radians(40.0)  # standard deviations of what a fall and getting up do
LYING_RAD, TIPS_OVER_S = math.radians(85.0), 0.5


class Happening(NamedTuple):
    """kind; from start_s to end_s, in which the robot goes nowhere by itself. moved (3,): unfelt; to (3,): carried
    there. Either may be None.
    """

    kind: str
    start_s: float
    end_s: float
    moved: FloatArray | None = None
    to: FloatArray | None = None

    @property
    def rows(self) -> slice:
        """Of the track."""
        return slice(round(self.start_s / STEP_S), round(self.end_s / STEP_S))


def make_match(
    half_s: float, every_s: float, seconds: float, field: FieldModel, rng: np.random.Generator
) -> tuple[Happening, ...]:
    """What happens in two halves, on average every so many seconds, in the order of time."""
    found: list[Happening] = []
    time_s, halves_left = PLAYING_S + rng.exponential(every_s), 1
    while time_s < seconds:
        kind = HALF_TIME if halves_left and time_s > half_s else str(rng.choice(KINDS, p=SHARES))
        halves_left -= kind == HALF_TIME
        end_s = time_s + rng.uniform(*LASTS_S[kind])
        moved = to = None
        if kind == FALL:
            moved = rng.standard_normal(3) * (FALL_M, FALL_M, FALL_RAD)
        if kind in (PENALTY, PICKED_UP):
            to = _at_touch_line(field, rng)
        if kind == HALF_TIME:
            x, y = rng.uniform(-0.45, -0.05) * field.length, rng.uniform(-0.5, 0.5) * field.width
            to = np.array([x, y, math.atan2(-y, -x) + 0.3 * rng.standard_normal()])
        found.append(Happening(kind, time_s, end_s, moved, to))
        settled_s = PLAYING_S if kind == HALF_TIME else 0.0
        time_s = end_s + settled_s + SPACING_S + float(rng.exponential(every_s))
    return tuple(each for each in found if each.end_s + 1.0 < seconds)


def _at_touch_line(field: FieldModel, rng: np.random.Generator) -> FloatArray:
    marks = [float(x) for x, y, _ in field.discs if x > 1.0 and abs(y) < 0.5]
    side = float(rng.choice((-1.0, 1.0)))
    place = np.array([-max(marks, default=0.3 * field.length), side * 0.5 * field.width, -side * 0.5 * math.pi])
    return place + rng.standard_normal(3) * BACK_DEVIATIONS


def lean_in_falls(attitude: FloatArray, happenings: Sequence[Happening]) -> None:
    """Tip the body (N, 2) over, forward or backward, and up again."""
    for each in happenings:
        if each.kind == FALL:
            rows = np.arange(len(attitude))[each.rows]
            from_ends_s = STEP_S * np.minimum(rows - rows[0], rows[-1] - rows)
            attitude[rows, 1] = LYING_RAD * np.minimum(from_ends_s / TIPS_OVER_S, 1.0)


def referee_says(
    happenings: Sequence[Happening], seconds: float, missed_ready: Sequence[bool]
) -> tuple[GameState, ...]:
    """What the GameController says, twice a second. missed_ready: of each half, whether its READY is not received."""
    halves = [each for each in happenings if each.kind == HALF_TIME]
    begins_s = [0.0, *(each.end_s for each in halves)]
    said = []
    for time_s in np.arange(0.1, seconds, SAID_EVERY_S).tolist():
        now = [each for each in happenings if each.start_s <= time_s < each.end_s]
        half = sum(begin_s <= time_s for begin_s in begins_s) - 1
        since_s = time_s - begins_s[half]
        phase = (
            "initial"
            if since_s < READY_S
            else "ready"
            if since_s < SET_S
            else "set"
            if since_s < PLAYING_S
            else "playing"
        )
        penalty = next((each.kind for each in now if each.kind not in (FALL, HALF_TIME)), "")
        second = half > 0
        if any(each.kind == HALF_TIME for each in now):
            of = next(each for each in now if each.kind == HALF_TIME)
            second = time_s > 0.5 * (of.start_s + of.end_s)
            phase = "initial" if second else "finished"
        if phase == "ready" and missed_ready[min(half, len(missed_ready) - 1)]:
            continue
        said.append(GameState(round(1e9 * time_s), phase, penalty, not second))
    return tuple(said)
