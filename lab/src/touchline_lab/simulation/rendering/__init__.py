"""From a camera's rays and a world to linear radiance."""
