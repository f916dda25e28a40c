"""Calibration: each module is what one `touchline calibrate NAME` runs."""
