"""The error map: how far each place is from the nearest line, in 256 steps (Ismail et al. 2021, figure 9)."""

from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from touchline.errors import InputError
from touchline.field.model import FieldModel
from touchline.geometry import FloatArray, pairs_of
from touchline.types import ImageArray

MAX_ERROR = 255  # the map's unit is this many times smaller than the distance at which it ends


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
        places = pairs_of(points)
        return _look_up_all(self.values, self.origin_m[0], self.origin_m[1], self.resolution_m, places)

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
    values = np.rint(MAX_ERROR * np.minimum(distances.values[:, :, 0] / farthest_m, 1.0)).astype(np.uint8)
    return ErrorMap(values, distances.origin_m, distances.resolution_m, farthest_m)


@numba.njit(cache=True)
def _look_up_all(values, origin_x, origin_y, resolution_m, points):  # type: ignore[no-untyped-def]
    """Values (N,) of the samples (ny, nx) nearest to points (N, 2) in m; at the edge for points beyond it, or NaN."""
    found = np.empty(points.shape[0], dtype=np.uint8)
    last_x, last_y = float(values.shape[1] - 1), float(values.shape[0] - 1)
    for i in range(points.shape[0]):
        fx = (points[i, 0] - origin_x) / resolution_m + 0.5
        fy = (points[i, 1] - origin_y) / resolution_m + 0.5
        fx = min(fx, last_x) if fx > 0.0 else 0.0  # written so that NaN never becomes an index
        fy = min(fy, last_y) if fy > 0.0 else 0.0
        found[i] = values[int(fy), int(fx)]
    return found
