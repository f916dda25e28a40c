"""Every pose worth refining, from one observation and nothing else: the whole field, the whole circle."""

from __future__ import annotations

import math

import numpy as np

from touchline.field.distance_map import DistanceMap
from touchline.geometry import FloatArray, wrap_angles
from touchline.localization.matching.global_search import sample_positions
from touchline.localization.matching.kernels import grid_errors

_COARSE_M = 0.1


class PoseGrid:
    """Sample poses over a field: positions (K, 2) in m, headings (H,) in rad."""

    def __init__(
        self,
        length_m: float,
        width_m: float,
        spacing_m: float,
        beyond_m: float,
        spacing_rad: float,
        heading: float | None = None,
        tolerance_rad: float = math.pi,
    ) -> None:
        """length_m, width_m: of the field. heading, tolerance_rad: search only this far to each side of a heading."""
        self.spacing_m = spacing_m
        self.spacing_rad = spacing_rad
        self.positions = sample_positions(length_m, width_m, spacing_m, beyond_m)
        if heading is None:
            count = math.ceil(2 * math.pi / spacing_rad)
            self.headings = np.arange(count) * 2 * math.pi / count
        else:
            each_side = math.ceil(tolerance_rad / spacing_rad)
            self.headings = heading + np.linspace(-tolerance_rad, tolerance_rad, 2 * each_side + 1)

    def best(self, distance_map: DistanceMap, points: FloatArray, c_m: float, count: int) -> FloatArray:
        """The best poses (up to count, 3), the better first, no two of them neighbours on the grid.

        points (N, 2) robot frame; each pose is judged by its mean error (equation 2 of Xiong et al.) with width c_m.
        """
        # A tenth of a metre is fine enough for samples half a metre apart, and such a table stays in the cache.
        stride = max(round(_COARSE_M / distance_map.resolution_m), 1)
        coarse = distance_map.table._replace(
            values=np.ascontiguousarray(distance_map.values[::stride, ::stride, :1]),
            resolution_m=distance_map.resolution_m * stride,
        )
        errors = grid_errors(points, coarse, self.positions, self.headings, c_m).ravel()
        likely = min(len(errors), 100 * count)  # the rest is never reached: each pick strikes out some 30 neighbours
        order = np.argpartition(errors, likely - 1)[:likely]
        order = order[np.argsort(errors[order])]
        of_heading, of_position = np.divmod(order, len(self.positions))
        positions, headings = self.positions[of_position], self.headings[of_heading]
        free = np.ones(likely, dtype=bool)
        picks: list[int] = []
        while len(picks) < count and free.any():
            pick = int(np.argmax(free))
            picks.append(pick)
            near = np.max(np.abs(positions - positions[pick]), axis=1) < 1.5 * self.spacing_m
            near &= np.abs(wrap_angles(headings - headings[pick])) < 2.5 * self.spacing_rad
            free &= ~near
        return np.column_stack((positions[picks], headings[picks]))


def thinned(points: FloatArray, cell_m: float) -> FloatArray:
    """One point (the first) of every square cell of this size that holds any: (M, 2) of (N, 2)."""
    _, first = np.unique(np.floor(points / cell_m), axis=0, return_index=True)
    return np.ascontiguousarray(points[np.sort(first)])


def thinned_to(points: FloatArray, count: int) -> FloatArray:
    """About so many points at most, evenly over the ground: cells grow until few enough are left."""
    cell_m, kept = 0.02, points
    while len(kept) > count:
        kept = thinned(points, cell_m)
        cell_m *= 1.2
    return np.ascontiguousarray(kept)
