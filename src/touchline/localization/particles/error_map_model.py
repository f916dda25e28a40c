"""The sensor model on the error map (Ismail et al. 2021, section II.C, equations 7 to 9)."""

from __future__ import annotations

import numpy as np

from touchline.field.error_map import FARTHEST, ErrorMap
from touchline.geometry import FloatArray, Pose
from touchline.localization.particles.sensor_model import LineView, SquaredErrors, log_likelihoods


class ErrorMapModel:
    """Every point errs normally by the map's error of its place.

    sigma_units: σ of equation (8) in units of the map. max_units: error from which a point counts no worse.
    """

    def __init__(self, error_map: ErrorMap, sigma_units: float, max_units: float = FARTHEST) -> None:
        self.map = error_map
        origin_x, origin_y = error_map.origin_m
        squares = np.minimum(error_map.values.astype(np.float32), np.float32(max_units)) ** 2
        self._errors = SquaredErrors(squares, float(origin_x), float(origin_y), error_map.resolution_m)
        self._factor = 0.5 / sigma_units**2

    def log_likelihoods(self, view: LineView, poses: FloatArray) -> FloatArray:
        """Logarithm (N,) of equation (9) for poses (N, 3); each point counts as often as its weight says."""
        found: FloatArray = log_likelihoods(poses, view.positions_m, view.weights, self._errors, self._factor)
        return found

    def errors_m(self, points: FloatArray, pose: Pose) -> FloatArray:
        """Errors (M,) of points (M, 2) seen from a pose, in metres: distances, but for the map's steps and its end."""
        errors: FloatArray = self.map.look_up(pose.transform(points)) * (self.map.farthest_m / FARTHEST)
        return errors


__all__ = ["ErrorMapModel"]
