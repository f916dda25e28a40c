"""The motion model: every particle moves as the odometry says, with noise of its own."""

import math

import numba
import numpy as np
from pydantic import Field

from touchline.config import Settings
from touchline.geometry import FloatArray
from touchline.motion.odometry import Motion


class MotionNoise(Settings):
    """The motion model's noise: standard deviations that add up by their squares, as AMCL's α have them.

    They come on top of the odometry's own uncertainty.
    """

    translation_from_translation: float = Field(
        0.1, ge=0, description="noise of the position per distance driven (m/m): wheels err by 3 %, more when they slip"
    )
    rotation_from_rotation: float = Field(
        0.1, ge=0, description="noise of the heading per turn (rad/rad): as translation_from_translation"
    )
    rotation_from_translation_rad_per_m: float = Field(
        0.05, ge=0, description="noise of the heading per distance driven (rad/m): wheels that slip turn the robot"
    )
    translation_at_rest_m: float = Field(
        0.03,
        ge=0,
        description="noise of the position per cycle, at rest, too (m): parts equal particles; the samples of a cycle "
        "lie 0.7 m apart",
    )
    rotation_at_rest_rad: float = Field(
        0.01, ge=0, description="noise of the heading per cycle, at rest, too (rad): as translation_at_rest_m"
    )


class MotionModel:
    """P(l | l', a) of Lu et al. 2013, section 4: the odometry's motion and normally distributed noise."""

    def __init__(self, noise: MotionNoise | None = None) -> None:
        self.noise = noise or MotionNoise()

    def move(self, poses: FloatArray, motion: Motion, rng: np.random.Generator, more: FloatArray | None = None) -> None:
        """Move poses (N, 3), x, y (m), heading (rad), in place. more (3,): standard deviations of further noise."""
        deviations = self.deviations(motion)
        if more is not None:
            deviations = np.hypot(deviations, more)
        move(poses, motion.pose.as_array(), deviations, rng.standard_normal(poses.shape))

    def deviations(self, motion: Motion) -> FloatArray:
        """Standard deviations (3,) along x and y of the robot (m) and of the heading (rad) of one particle's motion."""
        s = self.noise
        driven_m = math.hypot(motion.pose.x, motion.pose.y)
        position = (s.translation_from_translation * driven_m) ** 2 + s.translation_at_rest_m**2
        heading = (
            (s.rotation_from_rotation * motion.pose.heading) ** 2
            + (s.rotation_from_translation_rad_per_m * driven_m) ** 2
            + s.rotation_at_rest_rad**2
        )
        return np.sqrt(np.diag(motion.covariance) + np.array([position, position, heading]))


@numba.njit(cache=True)
def move(poses, motion, deviations, normals):  # type: ignore[no-untyped-def]
    """Move poses (N, 3) by the odometry's motion (3,), `before_from_after`, and each by its own noise; in place.

    deviations (3,): standard deviations along x, y of the robot (m) and of the heading (rad). normals (N, 3): standard
    normal numbers.
    """
    for j in range(poses.shape[0]):
        cosine, sine = math.cos(poses[j, 2]), math.sin(poses[j, 2])
        ahead = motion[0] + deviations[0] * normals[j, 0]
        left = motion[1] + deviations[1] * normals[j, 1]
        poses[j, 0] += cosine * ahead - sine * left
        poses[j, 1] += sine * ahead + cosine * left
        poses[j, 2] += motion[2] + deviations[2] * normals[j, 2]
