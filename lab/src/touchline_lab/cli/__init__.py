"""Commands that the lab adds to `touchline`."""

import os

os.environ["MPLBACKEND"] = "agg"  # figures are written, not shown; Matplotlib refuses names that it does not know
