"""False points at goals: threads of nets and white frames, which a detector takes for lines on the carpet behind them.

A thread at a height is seen before a place on the ground that lies further away; a point is found there only if green
follows beyond it. So from afar only what is low gives points, close to the goal's own foot, and they grow in number
as the goal comes near. Most of the heading's error at goals comes of points within half a metre of the goal line.
"""

import math
from collections.abc import Sequence

import numpy as np
from numba import njit
from pydantic import Field

from touchline.config import Settings
from touchline.geometry import FloatArray
from touchline_lab.simulation.observation.crossings import FLANK, hidden, scale_at, through_mouth
from touchline_lab.simulation.observation.fixed_noise import phase_noise

PLACES, NET_PLACES = 150, 100  # per goal; how many of them on the net behind
_NET_M, _SIDE_M = 0.4, 0.5  # up to these heights they lie, most of them low; higher threads are seen before no carpet
_MIN_RATIO = 0.3  # of that height, where the frame at the foot of the sides is coloured, not white
_TURN_RAD = 0.1  # after such a turn or
_WAY_M = 0.3  # such a way other false points are seen


class GoalClutter(Settings):
    """False points at a goal: mean number of the places there that the detector takes for lines, were all in view.

    It falls with the distance as a logistic function, that of the net from near by, too.
    """

    net_points: float = Field(52.6, ge=0, description="points on the net behind, seen between the posts from close by")
    net_half_m: float = Field(1.0, description="distance of the goal at which half of these are seen")
    net_slope_m: float = Field(0.475, gt=0, description="how fast that changes with the distance (logistic)")
    net_near_m: float = Field(0.0, ge=0, description="distance within which half are lost again: too thick; 0: none")
    side_points: float = Field(3.7, ge=0, description="points on posts and side nets, seen from close by")
    side_half_m: float = Field(5.12, description="distance of the goal at which half of these are seen")
    side_slope_m: float = Field(0.444, gt=0, description="how fast that changes with the distance (logistic)")

    def numbers(self) -> tuple[float, ...]:
        """All of them, in order."""
        return tuple(self.model_dump().values())


def thread_table(goals: FloatArray, white: Sequence[bool], seed: int) -> FloatArray:
    """(PLACES G, 3) places in each of the goals (G, 4), white or coloured, at which false points may be seen.

    x, y (field frame), height (m).
    """
    rng = np.random.default_rng([seed, 18])
    tables = []
    for (post_x, net_x, low, high), foot in zip(goals, white, strict=True):
        on_net, k = np.arange(PLACES) < NET_PLACES, np.arange(PLACES)
        along, aside, up = rng.random(PLACES), rng.standard_normal(PLACES), rng.random(PLACES)
        x = np.where(on_net, net_x, post_x + along * (net_x - post_x))
        y = np.where(on_net, low + along * (high - low), np.where(k % 2, low, high) + 0.05 * aside)
        side = up**2 if foot else _MIN_RATIO + (1.0 - _MIN_RATIO) * up
        tables.append(np.column_stack((x, y, np.where(on_net, _NET_M * up, _SIDE_M * side))))
    return np.concatenate([np.zeros((0, 3)), *tables])


@njit(cache=True, error_model="numpy")
def place_strays(pose, goals, threads, seed, view, places, count):  # type: ignore[no-untyped-def]
    """Append what is seen in goals (G, 4), with their numbers (G, 7) of `GoalClutter`, to places; how many there are.

    threads: of `thread_table`. Which give a point depends on the direction and distance from which they are seen.
    view: height, mouth, bodies, carpet, scales as of `seen_thread`.
    """
    x, y, heading = pose
    c, s = math.cos(heading), math.sin(heading)
    for g in range(len(goals[0])):
        goal, mean = goals[0][g], goals[1][g]
        distance = math.sqrt((goal[0] - x) ** 2 + (0.5 * (goal[2] + goal[3]) - y) ** 2)
        net = mean[0] / NET_PLACES / (1.0 + math.exp((distance - mean[1]) / mean[2]))
        if mean[3] > 0.0:
            net /= 1.0 + math.exp((mean[3] - distance) / mean[2])
        side = mean[4] / (PLACES - NET_PLACES) / (1.0 + math.exp((distance - mean[5]) / mean[6]))
        for k in range(PLACES):
            share = net if k < NET_PLACES else side
            if share < 1e-4:
                continue
            name = PLACES * g + k
            px, py = seen_thread(threads[name], k < NET_PLACES, x, y, view)
            if math.isnan(px):
                continue
            px, py = px - x, py - y
            seen = 0.8 * phase_noise(seed, 4096 + name, 10.0 + (heading + math.atan2(py, px)) / _TURN_RAD)
            seen += 0.6 * phase_noise(seed, 8192 + name, 10.0 + math.sqrt(px * px + py * py) / _WAY_M)
            if 0.5 * math.erfc(seen / math.sqrt(2.0)) < share:
                places[count, 0], places[count, 1] = c * px + s * py, c * py - s * px
                count += 1
    return count


@njit(cache=True, error_model="numpy")
def seen_thread(thread, on_net, x, y, view):  # type: ignore[no-untyped-def]
    """The ground (field frame, m) that a thread (3,) of `thread_table` is seen before from x, y; NaN if it is not seen.

    It is if neither the goal's sides nor bodies (K, 4) hide it and green follows beyond it: a detector's flank.
    view: height of the camera (m), mouth, bodies, carpet, scales, as of `crossings`.
    """
    view_m, mouth, bodies, carpet, scales = view
    px, py = thread[0], thread[1]
    if hidden(x, y, px, py, bodies) or (on_net and not through_mouth(x, y, px, py, mouth)):
        return np.nan, np.nan
    stretch = view_m / (view_m - thread[2])
    px, py = stretch * (px - x), stretch * (py - y)
    radius = math.sqrt(px * px + py * py)
    beyond = 1.0 + FLANK * scale_at(radius, scales, 0) / radius
    if not (abs(x + beyond * px) <= carpet[0] and abs(y + beyond * py) <= carpet[1]):  # or no scale known
        return np.nan, np.nan
    return x + px, y + py
