"""Where the other robots and the balls are over a run: standing about, or playing, often close to our robot."""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from touchline.field import FieldModel
from touchline.geometry import FloatArray
from touchline_lab.simulation.robot.drive import DriveLimits, Jumps, drive_through
from touchline_lab.simulation.robot.motions import random_pose
from touchline_lab.simulation.robot.track import STEP_S, Track
from touchline_lab.simulation.scenario import Scenario

_STRIDE = 5  # rows of the track per row of the others: 50 ms
_APART_M = 0.58  # between the centres of two robots
_TRIES = 60


@dataclass(frozen=True, eq=False)
class Others:
    """robots: float32 (M, K, 3) x, y, heading at rows _STRIDE apart; balls: float32 (M, B, 2); people (M, P, 3)."""

    robots: FloatArray
    balls: FloatArray
    people: FloatArray

    def rows_at(self, time_s: float) -> tuple[int, int, float]:
        """The rows before and after a time, and the second one's share."""
        position = min(max(time_s / (STEP_S * _STRIDE), 0.0), len(self.robots) - 1.0)
        row = min(int(position), max(len(self.robots) - 2, 0))
        return row, min(row + 1, len(self.robots) - 1), position - row

    def at(self, time_s: float) -> tuple[FloatArray, FloatArray]:
        """Robots and people (K + P, 3) x, y (m), heading (rad) and balls (B, 2) x, y (m) at a time; field frame."""
        row, after, part = self.rows_at(time_s)
        robots, balls, people = (
            ((1.0 - part) * table[row] + part * table[after]).astype(np.float64)
            for table in (self.robots, self.balls, self.people)
        )
        return np.concatenate((robots, people)), balls


def bodies_at(others: Others, time_s: float, sizes: FloatArray, person_sizes: FloatArray) -> FloatArray:
    """(P K + B, 4) x, y (m, field frame), radius, height (m) of what the others hide lines with at a time.

    sizes: (P + 1, 2) radius, height of the cylinders that stand for a robot, one on another, and of a ball;
    person_sizes: the same for people, whose bodies come last, and of nothing.
    """
    rows = others.rows_at(time_s)
    bodies: FloatArray = _bodies(others.robots, others.balls, rows, sizes)
    if others.people.shape[1] == 0:
        return bodies
    return np.concatenate((bodies, _bodies(others.people, others.balls[:, :0], rows, person_sizes)))


@njit(cache=True)
def _bodies(robots, balls, rows, sizes):  # type: ignore[no-untyped-def]
    """What `bodies_at` says, of the tables of `Others`; rows: of `Others.rows_at`."""
    row, after, share = rows
    near, far, parts = np.float32(1.0 - share), np.float32(share), len(sizes) - 1
    count = robots.shape[1]
    table = np.empty((parts * count + balls.shape[1], 4))
    for i in range(len(table)):
        places, k = (robots, i % count) if i < parts * count else (balls, i - parts * count)
        size = sizes[i // count] if i < parts * count else sizes[parts]
        for axis in range(2):
            table[i, axis] = near * places[row, k, axis] + far * places[after, k, axis]
        table[i, 2], table[i, 3] = size[0], size[1]
    return table


def make_others(scenario: Scenario, field: FieldModel, track: Track, rng: np.random.Generator) -> Others:
    """The others' tracks. Whoever would stand where our robot is gets out of its way."""
    settings = scenario.others
    own = track.poses[::_STRIDE, :2]
    robots = np.empty((len(own), settings.robots, 3), dtype=np.float32)
    for index, robot_rng in enumerate(rng.spawn(settings.robots)):
        if not settings.moving:
            robots[:, index] = _standing(field, own, robots[0, :index], robot_rng)
        elif settings.near_m > 0.0 and index % 2 == 0:
            robots[:, index] = _playing(scenario, field, robot_rng, own, settings.near_m)
        else:
            robots[:, index] = _playing(scenario, field, robot_rng, None)[: len(own)]
    for _ in range(3 if settings.moving else 1):
        _keep_apart(own, robots)
    for index in range(settings.robots):  # whatever they do among themselves
        _push_out(own, robots[:, index])
    np.clip(robots[..., 0], *_reach(field.length + 2.0 * field.border), out=robots[..., 0])
    np.clip(robots[..., 1], *_reach(field.width + 2.0 * field.border), out=robots[..., 1])
    balls = np.empty((len(own), settings.balls, 2), dtype=np.float32)
    for index, ball_rng in enumerate(rng.spawn(settings.balls)):
        balls[:, index] = _rolling(field, len(own), settings.moving, ball_rng)
    people = np.empty((len(own), settings.people, 3), dtype=np.float32)
    for index, person_rng in enumerate(rng.spawn(settings.people)):
        people[:, index] = _playing(scenario, field, person_rng, own, settings.people_m)
    if settings.people:
        _keep_apart(own, people)
    return Others(robots, balls, people)


def _reach(size_m: float) -> tuple[float, float]:
    """How far robots may be pushed over a carpet of a size: half a metre beyond it, where the hall still has room."""
    return -0.5 * size_m - 0.5, 0.5 * size_m + 0.5


def _standing(field: FieldModel, own: FloatArray, placed: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(3,) a place clear of the way of our robot and of those that stand already, if there is one."""
    best, best_gap = random_pose(field, 0.3, rng), -1.0
    for _ in range(_TRIES):
        pose = random_pose(field, 0.3, rng)
        gap = float(np.min(np.hypot(*(own - pose[:2]).T)))
        if len(placed):
            gap = min(gap, float(np.min(np.hypot(*(placed[:, :2] - pose[:2]).T))))
        if gap > best_gap:
            best, best_gap = pose, gap
        if gap > 0.9:
            break
    return best


def _playing(
    scenario: Scenario, field: FieldModel, rng: np.random.Generator, about: FloatArray | None, near: float = 0.0
) -> FloatArray:
    """(M, 3) a robot that drives from aim to aim; with `about` (M, 2), one that circles about that moving place, on
    average `near` (m) from it."""
    limits = DriveLimits(scenario.others.speed_m_s, 2.0, 3.0, 9.0, 0.5)
    rows = math.ceil(scenario.seconds / STEP_S) + 11 + _STRIDE
    if about is None:
        targets = np.array([random_pose(field, 0.3, rng) for _ in range(500)])
        return drive_through(targets, np.zeros(len(targets)), limits, Jumps.none(rows))[::_STRIDE]
    count = 500
    angles = rng.uniform(-math.pi, math.pi) + np.cumsum(rng.normal(0.0, 0.9, count))
    reach = near * rng.uniform(0.55, 1.6, count)
    aims = np.column_stack((reach * np.cos(angles), reach * np.sin(angles), rng.uniform(-math.pi, math.pi, count)))
    slow = DriveLimits(min(1.0, limits.speed_m_s), 1.5, 2.0, 6.0, 0.2)
    around = drive_through(aims, np.zeros(count), slow, Jumps.none(rows))[::_STRIDE][: len(about)]
    around[:, :2] += _followed(about, limits.speed_m_s)
    half_x, half_y = 0.5 * field.length + 0.4, 0.5 * field.width + 0.4
    around[:, 0] = np.clip(around[:, 0], -half_x, half_x)
    around[:, 1] = np.clip(around[:, 1], -half_y, half_y)
    return around


def _followed(about: FloatArray, speed_m_s: float) -> FloatArray:
    """(M, 2) a place that follows another with a bounded step, so that a carried robot leaves its opponents behind."""
    step = speed_m_s * STEP_S * _STRIDE
    followed = np.empty_like(about)
    place = about[0].copy()
    for row, goal in enumerate(about):
        gap = goal - place
        distance = math.hypot(*gap)
        place = place + gap * min(1.0, step / distance) if distance > 0.0 else place
        followed[row] = place
    return followed


def _keep_apart(own: FloatArray, robots: FloatArray) -> None:
    """Move robots (M, K, 3), in place, out of each other and of our own (M, 2), which moves for nobody."""
    for index in range(robots.shape[1]):
        for other in range(-1, index):
            _push_out(own if other < 0 else robots[:, other, :2], robots[:, index])


def _push_out(places: FloatArray, robot: FloatArray) -> None:
    """Move a robot (M, 3), in place, straight away from places (M, 2) that it is too near to."""
    gap = robot[:, :2] - places
    gap[np.hypot(gap[:, 0], gap[:, 1]) < 1e-3] = (1e-3, 0.0)
    distance = np.hypot(gap[:, 0], gap[:, 1])
    near = distance < _APART_M
    robot[near, :2] = places[near] + gap[near] * (_APART_M / distance[near])[:, np.newaxis]


def _rolling(field: FieldModel, rows: int, moving: bool, rng: np.random.Generator) -> FloatArray:
    """(M, 2) a ball that lies, or that is played from place to place."""
    place = random_pose(field, 0.5, rng)
    if not moving:
        return np.tile(place[:2], (rows, 1))
    targets = np.array([random_pose(field, 0.3, rng) for _ in range(300)])
    limits = DriveLimits(3.0, 1.5, 1.0, 3.0, 0.3)
    path = drive_through(targets, np.zeros(len(targets)), limits, Jumps.none(rows * _STRIDE))
    return path[::_STRIDE, :2][:rows]
