"""What `touchline check` looks for in a recording and its calibration."""
