"""A pose after a motion by the odometry, linearised: what every filter of a pose predicts with."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from touchline.geometry import FloatArray, Pose

SCALE_DRIFT = 0.0003  # change of the odometry's scales from frame to frame: another carpet, wheels that wear


class Scales(NamedTuple):
    """Relative errors of the odometry's forward travel, sideways travel and turn; of each or their deviations."""

    forward: float
    sideways: float
    turn: float


EXACT_SCALES = Scales(0.0, 0.0, 0.0)


class Step(NamedTuple):
    """One motion by the odometry, linearised: the pose after it, its derivatives by pose and scales (6, 6) and by the
    motion (3, 3).
    """

    pose: Pose
    by_state: FloatArray
    by_motion: FloatArray

    @property
    def by_pose(self) -> FloatArray:
        """(3, 3): derivative of the pose after it by the pose before."""
        return self.by_state[:3, :3]


def driven(pose: Pose, scales: Scales | FloatArray, motion: Pose) -> Step:
    """A pose after a motion `before_from_after`, whose parts are too short by scales (3,): ahead, aside, turning."""
    cosine, sine = math.cos(pose.heading), math.sin(pose.heading)
    ahead, left = motion.x * (1.0 + scales[0]), motion.y * (1.0 + scales[1])
    by_state = np.eye(6)
    by_state[0, 2] = -sine * ahead - cosine * left
    by_state[1, 2] = cosine * ahead - sine * left
    by_state[0, 3], by_state[1, 3] = cosine * motion.x, sine * motion.x
    by_state[0, 4], by_state[1, 4] = -sine * motion.y, cosine * motion.y
    by_state[2, 5] = motion.heading
    by_motion = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return Step(pose.compose(Pose(ahead, left, motion.heading * (1.0 + scales[2]))), by_state, by_motion)
