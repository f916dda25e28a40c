"""The particle filter on the error map (Ismail et al. 2021, section II.C, figure 8).

particles ─▶ motion from odometry ─▶ points to the field (7) ─▶ error map (8) ─▶ product (9) ─▶ normalised
    ▲                                                                                              │
    └──────── low-variance resampling (10) ◀───────────────────────────────────────────────────────┘
                    └─▶ means (11) to (14)
"""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field

from touchline.config import Settings
from touchline.field import FieldModel
from touchline.field.error_map import FARTHEST, error_map
from touchline.geometry import FloatArray, Pose
from touchline.localization.matching.global_search import Region
from touchline.localization.matching.matcher import as_pose
from touchline.localization.particles.kernels import (
    add_log_likelihoods,
    mean_and_covariance,
    move,
    normalize,
    resample,
    tempering,
)
from touchline.localization.particles.models import ParticleMotionSettings, motion_deviations, spread_particles
from touchline.motion.odometry import Motion

_DIMENSIONS = 3


class MeasuredMotionSettings(ParticleMotionSettings):
    """The motion model's noise on top of the odometry's own: less than for driven wheels, these measure."""

    travel_share: float = Field(
        0.02, ge=0, description="noise along and across per travel (m/m): twice what measuring wheels err by"
    )
    turn_share: float = Field(0.02, ge=0, description="noise of the heading per turn (rad/rad): twice a gyro's scale")
    bend_rad_per_m: float = Field(0.0, ge=0, description="noise of the heading per travel (rad/m): the gyro has none")
    rest_m: float = Field(0.01, ge=0, description="noise per cycle even at rest (m): parts equal particles")
    rest_rad: float = Field(0.003, ge=0, description="noise of the heading per cycle even at rest (rad): as rest_m")


class ParticleFilterSettings(Settings):
    """The paper gives 600 particles, 256 steps of the map, the models and the resampling; nothing else."""

    particles: int = Field(600, ge=1, description="particles; the paper's 600")
    particles_all_headings: int = Field(
        6000,
        ge=1,
        description="particles at a start with headings all around: ten for each of 600 places; between this and "
        "`particles`, in proportion to how wide the headings are spread",
    )
    beyond_m: float = Field(1.0, ge=0, description="how far beyond the field particles start (m): the robot's margin")
    compass_rad: float = Field(
        0.15, ge=0, description="standard deviation of the first headings about the compass (rad): 5 degrees and more"
    )
    known_heading_rad: float = Field(
        0.8,
        ge=0,
        description="standard deviation of the first headings about the one known before the robot was lost, without a "
        "compass (rad), beside what odometry may have gone wrong: a robot may have been turned, hardly to the other "
        "goal",
    )
    farthest_m: float = Field(
        1.0, gt=0, description="distance from a line at which the map's error is 255 (m): half way between most lines"
    )
    map_m: float = Field(0.05, gt=0, description="distance of the error map's samples (m): a thin line's width")
    sigma_units: float = Field(
        64.0,
        gt=0,
        description="the σ of equation (8) in units of the map: 64 are 0.25 m with farthest_m 1; with some hundred "
        "points the product (9) is then 3 cm wide, as wide as particles lie apart",
    )
    worst_units: float = Field(
        128.0,
        gt=0,
        le=FARTHEST,
        description="error (units of the map) from which a point counts no worse: points on goals, robots and beyond "
        "the field lie on no line, many of them on one side; half a metre still leads to the lines; 255 is the paper's",
    )
    least_effective: float = Field(
        0.1,
        ge=0,
        le=1,
        description="share of effective particles below which the product (9) is tempered (raised to a power below 1): "
        "while few particles are near the robot the best of them must not take all weight; 0 is the paper's form",
    )
    roughening: float = Field(
        0.3,
        ge=0,
        description="noise of drawn particles: this share of their extent (four standard deviations) over the cube "
        "root of their number, so that copies search between the originals (Gordon, Salmond, Smith 1993); 0 is the "
        "paper's form",
    )
    nearby_share: float = Field(
        0.1,
        ge=0,
        lt=1,
        description="share of particles that are moved to about the fused pose in every cycle: they find a robot that "
        "slipped or was shoved, and they speak for the odometry when an image is bad; 0 is the paper's form",
    )
    nearby_m: float = Field(0.25, gt=0, description="standard deviation of their x and y (m): a shove is 0.1 to 0.3")
    nearby_rad: float = Field(0.05, gt=0, description="standard deviation of their heading (rad): the gyro feels turns")
    motion: MeasuredMotionSettings = MeasuredMotionSettings()


class ParticleFilter:
    """Particles on one field. `particles` (N, 3): x, y (m), heading (rad), field frame.

    `pose` and `covariance` (3, 3): equations (11) to (14) and the spread of the particles drawn last, the pose moved
    on by the odometry since. `exponent`: of the last tempering, 1 if there was none.
    """

    def __init__(
        self, field: FieldModel, rng: np.random.Generator, settings: ParticleFilterSettings | None = None
    ) -> None:
        self.settings = s = settings or ParticleFilterSettings()
        self.rng = rng
        self.pose = Pose(0.0, 0.0, 0.0)
        self.symmetric = field.is_symmetric
        self._reach_m = 0.5 * np.array([field.length, field.width]) + s.beyond_m
        self.map = error_map(field, s.map_m, s.farthest_m)
        self._squares = np.minimum(self.map.values.astype(np.float32), np.float32(s.worst_units)) ** 2
        self.restart(None)

    def restart(
        self, heading_rad: float | None, region: Region | None = None, deviation_rad: float | None = None
    ) -> None:
        """Spread the particles over the field or a region of it, their headings about one (rad), or everywhere.

        On a symmetric field without a region half the circle does, about the heading or about 0: it holds one of every
        two poses that look the same. deviation_rad: of the headings, by default the compass's; the wider, the more
        particles.
        """
        s, headings_rad = self.settings, None
        count = most = max(s.particles, s.particles_all_headings)
        if heading_rad is not None:
            deviation_rad = min(s.compass_rad if deviation_rad is None else deviation_rad, math.pi)
            headings_rad = heading_rad, deviation_rad
            if deviation_rad <= s.compass_rad:
                count = s.particles
            elif s.compass_rad > 0.0:
                count = min(round(s.particles * deviation_rad / s.compass_rad), most)
        area = region or Region()
        self.particles = spread_particles(self.rng, count, self._reach_m, area, headings_rad, self.symmetric)
        if heading_rad is not None and self.symmetric and region is None:
            self.particles[:, 2] -= math.pi * np.round((self.particles[:, 2] - heading_rad) / math.pi)
        self._roughness = np.zeros(3)
        self.exponent = 1.0
        self._estimate()

    def start_at(self, pose: Pose, covariance: FloatArray) -> None:
        """Start about a pose that is known with a covariance (3, 3)."""
        drawn = self.rng.multivariate_normal(pose.as_array(), covariance, self.settings.particles, method="cholesky")
        self.particles = np.ascontiguousarray(drawn)
        self._roughness = np.zeros(3)
        self.exponent = 1.0
        self._estimate()

    def move(self, motion: Motion) -> None:
        """Every particle moves by the odometry's motion, with noise of its own."""
        deviations = np.hypot(motion_deviations(motion, self.settings.motion), self._roughness)
        self._roughness = np.zeros(3)
        move(self.particles, motion.pose.as_array(), deviations, self.rng.standard_normal(self.particles.shape))
        self.pose = self.pose.compose(motion.pose)

    def put_nearby(self, pose: Pose) -> None:
        """Move the share of particles that stays about a pose there."""
        s = self.settings
        count = int(s.nearby_share * len(self.particles))
        if count:
            deviations = np.array([s.nearby_m, s.nearby_m, s.nearby_rad])
            near = pose.as_array() + deviations * self.rng.standard_normal((count, 3))
            self.particles[:: len(self.particles) // count][:count] = near

    def keep_within(self, region: Region, moved: Pose) -> None:
        """Particles that were outside of a region before a motion take the places of others, unless all were.

        moved: before_from_after.
        """
        headings = self.particles[:, 2] - moved.heading
        cosine, sine = np.cos(headings), np.sin(headings)
        x = self.particles[:, 0] - cosine * moved.x + sine * moved.y
        y = self.particles[:, 1] - sine * moved.x - cosine * moved.y
        inside = (x >= region.least_x) & (x <= region.most_x) & (y >= region.least_y) & (y <= region.most_y)
        kept = self.particles[inside]
        if 0 < len(kept) < len(inside):
            self.particles[~inside] = kept[self.rng.integers(len(kept), size=len(inside) - len(kept))]

    def cycle(self, points: FloatArray) -> Pose:
        """Equations (7) to (14) for line points (M, 2) in the robot frame (m), M > 0; returns the mean."""
        log_weights = self.log_likelihoods(points, self.particles)
        least = self.settings.least_effective * self.settings.particles
        self.exponent = float(tempering(log_weights, least)) if least > 1.0 else 1.0
        weights = np.empty(len(self.particles))
        normalize(self.exponent * log_weights, weights)
        drawn = np.empty((self.settings.particles, 3))
        resample(self.particles, weights, float(self.rng.random()), drawn)
        self.particles = drawn
        self._estimate()
        self._roughen()
        return self.pose

    def log_likelihoods(self, points: FloatArray, poses: FloatArray) -> FloatArray:
        """Logarithm of equation (9) (K,) for poses (K, 3); points (M, 2) in the robot frame, m."""
        found = np.zeros(len(poses))
        alike = np.ones(len(points))
        factor = 0.5 / self.settings.sigma_units**2
        origin_x, origin_y = self.map.origin_m
        add_log_likelihoods(
            poses, points, alike, self._squares, origin_x, origin_y, self.map.resolution_m, factor, found
        )
        return found

    def errors_m(self, points: FloatArray, pose: Pose) -> FloatArray:
        """Errors (M,) of points (M, 2) seen from a pose, in metres: distances, but for the map's steps and its end."""
        errors: FloatArray = self.map.look_up(pose.transform(points)) * (self.map.farthest_m / FARTHEST)
        return errors

    @property
    def spread_m(self) -> float:
        """Standard deviation of the particles' position (m)."""
        return math.sqrt(self.covariance[0, 0] + self.covariance[1, 1])

    @property
    def spread_rad(self) -> float:
        """Standard deviation of the particles' headings (rad)."""
        return math.sqrt(self.covariance[2, 2])

    def _estimate(self) -> None:
        """Equations (11), (12) and (14), whose f (13) is the arc tangent of both arguments; and the spread."""
        alike = np.full(len(self.particles), 1.0 / len(self.particles))
        mean, self.covariance = mean_and_covariance(self.particles, alike)
        self.pose = as_pose(mean)

    def _roughen(self) -> None:
        """The noise that the particles just drawn get when they move next."""
        share = 4.0 * self.settings.roughening * len(self.particles) ** (-1.0 / _DIMENSIONS)
        along = math.sqrt(0.5) * self.spread_m
        self._roughness = share * np.array([along, along, self.spread_rad])


__all__ = ["MeasuredMotionSettings", "ParticleFilter", "ParticleFilterSettings"]
