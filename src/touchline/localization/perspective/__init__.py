"""Registration through a perspective camera: pose and lean together, every pose that a walking robot may have."""
