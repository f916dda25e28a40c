"""What both particle filters share: how particles start, and how much noise their motion gets."""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field

from touchline.config import Settings
from touchline.geometry import FloatArray
from touchline.localization.matching.global_search import Region
from touchline.motion.odometry import Motion


class ParticleMotionSettings(Settings):
    """The motion model's noise, in proportion to the motion; on top of the odometry's own uncertainty."""

    travel_share: float = Field(
        0.1, ge=0, description="noise along and across per travel (m/m): wheels err by 3 %, more when they slip"
    )
    turn_share: float = Field(0.1, ge=0, description="noise of the heading per turn (rad/rad): as travel_share")
    bend_rad_per_m: float = Field(
        0.05, ge=0, description="noise of the heading per travel (rad/m): wheels that slip turn the robot"
    )
    rest_m: float = Field(
        0.03,
        ge=0,
        description="noise per cycle even at rest (m): parts equal particles; the samples of a cycle lie 0.7 m apart",
    )
    rest_rad: float = Field(0.01, ge=0, description="noise of the heading per cycle even at rest (rad): as rest_m")


def motion_deviations(motion: Motion, settings: ParticleMotionSettings) -> FloatArray:
    """Standard deviations (3,) along x and y of the robot (m) and of the heading (rad) of one particle's motion."""
    s = settings
    travel_m = math.hypot(motion.pose.x, motion.pose.y)
    position = (s.travel_share * travel_m) ** 2 + s.rest_m**2
    heading = (s.turn_share * motion.pose.heading) ** 2 + (s.bend_rad_per_m * travel_m) ** 2 + s.rest_rad**2
    deviations: FloatArray = np.sqrt(np.diag(motion.covariance) + np.array([position, position, heading]))
    return deviations


def spread_particles(
    rng: np.random.Generator,
    count: int,
    reach_m: FloatArray,
    region: Region,
    heading_rad: tuple[float, float] | None,
    symmetric: bool,
) -> FloatArray:
    """New particles (count, 3), evenly over a region within reach_m (2,) of the centre.

    heading_rad: mean and standard deviation; None: everywhere, or half the circle, where a symmetric field without a
    region shows the same from the other half.
    """
    low = np.maximum(-reach_m, [region.least_x, region.least_y])
    high = np.minimum(reach_m, [region.most_x, region.most_y])
    particles = np.empty((count, 3))
    particles[:, :2] = rng.uniform(low, high, (count, 2))
    if heading_rad is not None:
        particles[:, 2] = heading_rad[0] + heading_rad[1] * rng.standard_normal(count)
    else:
        half = symmetric and region == Region()
        particles[:, 2] = rng.uniform(-1.0, 1.0, count) * (0.5 * np.pi if half else np.pi)
    return particles
