"""Numba loops over small matrices, for which NumPy takes longer than their sums.

Loops and no array expressions, here and where these are used: an assignment to a slice takes seconds to compile.
"""

import math
from typing import Any

import numpy as np
from numba import njit, types
from numba.extending import intrinsic


@njit(cache=True)
def inverse(matrix):  # type: ignore[no-untyped-def]
    """Of a small square matrix, by Gauss and Jordan with pivots; NaN for a singular one."""
    n = len(matrix)
    left, right = matrix.copy(), np.zeros((n, n))
    for k in range(n):
        right[k, k] = 1.0
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(left[i, k]) > abs(left[pivot, k]):
                pivot = i
        if not abs(left[pivot, k]) > 1e-300:
            for i in range(n):
                for j in range(n):
                    right[i, j] = math.nan
            return right
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


def _uncounted(typingctx, arrays):  # type: ignore[no-untyped-def]
    """An array, or a tuple that holds some, whose references nobody counts: for loops that call functions with it, as
    each call would count, which takes as long as a dozen sums. Whoever owns it has to outlive that use: arguments do,
    and local arrays in a loop that goes on with them.
    """

    def without_owner(context: Any, builder: Any, kind: Any, value: Any) -> Any:
        if isinstance(kind, types.Array):
            view = context.make_array(kind)(context, builder, value)
            view.meminfo = context.get_constant_null(types.voidptr)
            return view._getvalue()
        parts: Any = kind if isinstance(kind, types.BaseTuple) else ()
        for k, part in enumerate(parts):
            inner = without_owner(context, builder, part, builder.extract_value(value, k))
            value = builder.insert_value(value, inner, k)
        return value

    def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return without_owner(context, builder, signature.args[0], args[0])

    return arrays(arrays), generate


uncounted: Any = intrinsic(_uncounted)


@njit(cache=True)
def copy_row(row, to):  # type: ignore[no-untyped-def]
    """One of a matrix, into a row of another."""
    for k in range(len(row)):
        to[k] = row[k]


@njit(cache=True)
def times(a, b):  # type: ignore[no-untyped-def]
    """The product of two small matrices."""
    out = np.zeros((a.shape[0], b.shape[1]))
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            for j in range(b.shape[1]):
                out[i, j] += a[i, k] * b[k, j]
    return out


@njit(cache=True)
def applied(matrix, vector):  # type: ignore[no-untyped-def]
    """The product of a small matrix and a vector."""
    out = np.zeros(len(matrix))
    for i in range(len(matrix)):
        for k in range(len(vector)):
            out[i] += matrix[i, k] * vector[k]
    return out


@njit(cache=True)
def plus(a, b, factor):  # type: ignore[no-untyped-def]
    """a + factor * b, of two small matrices."""
    out = np.empty(a.shape)
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            out[i, k] = a[i, k] + factor * b[i, k]
    return out


@njit(cache=True)
def add_to(total, block, factor):  # type: ignore[no-untyped-def]
    """Add factor * block (A, B) to the upper left corner of a matrix, in place."""
    for i in range(block.shape[0]):
        for k in range(block.shape[1]):
            total[i, k] += factor * block[i, k]


@njit(cache=True)
def symmetrise(matrix):  # type: ignore[no-untyped-def]
    """The mean of a square matrix and its transpose, in place."""
    for i in range(len(matrix)):
        for k in range(i):
            matrix[i, k] = matrix[k, i] = 0.5 * (matrix[i, k] + matrix[k, i])


@njit(cache=True)
def dot(a, b):  # type: ignore[no-untyped-def]
    """The sum of products of two vectors."""
    total = 0.0
    for k in range(len(a)):
        total += a[k] * b[k]
    return total


@njit(cache=True, error_model="numpy")
def log_determinant(matrix):  # type: ignore[no-untyped-def]
    """Logarithm of the determinant of a positive definite matrix, by elimination."""
    left, log = matrix.copy(), 0.0
    for k in range(len(left)):
        log += math.log(abs(left[k, k]))
        for i in range(k + 1, len(left)):
            factor = left[i, k] / left[k, k]
            for j in range(k + 1, len(left)):
                left[i, j] -= factor * left[k, j]
    return log
