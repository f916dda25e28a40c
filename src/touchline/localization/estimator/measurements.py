"""The table of further measurements; a new one is a file beside this one, and its line here."""

from touchline.localization.estimator.measurement import Measurement

MEASUREMENTS: tuple[Measurement, ...] = ()
