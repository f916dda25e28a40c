"""Every pose worth refining, from one observation and nothing else: the whole field, the whole circle."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from touchline.errors import InputError
from touchline.geometry import FloatArray
from touchline.localization.matching.global_search import sample_positions

_LEAST_SPACING_RAD = 1e-3


class PoseGrid:
    """Sample poses over a field: positions (K, 2) in m, headings (H,) in rad.

    shape: rows, one for each x, and columns, one for each y, that the positions are in, row by row.
    """

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
        if spacing_rad < _LEAST_SPACING_RAD:
            raise InputError(f"headings {spacing_rad:g} rad apart are too many; {_LEAST_SPACING_RAD:g} is the least")
        self.spacing_m = spacing_m
        self.spacing_rad = spacing_rad
        self.positions = sample_positions(length_m, width_m, spacing_m, beyond_m)
        columns = int(np.count_nonzero(self.positions[:, 0] == self.positions[0, 0]))
        self.shape = (len(self.positions) // columns, columns)
        if heading is None:
            count = math.ceil(2 * math.pi / spacing_rad)
            self.headings = np.arange(count) * 2 * math.pi / count
        else:
            each_side = math.ceil(tolerance_rad / spacing_rad)
            self.headings = heading + np.linspace(-tolerance_rad, tolerance_rad, 2 * each_side + 1)


def different(rows: FloatArray) -> npt.NDArray[np.intp]:
    """Indices of the rows of (N, 2), each the first of those that are equal, in their order."""
    pairs = np.ascontiguousarray(rows).view(np.complex128).ravel()  # sorted five times faster than rows are
    return np.sort(np.unique(pairs, return_index=True)[1])


def sampled(points: FloatArray, weights: FloatArray, count: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """So many draws at most of points (N, 2), in proportion to their weights (N,), and the weights of those drawn.

    Weighted means of the sample are on average those of all points. One draw is made from each of `count` equal shares
    of the weight, in the points' order, so that a sample of points along lines holds every line. Weights sum to 1.
    """
    if len(points) <= count:
        return points, weights
    summed = np.cumsum(weights)
    places = (np.arange(count) + np.random.default_rng(seed).random(count)) * (summed[-1] / count)
    drawn, times = np.unique(np.minimum(np.searchsorted(summed, places, "right"), len(points) - 1), return_counts=True)
    return np.ascontiguousarray(points[drawn]), times / count


def thinned(points: FloatArray, cell_m: float) -> FloatArray:
    """One point (the first) of every square cell of this size that holds any: (M, 2) of (N, 2)."""
    return np.ascontiguousarray(points[different(np.floor(points / cell_m))])


def thinned_to(points: FloatArray, count: int) -> FloatArray:
    """About so many points at most, evenly over the ground: cells grow until few enough are left."""
    cell_m, kept = 0.02, points
    while len(kept) > count:
        kept = thinned(points, cell_m)
        cell_m *= 1.2
    return np.ascontiguousarray(kept)
