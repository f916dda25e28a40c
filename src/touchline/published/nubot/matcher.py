"""Matching optimization: the pose at which the seen line points lie best on the field's lines.

Xiong et al., sections 4.1 and 4.2; Lauer, Lange and Riedmiller 2006; uncertainty after Lu et al. 2013, section 4.
"""

from dataclasses import dataclass, field

import numpy as np
from pydantic import Field

from touchline.config import Settings, added
from touchline.field.distance_map import DistanceMap
from touchline.geometry import FloatArray, Pose, as_pose
from touchline.localization.registration.covariance import UncertaintySettings, moments, visual_covariance
from touchline.published.nubot.kernels import RpropSchedule, error_and_gradient, rprop

FIRST_STEP_M = 0.1  # first step in x and y: the size of a usual error of the start; 'rather large' in section 5.1
FIRST_STEP_RAD = 0.05  # first step of the heading, moves a point 2 m away by as much as first_step_m
GROW = 1.2  # factor of a step whose derivative keeps its sign (Lauer et al. 2006)
SHRINK = 0.5  # factor of a step whose derivative changes its sign (Lauer et al. 2006)
MAX_STEP_M = 0.5  # longest step in x and y: half the distance between lines that can be mistaken for each other
MAX_STEP_RAD = 0.25  # longest step of the heading: largest_step_m at 2 m
MIN_STEP_M = 1e-5  # shortest step in x and y: far below any measurement error
MIN_STEP_RAD = 1e-5  # shortest step of the heading
# mean error of a match from which it may be that of points that are none; as accepted_error of a global search. Unlike
# the mean distance it leaves clutter out, the next field's lines among it
POOR_ERROR = 0.1
CLUTTERED = 0.7  # of the points' weight, the nearest to the lines, by which a pose among clutter is judged
# mean distance of those up to which the others are clutter: a right pose among 30 % of it leaves 0.07 m, and of poses
# more than half a metre off that leave 0.35 m on average one in forty less than this
CLUTTERED_M = 0.08


class MatchingPaper(Settings):
    """Switches to the papers' exact form."""

    long_first_step: bool = added(
        False,
        paper=True,
        description="true as in Xiong et al., section 5.1: the first step is rather large and leads beyond a pose that "
        "is near (half a metre, 0.25 rad); false: 0.1 m and 0.05 rad, the usual error of a start",
    )


class MatchingSettings(Settings):
    """RPROP on the error function e(t) = 1 - c² / (c² + t²)."""

    c_m: float = Field(
        0.25, gt=0, description="width c of the error function (m): Lauer et al. 2006; the paper's own C has no unit"
    )
    iterations: int = Field(
        25,
        ge=1,
        le=10_000,
        description="RPROP steps: figure 9 converges after about 10; 25 also settle a start 0.3 m and 10° away",
    )
    uncertainty: UncertaintySettings = UncertaintySettings()
    paper: MatchingPaper = MatchingPaper()


@dataclass(frozen=True, eq=False, slots=True)
class Match:
    """Result of one matching.

    error: weighted mean of e(d) with c_m. mean_distance_m: weighted mean distance of the points to the nearest line.
    covariance: (3, 3) of x, y, heading in (m, m, rad), field frame; huge along a direction that no line observes.
    iterations: (K, 4) x, y, heading, error of each pose visited, or None unless asked for. inflation: of covariance,
    by what the residuals show beyond the points' noise. settled: whether the frame's own errors of the mirror are taken
    out, or none are looked for.
    """

    pose: Pose
    error: float
    mean_distance_m: float
    covariance: FloatArray
    iterations: FloatArray | None = field(default=None, repr=False)
    inflation: float = 1.0
    settled: bool = True


class Matcher:
    """Matches line points to the lines of one field."""

    def __init__(self, distance_map: DistanceMap, settings: MatchingSettings | None = None) -> None:
        self.settings = settings or MatchingSettings()
        self.distance_map = distance_map
        s = self.settings
        longest = np.array([MAX_STEP_M, MAX_STEP_M, MAX_STEP_RAD])
        self._schedule = RpropSchedule(
            s.iterations,
            longest if s.paper.long_first_step else np.array([FIRST_STEP_M, FIRST_STEP_M, FIRST_STEP_RAD]),
            np.array([MIN_STEP_M, MIN_STEP_M, MIN_STEP_RAD]),
            longest,
            GROW,
            SHRINK,
        )

    def match(self, positions_m: FloatArray, weights: FloatArray, start: Pose, record: bool = False) -> Match:
        """Refine a pose: equation (3).

        positions_m (N, 2) robot frame; weights (N,) that sum to 1; record: keep every pose visited.
        Raises ValueError for wrong shapes, no points, or points that are not finite.
        """
        points, weights = checked_points(positions_m, weights)
        pose, error, trace = self.descend(points, weights, start.as_array(), record)
        return self.assess(points, weights, pose, error, trace if record else None)

    def assess(
        self,
        points: FloatArray,
        weights: FloatArray,
        pose: FloatArray,
        error: float,
        iterations: FloatArray | None = None,
    ) -> Match:
        """The match at a pose (3,) that `descend` found with this error; arguments as for `descend`."""
        found = moments(points, weights, self.distance_map.table, pose, self.settings.c_m)
        covariance = visual_covariance(points, weights, found, self.settings.c_m, self.settings.uncertainty)
        return Match(as_pose(pose), error, found[3], covariance, iterations)

    def descend(
        self, points: FloatArray, weights: FloatArray, start: FloatArray, record: bool = False
    ) -> tuple[FloatArray, float, FloatArray]:
        """The bare descent from start (3,): best pose seen (3,), its error with c_m, record (K, 4) if asked for.

        Arguments as for `match`, but not checked: float64, contiguous. The heading is not wrapped.
        """
        s = self.settings
        trace = np.zeros((s.iterations + 1 if record else 0, 4))
        best, error = rprop(points, weights, self.distance_map.table, start, s.c_m, self._schedule, trace)
        return best, float(error), trace

    def error(self, points: FloatArray, weights: FloatArray, pose: FloatArray) -> float:
        """Mean error of a pose (3,), equation (2), with c_m; arguments as for `descend`."""
        found = error_and_gradient(points, weights, self.distance_map.table, pose, self.settings.c_m)
        return float(found[0])

    def is_cluttered(self, points: FloatArray, weights: FloatArray, pose: Pose) -> bool:
        """Whether most points lie on lines, so that what lies off them is clutter; arguments as for `match`."""
        distances_m, _ = self.distance_map.look_up(pose.transform(points))
        order = np.argsort(distances_m)
        weights, distances_m = weights[order], distances_m[order]
        kept = np.cumsum(weights) <= CLUTTERED
        return float(weights[kept] @ distances_m[kept]) < CLUTTERED_M * float(weights[kept].sum())


def checked_points(positions_m: FloatArray, weights: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Points (N, 2) and weights (N,) as contiguous float64; without weights all points count alike.

    Raises ValueError for wrong shapes, no points, points that are not finite, or weights that don't sum to 1.
    """
    points = np.ascontiguousarray(positions_m, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or len(points) == 0:
        raise ValueError(f"points need the shape (N, 2) with N > 0, got {points.shape}")
    if not np.isfinite(points).all():
        raise ValueError("points must be finite")
    if weights is None:
        return points, np.full(len(points), 1.0 / len(points))
    checked = np.ascontiguousarray(weights, dtype=np.float64)
    if checked.shape != (len(points),) or not abs(float(checked.sum()) - 1.0) < 1e-6:
        raise ValueError(f"weights need the shape ({len(points)},) and the sum 1, got {checked.shape}")
    return points, checked
