"""Order and median of a few numbers in compiled loops; those of NumPy take a second each to compile."""

import numpy as np
from numba import njit

from touchline.geometry import FloatArray, IntArray


@njit(cache=True)
def order_of(values: FloatArray) -> IntArray:
    """Indices (N,) that sort values (N,), equal ones as they stand; N is small."""
    order = np.empty(len(values), dtype=np.int64)
    for k in range(len(values)):
        at = k
        while at > 0 and values[order[at - 1]] > values[k]:
            order[at] = order[at - 1]
            at -= 1
        order[at] = k
    return order


@njit(cache=True)
def median_of(values: FloatArray) -> float:
    """The median of values (N,), N at least 1; by Hoare's selection."""
    rest, half = values.copy(), len(values) // 2
    low, high = 0, len(rest) - 1
    while low < high:
        pivot, i, k = rest[half], low, high
        while i <= k:
            while rest[i] < pivot:
                i += 1
            while rest[k] > pivot:
                k -= 1
            if i <= k:
                rest[i], rest[k] = rest[k], rest[i]
                i, k = i + 1, k - 1
        low, high = i if k < half else low, k if i > half else high
    if len(rest) % 2 == 1:
        return float(rest[half])
    below = rest[0]
    for value in rest[1:half]:
        below = max(below, value)
    return float(0.5 * (below + rest[half]))
