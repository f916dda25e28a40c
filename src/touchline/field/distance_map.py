"""The distance map: distance to the nearest line and its gradient, sampled on a grid for fast look-up."""

from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np

from touchline.geometry import Float32Array, FloatArray, pairs_of


class MapTable(NamedTuple):
    """What the loops take of a `DistanceMap`: its samples and where the first of them lies (m, field frame)."""

    values: Float32Array
    origin_x: float
    origin_y: float
    resolution_m: float


@dataclass(frozen=True, eq=False, slots=True)
class DistanceMap:
    """Samples of the exact distance to the nearest line centre (Xiong et al., section 4.2; Lauer et al. 2006).

    values: float32 (ny, nx, 3), C order, treat as read-only: distance (m), d/dx, d/dy. The gradient is the unit
    vector away from the nearest line point and zero on the line itself. origin_m: float64 (2,), field position of
    sample [0, 0]; sample [iy, ix] lies at origin_m + resolution_m * (ix, iy).
    """

    values: Float32Array
    origin_m: FloatArray
    resolution_m: float

    @property
    def table(self) -> MapTable:
        """The map as the loops take it."""
        return MapTable(self.values, float(self.origin_m[0]), float(self.origin_m[1]), self.resolution_m)

    def look_up(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Bilinear distances (N,) in m and gradients (N, 2) at points (N, 2) in m, field frame.

        Outside the map the value at the nearest point of its edge is returned.
        """
        found = _look_up_all(self.table, pairs_of(points))
        return found[:, 0], found[:, 1:]


@numba.njit(cache=True, inline="always")
def lookup(table, x, y):  # type: ignore[no-untyped-def]
    """Bilinear look-up (d, gx, gy): distance (m) and its gradient at x, y (m, field frame).

    table: MapTable. A point outside the map gets the value of the nearest point of its edge; a NaN is safe and lands
    on the lower edge.
    """
    values, origin_x, origin_y, resolution_m = table
    last_x, last_y = values.shape[1] - 1, values.shape[0] - 1
    samples_per_m = 1.0 / resolution_m  # computed once per loop, where this is inlined
    fx = (x - origin_x) * samples_per_m
    fy = (y - origin_y) * samples_per_m
    # Written so that NaN fails the comparison: it must not become an index.
    fx = min(fx, float(last_x)) if fx > 0.0 else 0.0
    fy = min(fy, float(last_y)) if fy > 0.0 else 0.0
    ix = min(int(fx), last_x - 1)
    iy = min(int(fy), last_y - 1)
    fx -= ix
    fy -= iy
    w11 = fx * fy
    w01, w10 = fx - w11, fy - w11
    w00 = 1.0 - fx - w10
    d = (
        w00 * values[iy, ix, 0]
        + w01 * values[iy, ix + 1, 0]
        + w10 * values[iy + 1, ix, 0]
        + w11 * values[iy + 1, ix + 1, 0]
    )
    gx = (
        w00 * values[iy, ix, 1]
        + w01 * values[iy, ix + 1, 1]
        + w10 * values[iy + 1, ix, 1]
        + w11 * values[iy + 1, ix + 1, 1]
    )
    gy = (
        w00 * values[iy, ix, 2]
        + w01 * values[iy, ix + 1, 2]
        + w10 * values[iy + 1, ix, 2]
        + w11 * values[iy + 1, ix + 1, 2]
    )
    return d, gx, gy


@numba.njit(cache=True)
def _look_up_all(table, points):  # type: ignore[no-untyped-def]
    """Rows d, gx, gy (N, 3) of `lookup` at points (N, 2)."""
    found = np.empty((points.shape[0], 3))
    for i in range(points.shape[0]):
        d, gx, gy = lookup(table, points[i, 0], points[i, 1])
        found[i, 0], found[i, 1], found[i, 2] = d, gx, gy
    return found
