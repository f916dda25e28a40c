"""The uncertainty of a match, from the second derivatives of the error function (Lu et al. 2013, section 4)."""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numba
import numpy as np
from pydantic import Field

from touchline.config import Settings, added
from touchline.field.distance_map import lookup
from touchline.geometry import FloatArray, IndexArray

Moments: TypeAlias = tuple[FloatArray, FloatArray, float, float]
_DIAGONAL = np.diag_indices(3)


# share of the points that may be clutter: in each direction the most helpful ones, up to this share, and as large a
# share of the mean over all directions are not counted, so that a few stray points don't fix what no line observes;
# simulated clutter is 5 %
CLUTTER_RATIO = 0.05
MIN_CLUTTER = 4  # and so many of few points: two or three beside a lone line's end are no second line
MIN_RESIDUAL_M = 0.01  # smallest standard deviation of a point: the error of the distance map and carpet
UNKNOWN_POSITION_M = 10.0  # standard deviation along a direction that no line observes: the field's size
UNKNOWN_HEADING_RAD = 3.0  # standard deviation of a heading that no line observes: the full circle
# covariance of a pose of which nothing is known, and its inverse
ANYWHERE = np.diag(np.square([UNKNOWN_POSITION_M, UNKNOWN_POSITION_M, UNKNOWN_HEADING_RAD]))
ANYWHERE_INFORMATION = np.linalg.inv(ANYWHERE)

# standard deviations beyond which a pose is none: a robot that may stand a step to either side hits no ball
MAX_DEVIATION_OF_POSITION_M = 0.5
MAX_DEVIATION_OF_HEADING_RAD = 0.35
LINE_M = 0.1  # standard deviation across, of points that are all of one line: its width, noise, a ruffled carpet


class UncertaintyPaper(Settings):
    """Switches to the paper's exact form."""

    residuals: bool = added(
        True,
        paper=False,
        description="a match is as unsure as its residuals are larger than the points' noise, and every pose as the "
        "mirror's tilt leaves it; false: by the second derivatives alone",
    )


class UncertaintySettings(Settings):
    """How curvature becomes a covariance. The paper only says that the second derivatives measure it."""

    min_position_m: float = Field(
        0.002,
        ge=0,
        description="smallest believed standard deviation of x and y (m): the distance map and the paint err alike in "
        "every frame; what the camera adds is its own uncertainty",
    )
    min_heading_rad: float = Field(
        0.0005, ge=0, description="smallest believed standard deviation of the heading (rad), as min_position_m"
    )

    paper: UncertaintyPaper = UncertaintyPaper()

    @property
    def unknown(self) -> FloatArray:
        """Covariance (3, 3) of a pose of which nothing is known."""
        return ANYWHERE.copy()


def visual_covariance(
    points: FloatArray, weights: FloatArray, moments: Moments, c_m: float, settings: UncertaintySettings
) -> FloatArray:
    """Covariance (3, 3) of x, y, heading in (m, m, rad), field frame; arguments as `moments` has them.

    The result minimizes a mean of e(d), so it is an M-estimate, whose covariance is (Huber 1981, section 7.6)

        (sum of w² e'²) / n / mean(w e'')  ·  (sum of w e'' u uᵀ)^-1,     u = derivative of d by the pose,

    the residual power times the inverse curvature. The true second derivative may be indefinite: a point farther than
    c / √3 from its line has e'' < 0. Such points count as zero: they have let go of the line and carry no
    information. The second derivative of d itself is left out: it comes with the signed residual, whose mean is zero
    at the minimum. Heading and position are brought to one scale by the points' root mean square range. Along each
    principal direction the points that help most are left out, as many as may be clutter, and what clutter would bring
    evenly into all directions is taken off: where lines observe the direction it hardly matters, where only stray
    points and crossings do, nothing is left.
    """
    s = settings
    information = principal_information(points, weights, moments, c_m)
    if information is None:
        return s.unknown
    values = _values(information.helps)
    if values[0] <= 0.0:
        # the few points that alone have fixed the direction have turned it, too: along a lone line they would pass for
        # ones that tie its heading to the place along it
        information = information.turned(_least(information.helps[:, 0]))
        values = _values(information.helps)
    return information.covariance(values * information.unit, s)


def _kept(count: int) -> int:
    """How many of so many points are no clutter."""
    return count - min(max(math.ceil(CLUTTER_RATIO * count), MIN_CLUTTER), count - 1)


def _least(helps: FloatArray) -> IndexArray:
    """Of the help (N,) of each point along one direction, the rows of those that are no clutter."""
    kept = _kept(len(helps))
    return np.argpartition(helps, kept - 1)[:kept]


def _values(helps: FloatArray) -> FloatArray:
    """(3,) information of points, of which each helps (N, 3), along the three directions but for clutter."""
    kept = _kept(len(helps))
    values = np.partition(helps, kept - 1, axis=0)[:kept].sum(axis=0)
    return np.maximum(values - CLUTTER_RATIO * values.mean(), 0.0)


class PrincipalInformation(NamedTuple):
    """Information of each point about a pose along its three principal directions.

    helps (N, 3): of each point along each direction, the least known first; unit: what makes it an inverse variance.
    vectors (3, 3): the directions, in columns; scale (3,): of x, y and heading to one length. roots (N, 3): their
    products are each point's information.
    """

    helps: FloatArray
    unit: float
    vectors: FloatArray
    scale: FloatArray
    roots: FloatArray

    def turned(self, rows: IndexArray) -> PrincipalInformation:
        """The same information along the principal directions of some of the points alone."""
        some = self.roots[rows]
        vectors = np.linalg.eigh(some.T @ some)[1]
        return self._replace(helps=(self.roots @ vectors) ** 2, vectors=vectors)

    def covariance(self, values: FloatArray, settings: UncertaintySettings) -> FloatArray:
        """Covariance (3, 3) in (m, m, rad) of inverse variances (3,) along the directions."""
        s = settings
        information = (self.vectors * values) @ self.vectors.T * np.outer(self.scale, self.scale)
        information[_DIAGONAL] += 1.0 / s.unknown[_DIAGONAL]
        covariance = np.linalg.inv(information)
        covariance[_DIAGONAL] += np.array([s.min_position_m, s.min_position_m, s.min_heading_rad]) ** 2
        return np.asarray(0.5 * (covariance + covariance.T))


def principal_information(
    points: FloatArray, weights: FloatArray, moments: Moments, c_m: float
) -> PrincipalInformation | None:
    """The information of points, arguments as for `visual_covariance`; None where they have none."""
    u, curvature, slope_power, _ = moments
    n = len(points)
    mean_curvature = float(curvature.sum()) / n
    if n <= 3 or mean_curvature <= 0.0:
        return None
    # Three parameters were fitted to n residuals; a perfect fit still has the least residual.
    power = max(slope_power / (n - 3), (2.0 * MIN_RESIDUAL_M / c_m**2) ** 2 * float(weights @ weights) / n)
    lever_m = max(math.sqrt(float(weights @ (points * points).sum(axis=1))), 0.1)
    scale = np.array([1.0, 1.0, lever_m])
    u = u / scale
    vectors = np.linalg.eigh((u.T * curvature) @ u)[1]
    helps = curvature[:, np.newaxis] * (u @ vectors) ** 2
    return PrincipalInformation(
        helps, mean_curvature / power, vectors, scale, u * np.sqrt(np.maximum(curvature, 0.0))[:, np.newaxis]
    )


def widest_m(covariance: FloatArray) -> float:
    """Standard deviation (m) of the position along its least known direction, of a covariance (3, 3) in (m, m, rad)."""
    (a, b, _), (_, d, _), _ = covariance.tolist()
    return math.sqrt(0.5 * (a + d) + math.hypot(0.5 * (a - d), b))


def is_observed(covariance: FloatArray) -> bool:
    """Whether a covariance (3, 3), of x, y, heading in (m, m, rad), leaves a pose: not so along a lone line."""
    heading = float(covariance[2, 2])
    return heading < MAX_DEVIATION_OF_HEADING_RAD**2 and widest_m(covariance) < MAX_DEVIATION_OF_POSITION_M


def is_one_line(positions_m: FloatArray) -> bool:
    """Whether points (M, 2) in m all lie along one straight line."""
    across = np.linalg.eigvalsh(np.cov(positions_m.T))[0] if len(positions_m) > 1 else 0.0
    return bool(across < LINE_M**2)


@numba.njit(cache=True)
def moments(points, weights, table, pose, c_m):  # type: ignore[no-untyped-def]
    """What each point's error e(d) says about the accuracy of a pose.

    points (N, 2): robot frame (m); weights (N,) that sum to 1; table: the `MapTable` of a `DistanceMap`; pose (3,): x,
    y (m), heading (rad), field frame; c_m: width of e(d) = 1 - c² / (c² + d²).

    Returns u (N, 3): derivative of each point's distance by x, y, heading; curvature (N,): w max(e'', 0);
    slope_power: sum of w² e'²; mean_distance_m: sum of w d.
    """
    x, y, heading = pose[0], pose[1], pose[2]
    cosine, sine = math.cos(heading), math.sin(heading)
    c2 = c_m * c_m
    u = np.empty((points.shape[0], 3))
    curvature = np.empty(points.shape[0])
    slope_power = mean_distance_m = 0.0
    for i in range(points.shape[0]):
        px, py = points[i, 0], points[i, 1]
        turned_x = cosine * px - sine * py
        turned_y = sine * px + cosine * py
        d, gx, gy = lookup(table, x + turned_x, y + turned_y)
        # Beside a line the interpolated gradient is shorter than one; its direction is what counts here.
        length = math.hypot(gx, gy)
        if length > 1e-6:
            gx /= length
            gy /= length
        u[i, 0], u[i, 1], u[i, 2] = gx, gy, gy * turned_x - gx * turned_y
        s = c2 + d * d
        curvature[i] = weights[i] * max(2.0 * c2 * (c2 - 3.0 * d * d) / (s * s * s), 0.0)
        slope_power += (weights[i] * 2.0 * c2 * d / (s * s)) ** 2
        mean_distance_m += weights[i] * d
    return u, curvature, slope_power, mean_distance_m
