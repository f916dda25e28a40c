"""Fewer points of an observation that stand for all of them."""

from bisect import bisect_left

import numpy as np

from touchline.geometry import FloatArray, IndexArray

_CELLS_M = np.cumprod([0.02, *[1.2] * 127]).tolist()


def different(rows: FloatArray) -> IndexArray:
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
    """About so many points at most, evenly over the ground: cells as small as leave few enough."""
    if len(points) <= count:
        return np.ascontiguousarray(points)
    few_enough = bisect_left(_CELLS_M, True, key=lambda cell_m: len(thinned(points, cell_m)) <= count)
    return thinned(points, _CELLS_M[min(few_enough, len(_CELLS_M) - 1)])
