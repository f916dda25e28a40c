"""Numba loops over small matrices, and the numbers of a mirror's errors."""

from __future__ import annotations

import numpy as np
from numba import njit

ERRORS = 5
STATE = 3 + ERRORS
MIN_DEPTH = 0.2  # of 1 - g·p: beyond it is the horizon
SCALE_STEP_M = 0.1  # between the rows of a table of responses


@njit(cache=True)
def inverse(matrix):  # type: ignore[no-untyped-def]
    """Of a small square matrix, by Gauss and Jordan with pivots; NaN for a singular one."""
    n = len(matrix)
    left, right = matrix.copy(), np.eye(n)
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(left[i, k]) > abs(left[pivot, k]):
                pivot = i
        if not abs(left[pivot, k]) > 1e-300:
            return np.full((n, n), np.nan)
        if pivot != k:
            for j in range(n):
                left[k, j], left[pivot, j] = left[pivot, j], left[k, j]
                right[k, j], right[pivot, j] = right[pivot, j], right[k, j]
        scale = 1.0 / left[k, k]
        for j in range(n):
            left[k, j] *= scale
            right[k, j] *= scale
        for i in range(n):
            factor = left[i, k]
            if i != k and factor != 0.0:
                for j in range(n):
                    left[i, j] -= factor * left[k, j]
                    right[i, j] -= factor * right[k, j]
    return right


@njit(cache=True)
def times(a, b):  # type: ignore[no-untyped-def]
    """The product of two small matrices."""
    out = np.zeros((a.shape[0], b.shape[1]))
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            for j in range(b.shape[1]):
                out[i, j] += a[i, k] * b[k, j]
    return out
