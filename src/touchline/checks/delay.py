"""How late the images' stamps are: poses by the lines follow the odometry of some time ago, and that time is found.

A constant delay shifts a pose by the way driven meanwhile. While the speed stays the same that can't be told from
another place; whenever the robot starts, stops or turns, it can. The poses must be of the lines alone: a filter's
follow the odometry that it is given.
"""

from typing import NamedTuple

import numpy as np

from touchline.geometry import FloatArray, wrap_angles
from touchline.types import Estimate, Samples

MAX_DELAY_S = 0.4  # that is looked for
_STEP_S = 0.01
_KEPT = 0.9  # of the steps: the worst are shoves
_MIN_STEPS = 20
_MAX_S = 2.0  # between two estimates: over a longer step odometry's own errors are what is seen


class Delay(NamedTuple):
    """How late the stamps are (s), and its standard deviation (s)."""

    late_s: float
    deviation_s: float


def find_delay(estimates: list[Estimate], odometry: Samples) -> Delay | None:
    """The delay at which the steps of estimates agree best with those of odometry, samples (M, 3) x, y, theta.

    Steps across a gap between the estimates don't count. None where too little is compared. How sure the delay is tells
    by how much the steps change with it: of a robot that stands, or goes at one speed, they don't.
    """
    if len(estimates) <= _MIN_STEPS or len(odometry) < 2:
        return None
    stamps_s = 1e-9 * np.array([estimate.stamp_ns - estimates[0].stamp_ns for estimate in estimates])
    times_s = 1e-9 * (odometry.stamp_ns - estimates[0].stamp_ns).astype(np.float64)
    path = np.column_stack((odometry.values[:, :2], np.unwrap(odometry.values[:, 2])))
    seen = base_steps(np.array([estimate.pose for estimate in estimates]))
    steps_s = np.diff(stamps_s)
    inside = (stamps_s[:-1] - MAX_DELAY_S >= times_s[0]) & (steps_s <= _MAX_S)
    if np.count_nonzero(inside) < _MIN_STEPS:
        return None
    shifts = np.arange(-0.1, MAX_DELAY_S + 1e-9, _STEP_S)
    costs = np.array([_disagreement(seen, _shifted(path, times_s, stamps_s - shift), inside) for shift in shifts])
    k = int(np.argmin(costs))
    if not 0 < k < len(shifts) - 1:
        return None
    bend = costs[k - 1] - 2.0 * costs[k] + costs[k + 1]
    if bend <= 0.0:
        return None
    late = shifts[k] + 0.5 * _STEP_S * (costs[k - 1] - costs[k + 1]) / bend
    before, after = (_shifted(path, times_s, stamps_s - shifts[k] - way)[inside] for way in (-_STEP_S, _STEP_S))
    information = float(np.sum(((after - before) / (2.0 * _STEP_S)) ** 2))
    freedom = 2.0 * float(np.count_nonzero(inside))
    return Delay(float(late), float(np.sqrt(costs[k] / (freedom * max(information, 1e-12)))))


def _shifted(path: FloatArray, times_s: FloatArray, at_s: FloatArray) -> FloatArray:
    """(N - 1, 3) steps of odometry between times (N,)."""
    return base_steps(np.column_stack([np.interp(at_s, times_s, column) for column in path.T]))


def base_steps(poses: FloatArray) -> FloatArray:
    """(N - 1, 3) steps between poses (N, 3): forward, left (m) and turn (rad) of the robot, by the heading half way."""
    moved = np.diff(poses[:, :2], axis=0) @ np.array([1.0, 1j])
    turn = wrap_angles(np.diff(poses[:, 2]))
    local = moved * np.exp(-1j * (poses[:-1, 2] + 0.5 * turn))
    return np.column_stack((local.real, local.imag, turn))


def _disagreement(seen: FloatArray, driven: FloatArray, inside: FloatArray) -> float:
    """Sum of squared differences of steps (N, 3) but the worst, a radian like a metre; the scale of each axis of
    odometry is fitted.
    """
    a, b = driven[inside], seen[inside]
    scale = np.sum(a * b, axis=0) / np.maximum(np.sum(a * a, axis=0), 1e-9)
    squares = np.sort(np.sum((b - np.clip(scale, 0.8, 1.25) * a) ** 2, axis=1))
    return float(np.sum(squares[: int(_KEPT * len(squares))]))
