"""The uncertainty of a match, from the second derivatives of the error function (Lu et al. 2013, section 4)."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from pydantic import Field

from touchline.config import Settings
from touchline.geometry import FloatArray

Moments: TypeAlias = tuple[FloatArray, float, float, float]
_DIAGONAL = np.diag_indices(3)


class UncertaintySettings(Settings):
    """How curvature becomes a covariance. The paper only says that the second derivatives measure it."""

    clutter_share: float = Field(
        0.1,
        ge=0,
        lt=1,
        description="share of the points' information that clutter alone may bring into any direction; taken off "
        "every direction, so that a few stray points don't fix what no line observes. With 0.1 the errors on "
        "simulated points with 5 % clutter have just the covariance stated",
    )
    least_residual_m: float = Field(
        0.01, gt=0, description="smallest believed deviation of a point (m): the error of the distance map and carpet"
    )
    least_position_m: float = Field(
        0.005,
        ge=0,
        description="smallest believed standard deviation of x and y (m): errors of calibration are the same in "
        "every frame and don't average out",
    )
    least_heading_rad: float = Field(
        0.002, ge=0, description="smallest believed standard deviation of the heading (rad), as least_position_m"
    )
    unknown_position_m: float = Field(
        10.0, gt=0, description="standard deviation (m) along a direction that no line observes: the field's size"
    )
    unknown_heading_rad: float = Field(
        3.0, gt=0, description="standard deviation (rad) of a heading that no line observes: the full circle"
    )


def visual_covariance(
    points: FloatArray, weights: FloatArray, moments: Moments, c_m: float, settings: UncertaintySettings
) -> FloatArray:
    """Covariance (3, 3) of x, y, heading in (m, m, rad), field frame; arguments as `kernels.moments` has them.

    The result minimizes a mean of e(d), so it is an M-estimate, whose covariance is (Huber 1981, section 7.6)

        (sum of w² e'²) / n / mean(w e'')  ·  (sum of w e'' u uᵀ)^-1,     u = derivative of d by the pose,

    the residual power times the inverse curvature. The true second derivative may be indefinite: a point farther than
    c / √3 from its line has e'' < 0. Such points count as zero: they have let go of the line and carry no
    information. The second derivative of d itself is left out: it comes with the signed residual, whose mean is zero
    at the minimum. Heading and position are brought to one scale by the points' root mean square range.
    """
    curvature, mean_curvature, slope_power, _ = moments
    s = settings
    n = len(points)
    unknown = np.array([s.unknown_position_m, s.unknown_position_m, s.unknown_heading_rad]) ** 2
    if n <= 3 or mean_curvature <= 0.0:
        return np.diag(unknown)
    # Three parameters were fitted to n residuals; a perfect fit still has the least residual.
    power = max(slope_power / (n - 3), (2.0 * s.least_residual_m / c_m**2) ** 2 * float(weights @ weights) / n)
    lever_m = max(math.sqrt(float(weights @ (points * points).sum(axis=1))), 0.1)
    scale = np.array([1.0, 1.0, lever_m])
    values, vectors = np.linalg.eigh(curvature / np.outer(scale, scale) * (mean_curvature / (n * power)))
    values = np.maximum(values - s.clutter_share * values.sum() / 3.0, 0.0)
    information = (vectors * values) @ vectors.T * np.outer(scale, scale)
    information[_DIAGONAL] += 1.0 / unknown
    covariance = np.linalg.inv(information)
    covariance[_DIAGONAL] += np.array([s.least_position_m, s.least_position_m, s.least_heading_rad]) ** 2
    return np.asarray(0.5 * (covariance + covariance.T))
