"""A simulated robot on a field: world, cameras and sensors for the papers' experiments."""
