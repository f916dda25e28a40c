"""Calibration from a flat strip of known edges: what nubot-mcl and iris-fusion share."""
