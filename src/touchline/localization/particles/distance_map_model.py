"""The sensor model on the distance map (Lu et al. 2013, section 4, equations 1 to 3)."""

from __future__ import annotations

import numpy as np

from touchline.field.distance_map import DistanceMap
from touchline.geometry import FloatArray
from touchline.localization.particles.sensor_model import LineView, SquaredErrors, log_likelihoods


class DistanceMapModel:
    """Every point errs normally by its distance to the nearest line.

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
        found: FloatArray = log_likelihoods(poses, view.positions_m, view.weights, errors, factor)
        return found


__all__ = ["DistanceMapModel"]
