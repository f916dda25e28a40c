"""Our own estimator: filter, hypotheses, end of the field, stamp delay, for every kind of camera."""
