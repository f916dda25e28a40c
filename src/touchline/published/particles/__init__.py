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

Each part is in the file that is named after what it does. The systems' own filters are `NubotParticles`,
`IrisParticles` and `NimbroParticles` in `published/`.
"""
