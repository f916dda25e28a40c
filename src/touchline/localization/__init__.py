"""Estimators: the pose from what is seen and from motion, frame by frame or of one observation."""
