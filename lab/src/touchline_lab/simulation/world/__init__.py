"""What stands where: hall, lights, clutter and what is laid out for a calibration."""
