"""The four published systems: systems, parts, detectors, calibrations. Only entry points lead here."""
