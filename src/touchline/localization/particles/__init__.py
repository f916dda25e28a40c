"""Monte Carlo localization: sets of particles, how they move and what they weigh."""
