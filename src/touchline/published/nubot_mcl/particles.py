"""NuBot's configuration of the particle filter (Lu, Li, Zhang et al. 2013, section 4).

A cycle moves the particles by the odometry, weighs them by the line points, reads off the mean and, when too few
particles carry the weight, draws them anew.
"""

import math

import numpy as np
from pydantic import Field

from touchline.config import Settings, added
from touchline.field.region import Region
from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.motion.odometry import Motion
from touchline.published.nubot.matcher import Matcher, checked_points
from touchline.published.particles.motion_model import MotionModel, MotionNoise
from touchline.published.particles.particle_filter import ParticleFilter
from touchline.published.particles.particle_set import ParticleEstimate, ParticleSet
from touchline.published.particles.random_particles import BEYOND_M, InjectionUntilConverged, UniformPoses
from touchline.published.particles.resampling import BIN_M, BIN_RAD, AdaptiveSettings, KldNumber, Resampling
from touchline.published.particles.sensor_models import DistanceMapModel, LineView

TABLE_M = 0.05  # sample distance of the table of distances: fine beside sigma_m, fits the cache
CONVERGED_RAD = 0.15  # the same of the heading
CLUSTER_M = 0.7  # distance of two clusters: that of the first particles
HEADING_TOLERANCE_RAD = 0.6  # largest turn of a refined particle from the compass, as global_search's


class NubotParticlePaper(Settings):
    """Switches to the paper's exact form."""

    converged_sigma_m: float | None = added(
        0.1,
        paper=None,
        gt=0,
        description="σ (m) once they have converged and lie close: a far line point's own error; none is the paper's "
        "one constant",
    )
    farthest_sigmas: float | None = added(
        3.3,
        paper=None,
        gt=0,
        description="distance, in σ, from which a point counts no worse: points on goals, robots and beyond the field "
        "lie on no line; an error is smaller in 99.9 % of all cases; none is the paper's equation (2)",
    )
    independent_points: float | None = added(
        20.0,
        paper=None,
        gt=0,
        description="tempered likelihood: the points count as so many independent ones, since neighbours on one line "
        "err together; none is the paper's equation (3), where one particle takes all weight at once",
    )
    precise_points: bool = added(
        True, paper=False, description="let precise points weigh more, as in matching; the paper weighs all alike"
    )
    resampling_threshold: float = added(
        0.5,
        paper=1.0,
        ge=0,
        le=1,
        description="ratio of effective particles below which they are drawn anew: the usual half; 1 as in the paper, "
        "whose every cycle draws",
    )
    refined_clusters: int = added(
        5,
        paper=0,
        ge=0,
        le=1_000,
        description="best clusters whose best particle is moved to its match every cycle; 0 is the paper's form, in "
        "which the drawing alone must come near",
    )
    random_particle_ratio: float = added(
        0.1,
        paper=0.0,
        ge=0,
        lt=1,
        description="ratio of particles that start at random at every drawing until all agree: 600 may miss the robot; "
        "0 as in the paper",
    )
    prior_particle_ratio: float = added(
        0.1,
        paper=0.0,
        ge=0,
        le=1,
        description="ratio of particles that start about the last pose after a failure: it may have been right; 0 as "
        "in the paper",
    )
    spread_headings: bool = added(
        True,
        paper=False,
        description="first headings scatter about the compass's by compass_rad, which may err; false as in the paper: "
        "all are the compass's own",
    )
    margin: bool = added(
        True,
        paper=False,
        description="particles start up to 1 m beyond the field's lines, too: robots stand there; false as in the "
        "paper: on the field",
    )


class NubotParticleSettings(Settings):
    """Monte Carlo localization. The paper gives 600 particles, the models and the convergence rule; nothing else."""

    particles: int = Field(600, ge=1, le=10_000_000, description="particles; the paper's 600 on the 18 x 12 m field")
    particles_all_headings: int = Field(
        6000,
        ge=1,
        le=10_000_000,
        description="particles while no compass tells the heading: ten headings for each of the paper's places",
    )
    compass_rad: float = Field(
        0.1, ge=0, description="standard deviation of the first headings about the compass (rad): 5 degrees indoors"
    )
    sigma_m: float = Field(
        0.3,
        gt=0,
        description="σ of equation (2) (m) until the particles have converged: the next of 600 is some 0.35 m away "
        "from the robot",
    )
    converged_m: float = Field(
        0.3,
        gt=0,
        description="standard deviation of the position (m) below which the particles have converged: from there "
        "matching finds the pose",
    )
    motion: MotionNoise = MotionNoise()
    adaptive: AdaptiveSettings = AdaptiveSettings()
    paper: NubotParticlePaper = NubotParticlePaper()


class NubotParticles:
    """Particles on one field that find the robot from line points, odometry and, if there is one, a compass.

    `filter`: the particle filter; `particles`: its set.
    """

    def __init__(
        self,
        matcher: Matcher,
        length_m: float,
        width_m: float,
        rng: np.random.Generator,
        settings: NubotParticleSettings | None = None,
        symmetric: bool = True,
    ) -> None:
        """length_m, width_m: of the field. symmetric: half a turn about the centre shows the same lines."""
        self.settings = s = settings or NubotParticleSettings()
        self.matcher = matcher
        self.rng = rng
        self.symmetric = symmetric
        self._reach_m = 0.5 * np.array([length_m, width_m]) + BEYOND_M * s.paper.margin
        self.sensor_model = DistanceMapModel(
            matcher.distance_map,
            s.sigma_m,
            s.paper.converged_sigma_m,
            s.paper.farthest_sigmas,
            s.paper.independent_points,
            TABLE_M,
        )
        resampling = Resampling(s.paper.resampling_threshold, KldNumber() if s.adaptive.enabled else None)
        everywhere = UniformPoses(self._reach_m, symmetric=symmetric)
        self._injection = InjectionUntilConverged(
            everywhere, s.paper.random_particle_ratio, s.converged_m, CONVERGED_RAD
        )
        bins = np.array([BIN_M, BIN_M, BIN_RAD])
        self.particles = ParticleSet(np.zeros((1, 3)), single_covariance=np.diag(bins**2) / 12.0)
        self.filter: ParticleFilter[LineView] = ParticleFilter(
            self.particles, MotionModel(s.motion), self.sensor_model, resampling, rng, self._injection
        )
        self.restart(None)

    def restart(
        self,
        compass_rad: float | None,
        region: Region | None = None,
        near: tuple[Pose, FloatArray] | None = None,
        *,
        widening: float = 1.0,
        everything_near: bool = False,
    ) -> None:
        """Spread the particles over the field and its margin, or a region of it, alike weighted.

        Headings: about the compass (rad), or everywhere without one. On a symmetric field without a region half the
        circle does: it holds one of every two poses that look the same. near: a pose and its covariance (3, 3), about
        which prior_particle_ratio of the particles start, or all of them (everything_near). widening: factor of the
        compass's deviation.
        """
        s = self.settings
        self._compass_deviation_rad = min(s.compass_rad * s.paper.spread_headings * widening, math.pi)
        self._tolerance_rad = max(HEADING_TOLERANCE_RAD, 2.0 * self._compass_deviation_rad)
        self._region = region or Region()
        self.sensor_model.narrow = False
        count = s.particles if compass_rad is not None else s.particles_all_headings
        poses = self._start_poses(compass_rad).draw(self.rng, count)
        if near is not None:
            kept = count if everything_near else int(s.paper.prior_particle_ratio * count)
            pose, covariance = near
            poses[:kept] = self.rng.multivariate_normal(pose.as_array(), covariance, kept, method="eigh")
        self.filter.start(poses)

    def predict(self, motion: Motion) -> None:
        """The motion model: the odometry's motion with noise, for every particle its own."""
        self.filter.predict(motion)

    def update(
        self, points: FloatArray, weights: FloatArray | None, compass_rad: float | None = None
    ) -> ParticleEstimate:
        """Weights, mean, and resampling if it is due; returns the mean with its covariance.

        points (N, 2): robot frame, m. weights (N,) that sum to 1. compass_rad: how far refined particles may turn away
        from it, and where random particles head.
        """
        self.weigh(points, weights, compass_rad)
        self._injection.poses = self._start_poses(compass_rad)
        self.filter.resample_if_due()
        return self.filter.estimate()

    def weigh(self, points: FloatArray, weights: FloatArray | None, compass_rad: float | None = None) -> None:
        """The sensor model, equations (1) to (3), then the mean; arguments as for `update`."""
        view = self._view(points, weights, compass_rad)
        self.sensor_model.narrow = self.converged
        self.filter.weigh(view)
        if self.settings.paper.refined_clusters:
            self._refine(view)
        self.filter.normalize()

    def estimate(self) -> ParticleEstimate:
        """Mean and covariance after the last update, the mean moved on by the odometry since."""
        return self.filter.estimate()

    @property
    def converged(self) -> bool:
        """Whether the variance of the particles says that they agree."""
        s, found = self.settings, self.filter.estimate()
        return found.deviation_m < s.converged_m and found.deviation_rad < CONVERGED_RAD

    def log_likelihoods(self, points: FloatArray, weights: FloatArray | None, poses: FloatArray) -> FloatArray:
        """log P(o | l) (K,) of poses (K, 3), but for a constant, with the σ of the last weighing.

        points (N, 2) and weights as for `update`.
        """
        view = self._view(points, weights, None)
        return self.sensor_model.log_likelihoods(view, np.ascontiguousarray(poses, dtype=np.float64))

    def _view(self, points: FloatArray, weights: FloatArray | None, compass_rad: float | None) -> LineView:
        return LineView(*checked_points(points, weights if self.settings.paper.precise_points else None), compass_rad)

    def _start_poses(self, compass_rad: float | None) -> UniformPoses:
        """Where particles start: evenly over the region, headings as `restart` has them."""
        heading = None if compass_rad is None else (compass_rad, self._compass_deviation_rad)
        return UniformPoses(self._reach_m, self._region, heading, self.symmetric)

    def _refine(self, view: LineView) -> None:
        """Move the best particle of each of the best clusters to its match, and weigh it there."""
        particles, best = self.particles, self._best_of_clusters()
        points, weights, compass_rad = view
        refined = np.array([self.matcher.descend(points, weights, particles.poses[j])[0] for j in best])
        before, after = (self.sensor_model.log_likelihoods(view, poses) for poses in (particles.poses[best], refined))
        for k, j in enumerate(best):
            turned = 0.0 if compass_rad is None else abs(wrap_angle(refined[k, 2] - compass_rad))
            if after[k] > before[k] and turned <= self._tolerance_rad:
                particles.poses[j] = refined[k]
                particles.log_weights[j] += after[k] - before[k]

    def _best_of_clusters(self) -> list[int]:
        """Indices of the heaviest particles, no two of them in one cluster."""
        s, log_weights = self.settings, self.particles.log_weights
        likely = min(len(log_weights), 40 * s.paper.refined_clusters)
        order = np.argpartition(-log_weights, likely - 1)[:likely]
        order = order[np.argsort(-log_weights[order], kind="stable")]
        places = self.particles.poses[order]
        free = np.ones(likely, dtype=bool)
        best: list[int] = []
        while len(best) < s.paper.refined_clusters and free.any():
            k = int(np.argmax(free))
            best.append(int(order[k]))
            free &= np.hypot(places[:, 0] - places[k, 0], places[:, 1] - places[k, 1]) >= CLUSTER_M
        return best
