"""The picture of a range regression: pairs and polynomial, and what is left between them."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from touchline import palette
from touchline.calibration.range_regression import RangeRegression

_PAIR, _CURVE, _LIMIT = palette.BLUE, palette.VERMILLION, "#8a948a"


def range_figure(regression: RangeRegression) -> Figure:
    """Range over radius, and the residuals in centimetres over the range."""
    pairs = regression.pairs
    figure = Figure(figsize=(7.2, 6.4), layout="constrained")
    above, below = figure.subplots(2, 1, height_ratios=(3, 2))
    radii = np.linspace(regression.first_px, regression.last_px, 500)
    above.plot(pairs.radius_px, pairs.range_m, ".", color=_PAIR, label=pairs.origin)
    above.plot(radii, regression.polynomial(radii), color=_CURVE, label=f"polynomial of degree {regression.degree}")
    above.axvline(regression.last_px, color=_LIMIT, linestyle="--", label="last pair: continued from here")
    above.set(xlabel="radius (px)", ylabel="range (m)")
    above.legend(loc="upper left")
    below.axhline(0.0, color=_CURVE)
    below.plot(pairs.range_m, 100.0 * regression.residuals_m, ".", color=_PAIR)
    below.set(xlabel="range (m)", ylabel="pair − polynomial (cm)")
    for axes in (above, below):
        axes.grid(visible=True, color="#d8ddd8", linewidth=0.6)
        axes.set_axisbelow(True)
    return figure
