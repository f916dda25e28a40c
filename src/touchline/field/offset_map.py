"""The offset map: from the nearest line point to each place, sampled on a grid for fast look-up.

Beside a straight line the offset is linear, so that bilinear look-ups of it are exact, on the line itself, too, where
distance and gradient have a kink.
"""

import functools
from typing import NamedTuple

import numba
import numpy as np

from touchline.field.distance_map import DistanceMap
from touchline.geometry import Float32Array, Int32Array, IntArray

CHUNK = 32  # places that are looked up together: their numbers fill a few kilobytes of the first-level cache
OFFSETS = 2 * CHUNK  # where the offsets begin


class OffsetTable(NamedTuple):
    """Samples (ny, nx, 2), float32, of the offset x, y (m) from the nearest line point, and where the first of them
    lies (m, field frame).
    """

    values: Float32Array
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


class Lookup(NamedTuple):
    """An OffsetTable laid flat, both numbers of each sample as one; where, corners: room for CHUNK places."""

    samples: IntArray
    width: np.int32
    limits: tuple[float, float]
    origin: tuple[float, float]
    samples_per_m: float
    where: Int32Array
    corners: IntArray


@numba.njit(cache=True)
def lookup_of(table):  # type: ignore[no-untyped-def]
    """The Lookup of an OffsetTable."""
    values = table.values
    return Lookup(
        values.view(np.int64).reshape(-1), np.int32(values.shape[1]),
        (values.shape[1] - 1.001, values.shape[0] - 1.001), (table.origin_x, table.origin_y), table.samples_per_m,
        np.empty(CHUNK, np.int32), np.empty(4 * CHUNK, np.int64),
    )  # fmt: skip


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def look_up_offsets(lookup, places):  # type: ignore[no-untyped-def]
    """Bilinear offsets (m) at CHUNK places: of places (4 CHUNK,), x in the first CHUNK numbers and y in the next (m,
    field frame), `OFFSETS` and what follows is filled with the offsets' x and y.

    A point outside the map gets the value of the nearest point of its edge; a NaN is safe. Each loop does one simple
    thing on arrays whose distances are constants, so that the compiler makes SIMD instructions of all but the reading.
    """
    corners, where, last = lookup.corners, lookup.where, lookup.limits
    for i in range(CHUNK):
        fx = (places[i] - lookup.origin[0]) * lookup.samples_per_m
        fy = (places[CHUNK + i] - lookup.origin[1]) * lookup.samples_per_m
        # Written so that NaN fails the comparison: it must not become an index.
        fx = min(fx, last[0]) if fx > 0.0 else 0.0
        fy = min(fy, last[1]) if fy > 0.0 else 0.0
        column, row = np.int32(fx), np.int32(fy)
        where[i] = row * lookup.width + column
        places[i], places[CHUNK + i] = fx - column, fy - row
    one, below = np.uint64(1), np.uint64(lookup.width)  # no test for negative indices
    for i in range(CHUNK):
        at = np.uint64(where[i])
        corners[i], corners[CHUNK + i] = lookup.samples[at], lookup.samples[at + one]
        corners[2 * CHUNK + i], corners[3 * CHUNK + i] = lookup.samples[at + below], lookup.samples[at + below + one]
    values = corners.view(np.float32)
    for i in range(CHUNK):
        fx, fy = places[i], places[CHUNK + i]
        w11 = fx * fy
        w01, w10 = fx - w11, fy - w11
        w00 = 1.0 - fx - w10
        k00, k01, k10, k11 = 2 * i, 2 * (CHUNK + i), 2 * (2 * CHUNK + i), 2 * (3 * CHUNK + i)
        places[OFFSETS + i] = w01 * values[k01] + w00 * values[k00] + w10 * values[k10] + w11 * values[k11]
        k00, k01, k10, k11 = k00 + 1, k01 + 1, k10 + 1, k11 + 1
        places[OFFSETS + CHUNK + i] = w01 * values[k01] + w00 * values[k00] + w10 * values[k10] + w11 * values[k11]
