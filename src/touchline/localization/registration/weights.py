"""The weight that each line point deserves: the inverse of its variance."""

import numpy as np
from pydantic import Field

from touchline.config import Settings, added
from touchline.geometry import FloatArray
from touchline.types import LinePoints

RANGE_NOISE_M = 0.01  # generic range noise, for points without a covariance: a usual mirror calibration


class WeightPaper(Settings):
    """Switches to the papers' exact form."""

    by_precision: bool = added(
        True,
        paper=False,
        description="points weigh as much as their precision deserves; false as in the papers: all alike",
    )


class WeightSettings(Settings):
    """Weights of line points. The paper weighs all alike; range precision falls with range on every mirror."""

    floor_m: float = Field(
        0.03,
        gt=0,
        description="error that no point is free of (m): line width, uneven carpet, vibration; keeps the few nearest "
        "points from deciding alone",
    )
    range_noise_relative: float = Field(
        0.02, ge=0, description="generic range noise as a share of the range, for points without a covariance: the same"
    )
    paper: WeightPaper = WeightPaper()


def range_weights(positions_m: FloatArray, settings: WeightSettings) -> FloatArray:
    """Weights (N,) of metric points (N, 2) in the robot frame by the generic range noise; they sum to 1."""
    if not settings.paper.by_precision:
        return normalized(np.ones(len(positions_m)))
    ranges_m = np.hypot(positions_m[:, 0], positions_m[:, 1])
    sigma_m = settings.floor_m + RANGE_NOISE_M + settings.range_noise_relative * ranges_m
    return normalized(1.0 / sigma_m**2)


def precision_weights(points: LinePoints, settings: WeightSettings) -> FloatArray:
    """Weights (N,) of detected points: confidence over mean variance plus the floor's; they sum to 1.

    The mean of the two principal variances stands for the variance across the line, whose direction isn't known
    before the match.
    """
    if not settings.paper.by_precision:
        return normalized(np.ones(len(points)))
    variance_m2 = 0.5 * np.trace(points.covariances_m2, axis1=1, axis2=2)
    return normalized(points.confidences / (variance_m2 + settings.floor_m**2))


def normalized(weights: FloatArray) -> FloatArray:
    """Weights (N,) divided by their sum; equal weights if there is nothing to divide by."""
    total = float(np.sum(weights))
    if not np.isfinite(total) or total <= 0.0:
        return np.full(len(weights), 1.0 / max(len(weights), 1))
    return np.asarray(weights / total, dtype=np.float64)
