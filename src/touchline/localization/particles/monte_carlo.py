"""Monte Carlo localization: particles over the whole field (Lu, Li, Zhang et al. 2013, section 4).

A cycle moves the particles by the odometry, weighs them by the line points, reads off the mean and, when too few
particles carry the weight, draws them anew.
"""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field

from touchline.config import Settings
from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.localization.matching.global_search import Region
from touchline.localization.matching.matcher import Matcher, as_pose, checked_points
from touchline.localization.particles.kernels import (
    add_log_likelihoods,
    mean_and_covariance,
    move,
    normalize,
    occupied_bins,
    resample,
)
from touchline.localization.particles.models import ParticleMotionSettings, motion_deviations, spread_particles
from touchline.localization.particles.numbers import AdaptiveSettings, kld_number
from touchline.motion.odometry import Motion


class MonteCarloSettings(Settings):
    """Monte Carlo localization. The paper gives 600 particles, the models and the convergence rule; nothing else."""

    particles: int = Field(600, ge=1, description="particles; the paper's 600 on the 18 x 12 m field")
    particles_all_headings: int = Field(
        6000,
        ge=1,
        description="particles while no compass tells the heading: ten headings for each of the paper's places",
    )
    beyond_m: float = Field(1.0, ge=0, description="how far beyond the field particles start (m): the robot's margin")
    compass_rad: float = Field(
        0.1, ge=0, description="standard deviation of the first headings about the compass (rad): 5 degrees indoors"
    )
    sigma_m: float = Field(
        0.3,
        gt=0,
        description="σ of equation (2) (m) until the particles have converged: the next of 600 is some 0.35 m away "
        "from the robot",
    )
    converged_sigma_m: float | None = Field(
        0.1,
        gt=0,
        description="σ (m) once they have converged and lie close: a far line point's own error; none is the paper's "
        "one constant",
    )
    farthest_sigmas: float | None = Field(
        3.3,
        gt=0,
        description="distance, in σ, from which a point counts no worse: points on goals, robots and beyond the field "
        "lie on no line; an error is smaller in 99.9 % of all cases; none is the paper's equation (2)",
    )
    independent_points: float | None = Field(
        20.0,
        gt=0,
        description="tempered likelihood: the points count as so many independent ones, since neighbours on one line "
        "err together; none is the paper's equation (3), where one particle takes all weight at once",
    )
    precise_points: bool = Field(
        True, description="let precise points weigh more, as in matching; the paper weighs all alike"
    )
    table_m: float = Field(
        0.05, gt=0, description="sample distance of the table of distances (m): fine beside sigma_m, fits the cache"
    )
    least_effective: float = Field(
        0.5, ge=0, le=1, description="share of effective particles below which they are drawn anew: the usual half"
    )
    converged_m: float = Field(
        0.3,
        gt=0,
        description="standard deviation of the position (m) below which the particles have converged: from there "
        "matching finds the pose",
    )
    converged_rad: float = Field(0.15, gt=0, description="the same of the heading (rad)")
    refined_clusters: int = Field(
        5,
        ge=0,
        description="best clusters whose best particle is moved to its match every cycle; 0 is the paper's form, in "
        "which the drawing alone must come near",
    )
    cluster_m: float = Field(0.7, gt=0, description="distance (m) of two clusters: that of the first particles")
    heading_tolerance_rad: float = Field(
        0.6, gt=0, description="largest turn of a refined particle from the compass (rad), as global_search's"
    )
    fresh_share: float = Field(
        0.1,
        ge=0,
        lt=1,
        description="share of particles that start anew at every drawing until all agree: 600 may miss the robot; "
        "0 as in the paper",
    )
    kept_share: float = Field(
        0.1,
        ge=0,
        le=1,
        description="share of particles that start about the last pose after a failure: it may have been right; 0 as "
        "in the paper",
    )
    motion: ParticleMotionSettings = ParticleMotionSettings()
    adaptive: AdaptiveSettings = AdaptiveSettings()


# Equations (1) to (3) as they stand, and nothing but the drawing to come near.
PAPER_FORM = MonteCarloSettings(
    converged_sigma_m=None,
    farthest_sigmas=None,
    independent_points=None,
    precise_points=False,
    refined_clusters=0,
    fresh_share=0.0,
    kept_share=0.0,
)


class MonteCarlo:
    """Particles on one field. `particles` (N, 3): x, y (m), heading (rad); `weights` (N,) sum to 1.

    `pose` and `covariance` (3, 3): the weighted mean and spread after the last weighing. `effective`: the effective
    sample size then.
    """

    def __init__(
        self,
        matcher: Matcher,
        length_m: float,
        width_m: float,
        rng: np.random.Generator,
        settings: MonteCarloSettings | None = None,
        symmetric: bool = True,
    ) -> None:
        """length_m, width_m: of the field. symmetric: half a turn about the centre shows the same lines."""
        self.settings = settings or MonteCarloSettings()
        self.matcher = matcher
        self.rng = rng
        self.size_m = np.array([length_m, width_m])
        self.symmetric = symmetric
        s, source = self.settings, matcher.distance_map
        stride = max(round(s.table_m / source.resolution_m), 1)
        self._distances_m = np.ascontiguousarray(source.values[::stride, ::stride, 0])
        self._origin_m, self._resolution_m = source.origin_m, stride * source.resolution_m
        self._wide = self._sensor_model(s.sigma_m)
        self._narrow = self._wide if s.converged_sigma_m is None else self._sensor_model(s.converged_sigma_m)
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
        circle does: it holds one of every two poses that look the same. near: a pose and its covariance (3, 3) about
        which the kept share starts, or all of them (everything_near). widening: factor of the compass's deviation.
        """
        s = self.settings
        spread = min(s.compass_rad * widening, math.pi)
        self._tolerance_rad = max(s.heading_tolerance_rad, 2.0 * spread)
        self._model = self._wide
        count = s.particles if compass_rad is not None else s.particles_all_headings
        self._spread_rad = spread
        self._region = region or Region()
        self.particles = self._fresh(count, compass_rad)
        if near is not None:
            kept = count if everything_near else int(s.kept_share * count)
            pose, covariance = near
            self.particles[:kept] = self.rng.multivariate_normal(pose.as_array(), covariance, kept, method="eigh")
        self._weigh_alike()
        self._estimate()

    def cycle(
        self, motion: Motion | None, points: FloatArray, weights: FloatArray | None, compass_rad: float | None = None
    ) -> Pose:
        """One whole cycle: motion, weights, mean, and resampling if it is due; returns the mean.

        motion: since the last cycle, None if the particles were moved already. points (N, 2): robot frame, m.
        weights (N,) that sum to 1. compass_rad: how far refined particles may turn away from it.
        """
        if motion is not None:
            self.move(motion)
        self.weigh(points, weights, compass_rad)
        if self.effective < self.settings.least_effective * len(self.particles):
            self.resample()
            fresh = 0 if self.converged else int(self.settings.fresh_share * len(self.particles))
            if fresh:
                self.particles[:: len(self.particles) // fresh][:fresh] = self._fresh(fresh, compass_rad)
        return self.pose

    def move(self, motion: Motion) -> None:
        """The motion model: the odometry's motion with noise, for every particle its own."""
        deviations = motion_deviations(motion, self.settings.motion)
        move(self.particles, motion.pose.as_array(), deviations, self.rng.standard_normal(self.particles.shape))

    def weigh(self, points: FloatArray, weights: FloatArray | None, compass_rad: float | None = None) -> None:
        """The sensor model, equations (1) to (3), then the mean; arguments as for `cycle`."""
        s = self.settings
        points, shares = checked_points(points, weights if s.precise_points else None)
        self._model = self._narrow if self.converged else self._wide
        self._add_likelihoods(self.particles, points, shares, self._log_weights)
        if s.refined_clusters:
            self._refine(points, shares, compass_rad)
        self._estimate()

    def resample(self) -> None:
        """Low-variance resampling; afterwards all particles weigh the same."""
        drawn = np.empty_like(self.particles)
        start = float(self.rng.random())
        resample(self.particles, self.weights, start, drawn)
        adaptive = self.settings.adaptive
        if adaptive.enabled:
            bins = occupied_bins(drawn, self.pose.as_array(), adaptive.bin_m, adaptive.bin_rad)
            wanted = kld_number(bins, adaptive)
            wanted = max(wanted, int(adaptive.kept_share * len(drawn)))
            if wanted < len(drawn):
                drawn = drawn[:wanted].copy()
                resample(self.particles, self.weights, start, drawn)
        self.particles = drawn
        self._weigh_alike()

    @property
    def converged(self) -> bool:
        """Whether the variance of the particles says that they agree."""
        position = math.sqrt(self.covariance[0, 0] + self.covariance[1, 1])
        s = self.settings
        return position < s.converged_m and math.sqrt(self.covariance[2, 2]) < s.converged_rad

    def log_likelihoods(self, points: FloatArray, weights: FloatArray | None, poses: FloatArray) -> FloatArray:
        """log P(o | l) (K,) of poses (K, 3), but for a constant, with the σ of the last weighing.

        points (N, 2) and weights as for `cycle`.
        """
        points, shares = checked_points(points, weights if self.settings.precise_points else None)
        found = np.zeros(len(poses))
        self._add_likelihoods(np.ascontiguousarray(poses, dtype=np.float64), points, shares, found)
        return found

    def _add_likelihoods(self, poses: FloatArray, points: FloatArray, shares: FloatArray, out: FloatArray) -> None:
        squares, factor = self._model
        factor *= self.settings.independent_points or len(points)  # shares sum to 1, so the count comes here
        add_log_likelihoods(
            poses, points, shares, squares, self._origin_m[0], self._origin_m[1], self._resolution_m, factor, out
        )

    def _refine(self, points: FloatArray, shares: FloatArray, compass_rad: float | None) -> None:
        """Move the best particle of each of the best clusters to its match, and weigh it there."""
        best = self._best_of_clusters()
        refined = np.array([self.matcher.descend(points, shares, self.particles[j])[0] for j in best])
        change = np.zeros((2, len(best)))
        for row, poses in zip(change, (self.particles[best], refined), strict=True):
            self._add_likelihoods(poses, points, shares, row)
        for k, j in enumerate(best):
            turned = 0.0 if compass_rad is None else abs(wrap_angle(refined[k, 2] - compass_rad))
            if change[1, k] > change[0, k] and turned <= self._tolerance_rad:
                self.particles[j] = refined[k]
                self._log_weights[j] += change[1, k] - change[0, k]

    def _best_of_clusters(self) -> list[int]:
        """Indices of the heaviest particles, no two of them in one cluster."""
        s = self.settings
        likely = min(len(self.particles), 40 * s.refined_clusters)
        order = np.argpartition(-self._log_weights, likely - 1)[:likely]
        order = order[np.argsort(-self._log_weights[order], kind="stable")]
        places = self.particles[order]
        free = np.ones(likely, dtype=bool)
        best: list[int] = []
        while len(best) < s.refined_clusters and free.any():
            k = int(np.argmax(free))
            best.append(int(order[k]))
            free &= np.hypot(places[:, 0] - places[k, 0], places[:, 1] - places[k, 1]) >= s.cluster_m
        return best

    def _fresh(self, count: int, compass_rad: float | None) -> FloatArray:
        """New particles (count, 3), evenly over the region, headings as `restart` has them."""
        heading = None if compass_rad is None else (compass_rad, self._spread_rad)
        reach = 0.5 * self.size_m + self.settings.beyond_m
        return spread_particles(self.rng, count, reach, self._region, heading, self.symmetric)

    def _weigh_alike(self) -> None:
        self._log_weights = np.zeros(len(self.particles))
        self.weights = np.full(len(self.particles), 1.0 / len(self.particles))

    def _estimate(self) -> None:
        self.effective = float(normalize(self._log_weights, self.weights))
        mean, self.covariance = mean_and_covariance(self.particles, self.weights)
        if len(self.particles) == 1:  # it stands for all poses of its bin
            a = self.settings.adaptive
            self.covariance = np.diag([a.bin_m**2, a.bin_m**2, a.bin_rad**2]) / 12.0
        self.pose = as_pose(mean)

    def _sensor_model(self, sigma_m: float) -> tuple[FloatArray, float]:
        """Of equation (2) with this σ: squared distances (ny, nx), float32, m², and the factor 1 / (2 σ²)."""
        distances_m, farthest = self._distances_m, self.settings.farthest_sigmas
        if farthest is not None:
            distances_m = np.minimum(distances_m, np.float32(farthest * sigma_m))
        return distances_m**2, 0.5 / sigma_m**2
