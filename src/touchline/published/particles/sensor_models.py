"""Sensor models: how likely an observation is from a pose.

Whatever has `log_likelihoods` is one: two of line points here; crossings, posts and lines can have theirs as well.
"""

import math
from typing import NamedTuple, Protocol, TypeVar

import numba
import numpy as np

from touchline.field.distance_map import DistanceMap
from touchline.field.error_map import MAX_ERROR, ErrorMap
from touchline.geometry import Float32Array, FloatArray, Pose

View_contra = TypeVar("View_contra", contravariant=True)


class SensorModel(Protocol[View_contra]):
    """P(o | l) of an observation o, in whatever form the model takes it."""

    def log_likelihoods(self, view: View_contra, poses: FloatArray) -> FloatArray:
        """log P(o | l) (N,), but for a constant, of poses (N, 3): x, y (m), heading (rad), field frame."""
        ...


class LineView(NamedTuple):
    """Line points as the particles are weighed by them: positions_m (M, 2) in the robot frame, and weights (M,).

    Both are float64 and contiguous. heading_rad: what the compass says, None without one.
    """

    positions_m: FloatArray
    weights: FloatArray
    heading_rad: float | None = None


class SquaredErrors(NamedTuple):
    """Squared error of a line point that lies at a place of the field, in the unit of σ.

    squares: float32 (ny, nx). Sample [iy, ix] lies at origin + resolution_m * (ix, iy), field frame, m.
    """

    squares: Float32Array
    origin_x: float
    origin_y: float
    resolution_m: float


class DistanceMapModel:
    """Every point errs normally by its distance to the nearest line (Lu et al. 2013, section 4, equations 1 to 3).

    sigma_m: its σ of equation (2); a further one for particles that lie close may follow, used while `narrow` is set.
    farthest_sigmas: distance, in σ, from which a point counts no worse; None: the map's end. independent_points: the
    points count as so many independent ones, for neighbours on a line err together; None: each as one, equation (3).
    """

    def __init__(
        self,
        distance_map: DistanceMap,
        sigma_m: float,
        narrow_sigma_m: float | None = None,
        farthest_sigmas: float | None = None,
        independent_points: float | None = None,
        sample_m: float = 0.05,
    ) -> None:
        """sample_m: distance of the table's samples (m); fine beside σ, coarse enough for the processor's cache."""
        stride = max(round(sample_m / distance_map.resolution_m), 1)
        distances_m = np.ascontiguousarray(distance_map.values[::stride, ::stride, 0])
        origin_x, origin_y = distance_map.origin_m
        self.independent_points = independent_points
        self.narrow = False

        def errors(sigma_m: float) -> tuple[SquaredErrors, float]:
            """With this σ: squared distances (m²) and the factor 1 / (2 σ²) of equation (2)."""
            near_m = distances_m
            if farthest_sigmas is not None:
                near_m = np.minimum(distances_m, np.float32(farthest_sigmas * sigma_m))
            resolution_m = stride * distance_map.resolution_m
            return SquaredErrors(near_m**2, float(origin_x), float(origin_y), resolution_m), 0.5 / sigma_m**2

        self._wide = errors(sigma_m)
        self._narrow = self._wide if narrow_sigma_m is None else errors(narrow_sigma_m)

    def log_likelihoods(self, view: LineView, poses: FloatArray) -> FloatArray:
        """log P(o | l) (N,) of poses (N, 3), equation (3); the view's weights sum to 1."""
        errors, factor = self._narrow if self.narrow else self._wide
        factor *= self.independent_points or len(view.positions_m)  # weights sum to 1, so the count comes here
        return log_likelihoods(poses, view.positions_m, view.weights, errors, factor)


class ErrorMapModel:
    """Every point errs normally by the error map's value at its place (Ismail et al. 2021, equations 7 to 9).

    sigma_units: σ of equation (8) in units of the map. max_units: error from which a point counts no worse.
    """

    def __init__(self, error_map: ErrorMap, sigma_units: float, max_units: float = MAX_ERROR) -> None:
        self.map = error_map
        origin_x, origin_y = error_map.origin_m
        squares = np.minimum(error_map.values.astype(np.float32), np.float32(max_units)) ** 2
        self._errors = SquaredErrors(squares, float(origin_x), float(origin_y), error_map.resolution_m)
        self._factor = 0.5 / sigma_units**2

    def log_likelihoods(self, view: LineView, poses: FloatArray) -> FloatArray:
        """Logarithm (N,) of equation (9) for poses (N, 3); each point counts as often as its weight says."""
        return log_likelihoods(poses, view.positions_m, view.weights, self._errors, self._factor)

    def errors_m(self, points: FloatArray, pose: Pose) -> FloatArray:
        """Errors (M,) of points (M, 2) seen from a pose, in metres: distances, but for the map's steps and its end."""
        return self.map.look_up(pose.transform(points)) * (self.map.farthest_m / MAX_ERROR)


@numba.njit(cache=True)
def log_likelihoods(poses, points, weights, errors, factor):  # type: ignore[no-untyped-def]
    """log P(o | l) = -factor · sum of weight · error² (N,) of poses (N, 3).

    With weights 1 and factor 1 / (2 σ²) this is the product of equations (2) and (3) of Lu et al. 2013, and of (8) and
    (9) of Ismail et al. 2021. points (M, 2): robot frame, m. weights (M,). errors: SquaredErrors; the nearest sample
    counts, at the table's edge for points beyond it.
    """
    squares, origin_x, origin_y, resolution_m = errors
    last_x, last_y = float(squares.shape[1] - 1), float(squares.shape[0] - 1)
    samples_per_m = 1.0 / resolution_m
    found = np.empty(poses.shape[0])
    for j in range(poses.shape[0]):
        cosine, sine = math.cos(poses[j, 2]) * samples_per_m, math.sin(poses[j, 2]) * samples_per_m
        shift_x = (poses[j, 0] - origin_x) * samples_per_m + 0.5
        shift_y = (poses[j, 1] - origin_y) * samples_per_m + 0.5
        total = 0.0
        for i in range(points.shape[0]):
            fx = shift_x + cosine * points[i, 0] - sine * points[i, 1]
            fy = shift_y + sine * points[i, 0] + cosine * points[i, 1]
            fx = min(fx, last_x) if fx > 0.0 else 0.0  # written so that NaN never becomes an index
            fy = min(fy, last_y) if fy > 0.0 else 0.0
            total += weights[i] * squares[np.uint64(int(fy)), np.uint64(int(fx))]
        found[j] = -factor * total
    return found
