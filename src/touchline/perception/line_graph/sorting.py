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
    """The median of values (N,), N at least 1."""
    order = order_of(values)
    half = len(order) // 2
    if len(order) % 2 == 1:
        return float(values[order[half]])
    return float(0.5 * (values[order[half - 1]] + values[order[half]]))
