"""One observation alone: its pose, and whether that is better than chance."""
