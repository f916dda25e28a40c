"""The picture of a range regression: over an image, pairs and polynomial, and what is left between them."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from touchline import palette
from touchline.calibration.range_regression import RangeRegression
from touchline.types import ImageArray

_PAIR, _CURVE, _LIMIT = palette.BLUE, palette.VERMILLION, "#8a948a"
_LETTERS = 0.03  # of the image's height
_BEHIND = {"boxstyle": "round,pad=0.15", "facecolor": "#303030", "edgecolor": "none"}
_RINGS_M = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 15.0, 20.0)


def range_figure(regression: RangeRegression, seen: tuple[str, ImageArray] | None = None) -> Figure:
    """Range over radius, and the residuals in centimetres over the range.

    seen: name and pixels (H, W, 3), BGR, of an image with pairs: it stands beside them then, with these and the rings
    of equal range over it.
    """
    pairs = regression.pairs
    figure = Figure(figsize=(7.2 if seen is None else 14.0, 6.4), layout="constrained")
    panels: Any = [["above"], ["below"]] if seen is None else [["image", "above"], ["image", "below"]]
    axes_of = figure.subplot_mosaic(panels, height_ratios=(3, 2))
    above, below = axes_of["above"], axes_of["below"]
    if seen is not None:
        _over_image(axes_of["image"], regression, *seen)
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


def _over_image(axes: Any, regression: RangeRegression, name: str, image: ImageArray) -> None:
    """An image with its pairs, the places that the polynomial gives them, and rings of equal range."""
    pairs, (u, v) = regression.pairs, regression.pairs.optics.center
    radii = np.linspace(regression.first_px, regression.last_px, 2000)
    ranges = regression.polynomial(radii)
    axes.imshow(image[:, :, ::-1])
    turn, named_px = np.linspace(0.0, 2.0 * np.pi, 181), 0.0
    aside = float(np.mean(pairs.angle_rad)) + 0.75 * np.pi  # where few pairs are
    for ring_m in _RINGS_M:
        if not ranges[0] <= ring_m <= ranges[-1]:
            continue
        ring_px = float(np.interp(ring_m, ranges, radii))
        axes.plot(u + ring_px * np.cos(turn), v + ring_px * np.sin(turn), color="white", linewidth=0.8)
        if ring_px - named_px > _LETTERS * image.shape[0]:
            named_px = ring_px
            at = (u + ring_px * np.cos(aside), v + ring_px * np.sin(aside))
            axes.annotate(f"{ring_m:g} m", at, color="white", fontsize=8, ha="center", va="center", bbox=_BEHIND)
    here = np.array([file == name for file in pairs.files])
    across, down = np.cos(pairs.angle_rad[here]), np.sin(pairs.angle_rad[here])
    radius_px = pairs.radius_px[here]
    axes.plot(u + radius_px * across, v + radius_px * down, "x", color=palette.ORANGE, label="pairs")
    fitted_px = np.interp(pairs.range_m[here], ranges, radii)
    words = "their ranges by the polynomial"
    axes.plot(
        u + fitted_px * across, v + fitted_px * down, "o", markersize=9, mfc="none", color=palette.SKY, label=words
    )
    axes.set(xlim=(-0.5, image.shape[1] - 0.5), ylim=(image.shape[0] - 0.5, -0.5), xticks=(), yticks=(), title=name)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, -0.1), ncols=2, frameon=False)
