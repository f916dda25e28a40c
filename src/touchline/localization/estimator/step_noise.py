"""How noisy motions are: as the odometry's settings state on wheels; learned from the images on legs.

Feet slip, turn on the spot and sway at rest, each robot's otherwise: the variance of its steps is a multiple of what is
usual, found by expectation maximisation.
"""

import math

import numpy as np

from touchline.geometry import FloatArray
from touchline.localization.estimator.filter import Filter
from touchline.localization.registration.joint import StateFit
from touchline.motion.odometry import Motion

SLIP_RATIO, TURN_SLIP_RATIO, BEND_RAD_M = 0.1, 0.1, 0.05  # noise of steps beside the odometry's own
REST_M, REST_RAD = 0.007, 0.001
GAIN = 0.1  # share of an image in what is learned
MIN_FACTOR, MAX_FACTOR = 0.1, 6.0  # of the variances of steps, as a multiple of the usual ones
MAX_RATIO = 5.0  # of one image in that: it may be a slip


class StepNoise:
    """`factors` (2,): how much larger the variance of motions is than usual, of positions and of headings."""

    def __init__(self, walks: bool) -> None:
        """walks: whether the robot has legs; wheels err as the odometry's settings state."""
        self.walks = walks
        self.reset()

    def reset(self) -> None:
        """Nothing has been learned."""
        self.factors = 1.0, 1.0

    def of(self, motion: Motion) -> FloatArray:
        """(3, 3) of a motion, (m, m, rad), robot frame before it."""
        if not self.walks:
            return motion.covariance
        move, travel_m = motion.pose, math.hypot(motion.pose.x, motion.pose.y)
        slip2 = (SLIP_RATIO * travel_m) ** 2 + REST_M**2
        turn2 = (TURN_SLIP_RATIO * move.heading) ** 2 + (BEND_RAD_M * travel_m) ** 2 + REST_RAD**2
        a, b = map(math.sqrt, self.factors) if motion.missing_s == 0.0 else (1.0, 1.0)
        (xx, xy, xt), (yx, yy, yt), (tx, ty, tt) = motion.covariance.tolist()
        return np.array([
            [(xx + slip2) * (a * a), xy * (a * a), xt * (a * b)],
            [yx * (a * a), (yy + slip2) * (a * a), yt * (a * b)],
            [tx * (b * a), ty * (b * a), (tt + turn2) * (b * b)],
        ])  # fmt: skip

    def learn(self, one: Filter, fit: StateFit, per_image: FloatArray) -> None:
        """Learn from an image the noise of the motion before it, by the hypothesis that it is about to correct."""
        if not self.walks:
            return
        (x2, y2, turn2), (x, y, turn) = one.motion_error(fit, per_image)
        if turn == 0.0:
            return
        place, heading = self.factors
        self.factors = _learned(place, (x2 + y2) / (x + y)), _learned(heading, turn2 / turn)


def _learned(factor: float, ratio: float) -> float:
    """A factor after an image whose squared error is so many times what was expected."""
    return min(max(factor * (1.0 + GAIN * (min(ratio, MAX_RATIO) - 1.0)), MIN_FACTOR), MAX_FACTOR)
