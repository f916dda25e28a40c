"""Monte Carlo localization: one particle filter, put together from motion model, sensor model and policies.

A filter of its own, here an augmented MCL on line points:

    start = UniformPoses(np.array([10.0, 7.0]))                       # where particles start, and start anew
    particle_filter = ParticleFilter(
        ParticleSet(start.draw(rng, 1000)),
        MotionModel(),
        DistanceMapModel(field.distance_map(), sigma_m=0.3),          # or any class with `log_likelihoods`
        Resampling(EVERY_CYCLE, CertaintyNumber(250, 1000)),
        rng,
        AugmentedInjection(start),
    )
    particle_filter.predict(motion)
    estimate = particle_filter.update(LineView(points, weights))      # pose and covariance

The systems' own filters are `NubotParticles`, `IrisParticles` and `NimbroParticles` in `published/`.
"""

from touchline.localization.particles.motion_model import MotionModel, MotionNoise
from touchline.localization.particles.particle_filter import ParticleFilter
from touchline.localization.particles.particle_set import ParticleEstimate, ParticleSet
from touchline.localization.particles.random_particles import (
    AugmentedInjection,
    InjectionUntilConverged,
    RandomInjection,
    UniformPoses,
)
from touchline.localization.particles.resampling import (
    EVERY_CYCLE,
    CertaintyNumber,
    KldNumber,
    ParticleNumber,
    Resampling,
)
from touchline.localization.particles.sensor_models import DistanceMapModel, ErrorMapModel, LineView, SensorModel

__all__ = [
    "EVERY_CYCLE",
    "AugmentedInjection",
    "CertaintyNumber",
    "DistanceMapModel",
    "ErrorMapModel",
    "InjectionUntilConverged",
    "KldNumber",
    "LineView",
    "MotionModel",
    "MotionNoise",
    "ParticleEstimate",
    "ParticleFilter",
    "ParticleNumber",
    "ParticleSet",
    "RandomInjection",
    "Resampling",
    "SensorModel",
    "UniformPoses",
]
