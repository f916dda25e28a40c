"""Monte Carlo localization: one particle filter, put together from motion model, sensor model and policies."""
