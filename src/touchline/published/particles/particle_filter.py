"""The particle filter: Monte Carlo localization, put together from models and policies.

    particles ─▶ motion model ─▶ sensor model ─▶ weights ─▶ mean and covariance
        ▲                                           │
        └────── random particles ◀── resampling ◀───┘ if it is due

Dellaert, Fox, Burgard, Thrun 1999; Thrun, Burgard, Fox: Probabilistic Robotics, tables 4.3 and 8.2. The systems' own
filters (`NubotParticles`, `IrisParticles`, `NimbroParticles`) are configurations of this one.
"""

from typing import Generic, TypeVar

import numpy as np

from touchline.geometry import FloatArray
from touchline.localization.search.resampling import tempering
from touchline.motion.odometry import Motion
from touchline.published.particles.motion_model import MotionModel
from touchline.published.particles.particle_set import ParticleEstimate, ParticleSet
from touchline.published.particles.random_particles import RandomInjection
from touchline.published.particles.resampling import Resampling
from touchline.published.particles.sensor_models import SensorModel

View = TypeVar("View")


class ParticleFilter(Generic[View]):
    """Particles that move with the robot and are weighed by what it sees: `predict`, `update`, `estimate`.

    Every part can be replaced on its own. `particles`: the set. `effective`: the effective sample size of the last
    weights. `exponent`: of the last tempering, 1 if there was none.
    """

    def __init__(
        self,
        particles: ParticleSet,
        motion_model: MotionModel,
        sensor_model: SensorModel[View],
        resampling: Resampling,
        rng: np.random.Generator,
        injection: RandomInjection | None = None,
        min_effective: float = 0.0,
    ) -> None:
        """injection: random particles at every drawing; none without it. min_effective: effective particles that an
        observation must leave: its likelihood is tempered (raised to a power below 1) where it would leave fewer.
        rng: all chance comes from it.
        """
        self.motion_model = motion_model
        self.sensor_model = sensor_model
        self.resampling = resampling
        self.injection = injection
        self.min_effective = min_effective
        self.rng = rng
        self.particles = particles
        self.start(particles.poses)

    def start(self, poses: FloatArray) -> None:
        """Start anew with poses (N, 3) of the same weight."""
        self.particles.replace(poses)
        self.effective = float(len(poses))
        self.exponent = 1.0
        self._roughness: FloatArray | None = None
        self._estimate = self.particles.estimate()

    def predict(self, motion: Motion) -> None:
        """Every particle moves by the odometry's motion, with noise of its own."""
        self.motion_model.move(self.particles.poses, motion, self.rng, self._roughness)
        self._roughness = None
        self._estimate = ParticleEstimate(self._estimate.pose.compose(motion.pose), self._estimate.covariance)

    def update(self, view: View) -> ParticleEstimate:
        """Weigh the particles by an observation, and draw them anew if it is due; returns the estimate."""
        self.weigh(view)
        self.normalize()
        self.resample_if_due()
        return self._estimate

    def weigh(self, view: View) -> None:
        """The sensor model: multiply the weights, in their logarithms, by the likelihood of the observation."""
        found = self.sensor_model.log_likelihoods(view, self.particles.poses)
        if self.injection is not None:
            self.injection.observe(self.particles.weights, found)
        if self.min_effective > 1.0:
            self.exponent = float(tempering(found, self.min_effective))
            found *= self.exponent
        self.particles.log_weights += found

    def normalize(self) -> None:
        """Weights that sum to 1, and their mean and covariance."""
        self.effective = self.particles.normalize()
        if not self.resampling.mean_of_drawn:
            self._estimate = self.particles.estimate()

    def resample_if_due(self) -> None:
        """Draw the particles anew if too few carry the weight; some of them start at random."""
        if not self.resampling.is_due(self.effective, len(self.particles)):
            return
        self.particles.replace(self.resampling.draw(self.particles, self._estimate, self.rng))
        if self.resampling.mean_of_drawn:
            self._estimate = self.particles.estimate()
        self._roughness = self.resampling.roughness(self._estimate, len(self.particles))
        if self.injection is not None:
            count = int(self.injection.ratio(self._estimate) * len(self.particles))
            if count:
                self.inject(self.injection.poses.draw(self.rng, count))

    def inject(self, poses: FloatArray) -> None:
        """Let poses (K, 3), K > 0, take the places of particles, evenly over the set, with their weights."""
        self.particles.poses[:: len(self.particles) // len(poses)][: len(poses)] = poses

    def estimate(self) -> ParticleEstimate:
        """Mean and covariance after the last update, the mean moved on by the odometry since."""
        return self._estimate
