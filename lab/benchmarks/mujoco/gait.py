"""A humanoid's walk: feet set down around a path, the body swaying as a linear inverted pendulum does.

Angles of the legs come by inverse kinematics, and the ankles push back where the body leans. That is all; on
the server's physics it walks up to 0.3 m/s, slips a little with each step, and stands pushes of some centimetres.
"""

from __future__ import annotations

import math

import numpy as np

GRAVITY, PENDULUM_M = 9.81, 0.57
STEP_S, STANCE_M, HIP_M, LIFT_M = 0.3, 0.1, 0.6, 0.035  # of a step; a foot aside; the torso's height; a swinging foot's
FIRST, LAST = 0.15, 0.925  # of a step: the foot swings in between
PUSH, DAMPING = 0.3, 0.03  # of the ankles: per rad of lean, per rad/s
STEPS_TO_START = 4  # in which the sway and the lift grow to what they are
AHEAD_M = 0.0557  # centre of mass before the torso's origin
AXES = 1, 0, 2, 1, 1, 0  # of hip pitch, roll, yaw, knee, ankle pitch, roll
SOLE_M = np.array([0.01, 0.0, -0.03])
BENT = np.array([-0.4, 0.0, 0.0, 0.8, -0.4, 0.0])


def rotation(axis: int, angle_rad: float) -> np.ndarray:
    """A turn (3, 3) about x, y or z."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    turn = np.eye(3)
    one, other = (axis + 1) % 3, (axis + 2) % 3
    turn[[one, one, other, other], [one, other, one, other]] = c, -s, s, c
    return turn


def foot(angles: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A sole's place (3,) (m) and attitude (3, 3) in the torso's frame; their derivatives (6, 6) by the leg's angles.

    side: 1 for the left leg, -1 for the right one. The lengths are those of the server's T1.
    """
    links = (0.0625, 0.106 * side, -0.1155), (0, 0, -0.02), (0, 0, -0.081854), (-0.014, 0, -0.134), (0, 0, -0.28)
    turn, place, joints = np.eye(3), np.zeros(3), []
    for axis, link, angle in zip(AXES, (*links, (0, 0.00025 * side, -0.012)), angles, strict=True):
        place = place + turn @ np.array(link)
        joints.append((place, turn[:, axis].copy()))
        turn = turn @ rotation(axis, angle)
    end = place + turn @ SOLE_M
    columns = [np.concatenate((np.cross(axis, end - at), axis)) for at, axis in joints]
    return end, turn, np.array(columns).T


def leg(place: np.ndarray, turn: np.ndarray, side: int, angles: np.ndarray) -> np.ndarray:
    """Angles (6,) that bring a sole to a place (3,) and attitude (3, 3), from those near by."""
    for _ in range(8):
        end, at, derivatives = foot(angles, side)
        off = turn @ at.T
        error = np.concatenate((place - end, 0.5 * (off - off.T)[[2, 0, 1], [1, 2, 0]]))
        if np.abs(error).max() < 1e-5:
            break
        angles = angles + np.linalg.solve(derivatives.T @ derivatives + 1e-6 * np.eye(6), derivatives.T @ error)
        angles[3] = max(angles[3], 0.05)
    return angles


class Gait:
    """`step` gives the legs' angles for a velocity; `stance` is the leg that stands."""

    def __init__(self) -> None:
        self.stance, self._time_s, self._steps = 1, 0.0, 0
        self._path = np.zeros(3)  # x, y, heading of the body without its sway
        self._feet = {side: self._beside(self._path, side) for side in (1, -1)}
        self._swing_from = self._feet[-1]
        self._angles = {1: BENT, -1: BENT}

    @staticmethod
    def _beside(path: np.ndarray, side: int) -> np.ndarray:
        x, y, heading = path
        return np.array([x - side * STANCE_M * math.sin(heading), y + side * STANCE_M * math.cos(heading), heading])

    def _ahead(self, velocity: np.ndarray, seconds: float) -> np.ndarray:
        """The path some time on."""
        turn = rotation(2, self._path[2] + 0.5 * seconds * velocity[2])
        return self._path + seconds * np.append(turn[:2, :2] @ velocity[:2], velocity[2])

    def step(self, seconds: float, velocity: np.ndarray, lean_rad: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Angles (2, 6) of the left and the right leg. velocity: forward, left (m/s), turn (rad/s); lean_rad: roll,
        pitch; rates: of these (rad/s).
        """
        self._path = self._ahead(velocity, seconds)
        self._time_s += seconds
        if self._time_s >= STEP_S:
            self._time_s -= STEP_S
            self.stance, self._steps = -self.stance, min(self._steps + 1, STEPS_TO_START)
            self._swing_from = self._feet[-self.stance]
        begun, phase, swinging = self._steps / STEPS_TO_START, self._time_s / STEP_S, -self.stance
        target = self._beside(self._ahead(velocity, 1.5 * STEP_S - self._time_s), swinging)
        part = min(max((phase - FIRST) / (LAST - FIRST), 0.0), 1.0)
        self._feet[swinging] = self._swing_from + (0.5 - 0.5 * math.cos(math.pi * part)) * (target - self._swing_from)
        lift_m = begun * LIFT_M * math.sin(math.pi * part) ** 2
        per_s = math.sqrt(GRAVITY / PENDULUM_M)
        sway = 1.0 - math.cosh((self._time_s - 0.5 * STEP_S) * per_s) / math.cosh(0.5 * STEP_S * per_s)
        body = self._path[:2] + begun * sway * (self._beside(self._path, self.stance) - self._path)[:2]
        push = PUSH * lean_rad + DAMPING * rates
        both = []
        for side in (1, -1):
            x, y = rotation(2, -self._path[2])[:2, :2] @ (self._feet[side][:2] - body)
            place = np.array([AHEAD_M + x, y, (lift_m if side == swinging else 0.0) - HIP_M])
            turn = rotation(2, self._feet[side][2] - self._path[2])
            self._angles[side] = leg(place, turn, side, self._angles[side])
            stands = side == self.stance or part in (0.0, 1.0)
            both.append(self._angles[side] + (np.array([0, 0, 0, 0, push[1], push[0]]) if stands else 0.0))
        return np.array(both)
