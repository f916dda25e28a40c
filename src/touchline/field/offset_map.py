"""The offset map: from the nearest line point to each place, sampled on a grid for fast look-up.

Beside a straight line the offset is linear, so that bilinear look-ups of it are exact, on the line itself, too, where
distance and gradient have a kink.
"""

import functools
from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from touchline.field.distance_map import DistanceMap


class OffsetTable(NamedTuple):
    """Samples (ny, nx, 2), float32, of the offset x, y (m) from the nearest line point, and where the first of them
    lies (m, field frame).
    """

    values: npt.NDArray[np.float32]
    origin_x: float
    origin_y: float
    samples_per_m: float


@functools.lru_cache(maxsize=2)
def offset_table(distance_map: DistanceMap) -> OffsetTable:
    """The offsets of a distance map: distance times gradient. The same map returns the same table again."""
    values = distance_map.values
    offsets = np.ascontiguousarray(values[:, :, :1] * values[:, :, 1:])
    origin_x, origin_y = (float(value) for value in distance_map.origin_m)
    return OffsetTable(offsets, origin_x, origin_y, 1.0 / distance_map.resolution_m)


@numba.njit(cache=True, inline="always")
def look_up_offset(table, x, y):  # type: ignore[no-untyped-def]
    """Bilinear offset (ox, oy) in m at x, y (m, field frame).

    table: OffsetTable. A point outside the map gets the value of the nearest point of its edge; a NaN is safe.
    """
    values, origin_x, origin_y, samples_per_m = table
    fx = (x - origin_x) * samples_per_m
    fy = (y - origin_y) * samples_per_m
    # Written so that NaN fails the comparison: it must not become an index.
    fx = min(fx, values.shape[1] - 1.001) if fx > 0.0 else 0.0
    fy = min(fy, values.shape[0] - 1.001) if fy > 0.0 else 0.0
    column, row = int(fx), int(fy)
    fx -= column
    fy -= row
    ix, iy, one = np.uint64(column), np.uint64(row), np.uint64(1)  # no test for negative indices
    w11 = fx * fy
    w01, w10 = fx - w11, fy - w11
    w00 = 1.0 - fx - w10
    ox = (
        w00 * values[iy, ix, 0]
        + w01 * values[iy, ix + one, 0]
        + w10 * values[iy + one, ix, 0]
        + w11 * values[iy + one, ix + one, 0]
    )
    oy = (
        w00 * values[iy, ix, 1]
        + w01 * values[iy, ix + one, 1]
        + w10 * values[iy + one, ix, 1]
        + w11 * values[iy + one, ix + one, 1]
    )
    return ox, oy
