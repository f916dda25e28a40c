"""The error map: how far each place is from the nearest line, in 256 steps (Ismail et al. 2021, figure 9)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from touchline.errors import InputError
from touchline.field.model import FieldModel
from touchline.geometry import FloatArray
from touchline.types import ImageArray

FARTHEST = 255  # the map's unit is this many times smaller than the distance at which it ends


@dataclass(frozen=True, eq=False, slots=True)
class ErrorMap:
    """Errors of places on a field: 0 on a line's centre, 255 at `farthest_m` from the nearest line and beyond.

    values: uint8 (ny, nx), treat as read-only. origin_m: float64 (2,), field position of sample [0, 0]; sample
    [iy, ix] lies at origin_m + resolution_m * (ix, iy). The samples at the edge are 255, so it holds beyond them, too.
    """

    values: ImageArray
    origin_m: FloatArray
    resolution_m: float
    farthest_m: float

    def look_up(self, points: npt.ArrayLike) -> ImageArray:
        """Errors (N,) of the samples nearest to points (N, 2) in m, field frame: d(o) of equation (8)."""
        samples = (np.asarray(points, dtype=np.float64) - self.origin_m) / self.resolution_m + 0.5
        last = np.array(self.values.shape[::-1], dtype=np.float64) - 1.0
        ix, iy = np.minimum(np.maximum(samples, 0.0), last).astype(np.int64).T
        errors: ImageArray = self.values[iy, ix]
        return errors

    def picture(self) -> ImageArray:
        """Figure 9 (b), uint8 (H, W): x upwards, y to the left, one pixel per sample, lines black."""
        return np.ascontiguousarray(self.values.T[::-1, ::-1])


def error_map(field: FieldModel, resolution_m: float = 0.05, farthest_m: float = 1.0) -> ErrorMap:
    """The error map of a field, from exact distances, rounded to the nearest of the 256 steps.

    It reaches farthest_m beyond length and width: farther out everything is 255.
    Raises InputError for a resolution or distance that makes no map.
    """
    if not 0.0 < farthest_m < float("inf"):
        raise InputError(f"error map: expected a positive distance at which it ends, found {farthest_m}")
    distances = field.distance_map(resolution_m, farthest_m)
    values = np.rint(FARTHEST * np.minimum(distances.values[:, :, 0] / farthest_m, 1.0)).astype(np.uint8)
    return ErrorMap(values, distances.origin_m, distances.resolution_m, farthest_m)
