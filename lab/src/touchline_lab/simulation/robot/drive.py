"""Driving from target to target within limits of speed and acceleration."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.geometry import FloatArray, IntArray
from touchline_lab.simulation.robot.track import STEP_S


class DriveLimits(NamedTuple):
    """What the robot can do, and how near a target it has to come before it turns to the next one.

    A pass_m above zero lets the robot go on to the next target without stopping once it is that near.
    """

    speed_m_s: float = 1.5
    acceleration_m_s2: float = 2.0
    turn_rad_s: float = 2.0
    turn_acceleration_rad_s2: float = 6.0
    pass_m: float = 0.0


@dataclass(frozen=True, eq=False)
class Jumps:
    """What happens to the robot from outside: rows (K,) of the track and what they do to the pose there.

    carried: rows at which it is put down elsewhere, and the poses (K, 3) there. shoved: (N, 3), field frame.
    """

    carried_rows: IntArray
    carried_to: FloatArray
    shoved: FloatArray

    @classmethod
    def none(cls, rows: int) -> Jumps:
        """Nothing ever happens."""
        return cls(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((rows, 3)))


def drive_through(targets: FloatArray, dwell_s: FloatArray, limits: DriveLimits, jumps: Jumps) -> FloatArray:
    """Poses (N, 3) of a holonomic robot that starts standing at targets[0] and drives through all, over and over.

    targets: (M, 3) x, y (m), heading (rad). dwell_s: (M,) time to stand at each. N is the number of shoved rows.
    A carried robot is put down standing and goes on to the target it was on its way to.
    """
    n = len(jumps.shoved)
    numbers = np.array([*limits, STEP_S])
    poses = np.empty((n, 3))
    _drive(targets, dwell_s, numbers, jumps.carried_rows, jumps.carried_to, jumps.shoved, poses)
    return poses


@njit(cache=True)
def _approach(speed: float, distance: float, fastest: float, acceleration: float, step: float) -> float:
    """The signed speed of the next step toward something at a signed distance, such that it can be stopped there."""
    size = abs(distance)
    # the speed from which braking at 80 % of the acceleration ends there, reached within this step
    wanted = min(fastest, math.sqrt(1.6 * acceleration * size), size / step)
    wanted = math.copysign(wanted, distance)
    change = min(max(wanted - speed, -acceleration * step), acceleration * step)
    return speed + change


@njit(cache=True)
def _drive(targets, dwell_s, numbers, carried_rows, carried_to, shoved, poses):  # type: ignore[no-untyped-def]
    """Fill poses (N, 3). numbers: speed, acceleration, turning rate and acceleration, pass distance, step."""
    fastest, acceleration, turn_fastest, turn_acceleration, pass_m, step = numbers
    x, y, heading = targets[0]
    vx, vy, turn = 0.0, 0.0, 0.0
    aim, waiting, next_carried = 0, dwell_s[0], 0
    for row in range(len(poses)):
        if row > 0:
            gap_x, gap_y = targets[aim, 0] - x, targets[aim, 1] - y
            distance = math.sqrt(gap_x * gap_x + gap_y * gap_y)
            gap = (targets[aim, 2] - heading + math.pi) % (2.0 * math.pi) - math.pi
            speed = math.sqrt(vx * vx + vy * vy)
            here = distance < 0.002 and speed < 0.05 and abs(gap) < 0.002 and abs(turn) < 0.05
            if here:
                vx, vy, turn = 0.0, 0.0, 0.0
                waiting -= step
            if (here and waiting <= 0.0) or distance < pass_m:
                aim = (aim + 1) % len(targets)
                waiting = dwell_s[aim]
            elif not here:
                wanted = min(fastest, math.sqrt(1.6 * acceleration * distance), distance / step)
                if pass_m > 0.0:  # slow enough to turn off, not to stop
                    wanted = min(fastest, wanted + 0.5)
                if distance > 0.0:
                    change_x, change_y = wanted * gap_x / distance - vx, wanted * gap_y / distance - vy
                else:
                    change_x, change_y = -vx, -vy
                change = math.sqrt(change_x * change_x + change_y * change_y)
                share = min(1.0, acceleration * step / change) if change > 0.0 else 0.0
                vx += share * change_x
                vy += share * change_y
                turn = _approach(turn, gap, turn_fastest, turn_acceleration, step)
            x += vx * step + shoved[row, 0]
            y += vy * step + shoved[row, 1]
            heading += turn * step + shoved[row, 2]
            if next_carried < len(carried_rows) and row == carried_rows[next_carried]:
                x, y, heading = carried_to[next_carried]
                vx, vy, turn = 0.0, 0.0, 0.0
                next_carried += 1
        poses[row, 0], poses[row, 1], poses[row, 2] = x, y, heading
