"""The simulated cameras: mirror, pinhole and the image sensor."""
