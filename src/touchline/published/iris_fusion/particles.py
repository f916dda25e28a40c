"""The configuration of the particle filter on the error map (Ismail et al. 2021, section II.C, figure 8).

particles ─▶ motion from odometry ─▶ points to the field (7) ─▶ error map (8) ─▶ product (9) ─▶ normalised
    ▲                                                                                              │
    └──────── low-variance resampling (10) ◀───────────────────────────────────────────────────────┘
                    └─▶ means (11) to (14)
"""

import math

import numpy as np
from pydantic import Field

from touchline.config import Settings, added
from touchline.field import FieldModel
from touchline.field.error_map import MAX_ERROR, error_map
from touchline.field.region import Region
from touchline.geometry import FloatArray, Pose
from touchline.motion.odometry import Motion
from touchline.published.particles.motion_model import MotionModel, MotionNoise
from touchline.published.particles.particle_filter import ParticleFilter
from touchline.published.particles.particle_set import ParticleEstimate, ParticleSet
from touchline.published.particles.random_particles import BEYOND_M, UniformPoses
from touchline.published.particles.resampling import EVERY_CYCLE, Resampling
from touchline.published.particles.sensor_models import ErrorMapModel, LineView


class MeasuredMotionNoise(MotionNoise):
    """The motion model's noise on top of the odometry's own: less than for driven wheels, these measure."""

    translation_from_translation: float = Field(
        0.02, ge=0, description="noise of the position per distance driven (m/m): twice what measuring wheels err by"
    )
    rotation_from_rotation: float = Field(
        0.02, ge=0, description="noise of the heading per turn (rad/rad): twice a gyro's scale"
    )
    rotation_from_translation_rad_per_m: float = Field(
        0.0, ge=0, description="noise of the heading per distance driven (rad/m): the gyro has none"
    )
    translation_at_rest_m: float = Field(
        0.01, ge=0, description="noise of the position per cycle, at rest, too (m): parts equal particles"
    )
    rotation_at_rest_rad: float = Field(
        0.003, ge=0, description="noise of the heading per cycle, at rest, too (rad): as translation_at_rest_m"
    )


MAX_M = 1.0  # distance from a line at which the map's error is 255: half way between most lines
MAP_M = 0.05  # distance of the error map's samples: a thin line's width
NEARBY_M = 0.25  # standard deviation of their x and y: a shove is 0.1 to 0.3
NEARBY_RAD = 0.05  # standard deviation of their heading: the gyro feels turns


class IrisParticlePaper(Settings):
    """Switches to the paper's exact form."""

    max_units: float = added(
        128.0,
        paper=255.0,
        gt=0,
        le=MAX_ERROR,
        description="error (units of the map) from which a point counts no worse: points on goals, robots and beyond "
        "the field lie on no line, many of them on one side; half a metre still leads to the lines; 255 is the paper's",
    )
    tempering_threshold: float = added(
        0.1,
        paper=0.0,
        ge=0,
        le=1,
        description="ratio of effective particles below which the product (9) is tempered (raised to a power below 1): "
        "while few particles are near the robot the best of them must not take all weight; 0 is the paper's form",
    )
    roughening: float = added(
        0.3,
        paper=0.0,
        ge=0,
        description="noise of drawn particles: this ratio of their extent (four standard deviations) over the cube "
        "root of their number, so that copies search between the originals (Gordon, Salmond, Smith 1993); 0 is the "
        "paper's form",
    )
    nearby_ratio: float = added(
        0.1,
        paper=0.0,
        ge=0,
        lt=1,
        description="ratio of particles that are moved to about the fused pose in every cycle: they find a robot that "
        "slipped or was shoved, and they speak for the odometry when an image is bad; 0 is the paper's form",
    )


class IrisParticleSettings(Settings):
    """The paper gives 600 particles, 256 steps of the map, the models and the resampling; nothing else."""

    particles: int = Field(600, ge=1, le=10_000_000, description="particles; the paper's 600")
    particles_all_headings: int = Field(
        6000,
        ge=1,
        le=10_000_000,
        description="particles at a start with headings all around: ten for each of 600 places; between this and "
        "`particles`, in proportion to how wide the headings are spread",
    )
    compass_rad: float = Field(
        0.15, ge=0, description="standard deviation of the first headings about the compass (rad): 5 degrees and more"
    )
    sigma_units: float = Field(
        64.0,
        gt=0,
        description="the σ of equation (8) in units of the map: 64 are 0.25 m with farthest_m 1; with some hundred "
        "points the product (9) is then 3 cm wide, as wide as particles lie apart",
    )
    motion: MeasuredMotionNoise = MeasuredMotionNoise()
    paper: IrisParticlePaper = IrisParticlePaper()


class IrisParticles:
    """Particles on one field, drawn anew in every cycle. `filter`: the particle filter; `particles`: its set."""

    def __init__(
        self, field: FieldModel, rng: np.random.Generator, settings: IrisParticleSettings | None = None
    ) -> None:
        self.settings = s = settings or IrisParticleSettings()
        self.rng = rng
        self.symmetric = field.is_symmetric
        self._reach_m = 0.5 * np.array([field.length, field.width]) + BEYOND_M
        self.sensor_model = ErrorMapModel(error_map(field, MAP_M, MAX_M), s.sigma_units, s.paper.max_units)
        self.particles = ParticleSet(np.zeros((1, 3)))
        self.filter: ParticleFilter[LineView] = ParticleFilter(
            self.particles,
            MotionModel(s.motion),
            self.sensor_model,
            Resampling(EVERY_CYCLE, s.particles, s.paper.roughening, mean_of_drawn=True),
            rng,
            min_effective=s.paper.tempering_threshold * s.particles,
        )
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
        poses = UniformPoses(self._reach_m, region or Region(), headings_rad, self.symmetric).draw(self.rng, count)
        if heading_rad is not None and self.symmetric and region is None:
            poses[:, 2] -= math.pi * np.round((poses[:, 2] - heading_rad) / math.pi)
        self.filter.start(poses)

    def start_at(self, pose: Pose, covariance: FloatArray) -> None:
        """Start about a pose that is known with a covariance (3, 3)."""
        drawn = self.rng.multivariate_normal(pose.as_array(), covariance, self.settings.particles, method="cholesky")
        self.filter.start(np.ascontiguousarray(drawn))

    def predict(self, motion: Motion) -> None:
        """Every particle moves by the odometry's motion, with noise of its own."""
        self.filter.predict(motion)

    def put_nearby(self, pose: Pose) -> None:
        """Move nearby_ratio of the particles, evenly chosen, to about a pose."""
        s = self.settings
        count = int(s.paper.nearby_ratio * len(self.particles))
        if count:
            deviations = np.array([NEARBY_M, NEARBY_M, NEARBY_RAD])
            self.filter.inject(pose.as_array() + deviations * self.rng.standard_normal((count, 3)))

    def keep_within(self, region: Region, moved: Pose) -> None:
        """Particles that were outside of a region before a motion take the places of others, unless all were.

        moved: before_from_after.
        """
        poses = self.particles.poses
        headings = poses[:, 2] - moved.heading
        cosine, sine = np.cos(headings), np.sin(headings)
        x = poses[:, 0] - cosine * moved.x + sine * moved.y
        y = poses[:, 1] - sine * moved.x - cosine * moved.y
        inside = (x >= region.min_x) & (x <= region.max_x) & (y >= region.min_y) & (y <= region.max_y)
        kept = poses[inside]
        if 0 < len(kept) < len(inside):
            poses[~inside] = kept[self.rng.integers(len(kept), size=len(inside) - len(kept))]

    def update(self, points: FloatArray) -> ParticleEstimate:
        """Equations (7) to (14) for line points (M, 2) in the robot frame (m), M > 0; returns mean and covariance."""
        return self.filter.update(LineView(points, np.ones(len(points))))

    def estimate(self) -> ParticleEstimate:
        """Equations (11), (12) and (14), whose f (13) is the arc tangent of both arguments, and the covariance.

        They are those of the particles drawn last, the mean moved on by the odometry since.
        """
        return self.filter.estimate()

    def errors_m(self, points: FloatArray, pose: Pose) -> FloatArray:
        """Errors (M,) of points (M, 2) seen from a pose, in metres: distances, but for the map's steps and its end."""
        return self.sensor_model.errors_m(points, pose)
