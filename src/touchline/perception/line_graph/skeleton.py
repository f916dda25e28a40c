"""Low-pass and skeleton of the white cells (section 3.2): a ranking operator finds the middle of lines."""

import numpy as np
from numba import njit

from touchline.geometry import ByteArray, FloatArray, IntArray
from touchline.perception.line_graph.colour_classes import WHITE, CountArray

NO_SKELETON = 9
"""Rank of a cell that is not on the skeleton."""
_MAX_EQUAL = 3  # a cell with fewer neighbours that are as white or whiter is on the skeleton


@njit(cache=True)
def white_inside(counts: CountArray, ends: FloatArray, white: FloatArray) -> None:
    """The white counts below the boundary, into white (rows, columns); ends: (columns,) its height in cells."""
    rows, columns = white.shape
    for column in range(columns):
        top = rows - ends[column]
        for row in range(rows):
            white[row, column] = np.float64(counts[WHITE, row, column]) if row + 0.5 >= top else 0.0


@njit(cache=True)
def low_pass(white: FloatArray, passes: IntArray, smooth: FloatArray) -> None:
    """A binomial 3 x 3 filter, as often as each row wants, into smooth (rows, columns).

    passes: (rows,) at least 1, more where lines are wider than two cells: each cross-section shall have one maximum.
    """
    rows, columns = white.shape
    now, along = white.copy(), np.empty((rows, columns))
    most = 0
    for row in range(rows):
        most = max(most, passes[row])
    for turn in range(1, most + 1):
        for row in range(rows):
            for column in range(columns):
                left, right = max(column - 1, 0), min(column + 1, columns - 1)
                along[row, column] = 0.25 * now[row, left] + 0.5 * now[row, column] + 0.25 * now[row, right]
        for row in range(rows):
            above, below = max(row - 1, 0), min(row + 1, rows - 1)
            for column in range(columns):
                now[row, column] = 0.25 * along[above, column] + 0.5 * along[row, column] + 0.25 * along[below, column]
        for row in range(rows):
            if passes[row] == turn:
                for column in range(columns):  # copying a row at once would take a second to compile
                    smooth[row, column] = now[row, column]


@njit(cache=True)
def rank_cells(smooth: FloatArray, ranks: ByteArray, least: float) -> None:
    """How many of the eight neighbours are as white or whiter, into ranks (rows, columns): below three is skeleton.

    NO_SKELETON elsewhere. least: whiteness below which a cell is background, as one without any is.
    """
    rows, columns = smooth.shape
    ranks[:] = NO_SKELETON
    for row in range(rows):
        for column in range(columns):
            here = smooth[row, column]
            if not here > 0.0 or here < least:
                continue
            count = 0
            for r in range(row - 1, row + 2):
                for c in range(column - 1, column + 2):
                    # beyond the image's edge its outermost cells go on, as lines do
                    beyond = smooth[min(max(r, 0), rows - 1), min(max(c, 0), columns - 1)]
                    if (r != row or c != column) and beyond >= here:
                        count += 1
            if count < _MAX_EQUAL:
                ranks[row, column] = count
