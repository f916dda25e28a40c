"""Registration: the pose at which line points lie best on the field's lines, and how sure it is.

Robust Gauss-Newton steps on the offsets of the points from their nearest lines. The kernel (Geman and McClure 1987)
begins wide and narrows to the points' own noise (graduated non-convexity: Blake and Zisserman 1987). Each point weighs
by the inverse of its variance across the line, whose direction the offset gives anew in every step: a point of a mirror
camera knows its bearing far better than its range. Where the noise is as stated, the error comes near the
Cramér-Rao bound (`bound`).
"""

from typing import NamedTuple

import numpy as np

from touchline.field.association import AssociationTables
from touchline.field.distance_map import DistanceMap
from touchline.field.offset_map import offset_table
from touchline.geometry import FloatArray
from touchline.localization.camera_errors.base import Response
from touchline.localization.registration.covariance import ANYWHERE_INFORMATION
from touchline.localization.registration.joint import Ground, Seen, StateFit, StatePrior, fit_state
from touchline.localization.registration.kernels import Fit, Fits, Plan, register, register_all, register_placed

# at four standard deviations a point has a quarter of its weight left: 1.11 of the bound on point sets for tuning, at
# three and at six 1.14
GATE2 = 16.0
FLOOR_M = 0.01  # standard deviation that no point falls below: carpet, paint, the map's own error
# density of clutter along a line's normal (1/m), against that of points of lines: one point in ten within 6 m is none
CLUTTER_PER_M = 0.1
USUAL_NOISE = 0.8  # `Fit.noise` of points that err as they state
NO_PLACES = AssociationTables(np.zeros((0, 2)), np.zeros((0, 0, 0), dtype=np.int16), 0.0, 0.0)


def _plan(widths_m: list[float]) -> Plan:
    return Plan(np.array(widths_m), GATE2, FLOOR_M**2, CLUTTER_PER_M)


# from a prediction that is off by some decimetres and degrees: fewer steps end beside the pose, more gain nothing
TRACKING = _plan([*np.geomspace(0.4, 0.05, 6), 0.0, 0.0, 0.0, 0.0])
SEARCHING = _plan([0.4, 0.3, 0.2, 0.15, 0.1])  # from a sample of a coarse grid, to distinguish likely ones
FINISHING = _plan([0.15, 0.1, 0.05, 0.02, 0.0, 0.0, 0.0])  # from where those end
SETTLED = _plan([0.1, 0.03, 0.0, 0.0])  # of pose and mirror errors that are nearly known
FOLLOWING = _plan([0.25, 0.1, 0.03, 0.0, 0.0])  # from where the last image and its velocity put it
UNSETTLED = _plan([0.25, 0.25, 0.25, 0.15, 0.1, 0.05, 0.0, 0.0])  # 0.3 degrees move a line 7 m off by so much
SHAKEN = _plan([0.5, 0.5, 0.4, 0.25, 0.15, 0.1, 0.05, 0.0, 0.0])  # and in some images three times as far


class Registered(NamedTuple):
    """Pose (3,) as x, y (m), heading (rad, not wrapped), field frame, and its covariance (3, 3) in (m, m, rad).

    The covariance is huge along a direction that no line observes; it holds as far as the points err as they state.
    explained: share of the points within three standard deviations of a line. noise: mean square of the residuals in
    units of the points' noise, clutter left out; 1 where they err as they state. log_likelihood: of the points there.
    """

    pose: FloatArray
    covariance: FloatArray
    explained: float
    noise: float
    log_likelihood: float


class Registration:
    """Registers line points on the lines of one field: positions (N, 2) in m and covariances (N, 2, 2) in m², both
    robot frame, float64, C order. Poses are (3,): x, y (m), heading (rad), field frame.
    """

    def __init__(self, distance_map: DistanceMap, places: AssociationTables | None = None) -> None:
        """places: what crossings and landmarks may be; None where lines alone are registered."""
        self.table = offset_table(distance_map)
        self.ground = Ground(self.table, NO_PLACES if places is None else places)

    def register(
        self, positions_m: FloatArray, covariances_m2: FloatArray, start: FloatArray, plan: Plan = TRACKING
    ) -> Registered:
        """The pose that a plan's steps come to from a start (3,)."""
        fit = self.fit(positions_m, covariances_m2, start, plan)
        covariance = np.linalg.inv(fit.information + ANYWHERE_INFORMATION)
        return Registered(fit.pose, covariance, fit.explained, fit.noise / USUAL_NOISE, fit.log_likelihood)

    def fit(self, positions_m: FloatArray, covariances_m2: FloatArray, start: FloatArray, plan: Plan = TRACKING) -> Fit:
        """As `register`, for those who do not ask for the covariance."""
        return register(positions_m, covariances_m2, self.table, start, plan)

    def fit_placed(
        self, seen: Seen, errors: FloatArray, response: Response, start: FloatArray
    ) -> tuple[FloatArray, float]:
        """Pose (3,) and log-likelihood as of `fit`, of an image's line points without errors (K,) of the camera."""
        pose, places = start.copy(), (seen.positions_m, seen.covariances_m2)
        return pose, register_placed(*places, errors, response, self.table, pose, TRACKING)

    def register_all(self, positions_m: FloatArray, covariances_m2: FloatArray, starts: FloatArray, plan: Plan) -> Fits:
        """What a plan's steps come to from each of starts (K, 3)."""
        fits: Fits = register_all(positions_m, covariances_m2, self.table, starts, plan)
        return fits._replace(noise=fits.noise / USUAL_NOISE)

    def fit_state(self, seen: Seen, start: FloatArray, prior: StatePrior, plan: Plan, response: Response) -> StateFit:
        """Pose and camera errors, jointly, from a start (S,) and with what is known before."""
        size = len(start)  # arrays that are filled: to return one takes a loop longer than a hundred sums
        arrays = start.copy(), np.empty((size, size)), np.empty(size)
        return StateFit(*arrays, *fit_state(seen, self.ground, prior, response, plan, *arrays))


def covariances_of(fits: Fits) -> FloatArray:
    """(K, 3, 3) in (m, m, rad), as `Registered.covariance`."""
    return np.asarray(np.linalg.inv(fits.information + ANYWHERE_INFORMATION))
