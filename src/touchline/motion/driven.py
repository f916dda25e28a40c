"""A pose after a motion by the odometry, linearised: what every filter of a pose predicts with."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.geometry import FloatArray, Pose, wrap_angle

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
    by_state, by_motion = np.empty((6, 6)), np.empty((3, 3))
    x, y, heading = linearise(pose.as_array(), np.array(scales), motion.as_array(), by_state, by_motion)
    return Step(Pose(x, y, wrap_angle(heading)), by_state, by_motion)


@njit(cache=True)
def linearise(pose, scales, motion, by_state, by_motion):  # type: ignore[no-untyped-def]
    """`driven` for compiled loops, all (3,): x, y (m), heading (rad, not wrapped) after it; by_state (6, 6), by_motion
    (3, 3): to be overwritten.
    """
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    ahead, left = motion[0] * (1.0 + scales[0]), motion[1] * (1.0 + scales[1])
    for a in range(6):
        for b in range(6):
            by_state[a, b] = 1.0 if a == b else 0.0
    by_state[0, 2] = -sine * ahead - cosine * left
    by_state[1, 2] = cosine * ahead - sine * left
    by_state[0, 3], by_state[1, 3] = cosine * motion[0], sine * motion[0]
    by_state[0, 4], by_state[1, 4] = -sine * motion[1], cosine * motion[1]
    by_state[2, 5] = motion[2]
    by_motion[0, 0] = by_motion[1, 1] = cosine
    by_motion[0, 1], by_motion[1, 0] = -sine, sine
    by_motion[0, 2] = by_motion[1, 2] = by_motion[2, 0] = by_motion[2, 1] = 0.0
    by_motion[2, 2] = 1.0
    x, y = pose[0] + cosine * ahead - sine * left, pose[1] + sine * ahead + cosine * left
    return x, y, pose[2] + motion[2] * (1.0 + scales[2])
