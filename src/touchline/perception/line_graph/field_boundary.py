"""Where the field ends in each column of cells (section 3.1): merged colours, thresholds, scan, smoothing, filling.

Rows of cells count from the top of the image, as in all images; the paper's j counts from the bottom.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.geometry import FloatArray
from touchline.perception.line_graph.colour_classes import (
    BLACK,
    CELL_PX,
    FULL,
    GREEN,
    ORANGE,
    WHITE,
    CountArray,
)

_GAP = 4  # cells in a row that are no field: the boundary is reached
_WIDE, _FIRST, _LAST = 4, 4, 8  # s: columns i - 4 .. i + 4, rows j - 8 .. j - 4
_CARPET = 0.15  # share of green from which on a cell shows carpet
_MEDIAN = 2  # cells to each side of the median filter


class BoundaryThresholds(NamedTuple):
    """Shares of a full cell (t_pix), of two full rows (t_row) and of a full window below (t_win)."""

    pixel: float
    row: float
    window: float


@njit(cache=True)
def field_colour(counts: CountArray, merged: FloatArray) -> None:
    """3.1.1: green and orange whole, white and black half, into merged (rows, columns), 0 to 1."""
    rows, columns = merged.shape
    for row in range(rows):
        for column in range(columns):
            sure = np.float64(counts[GREEN, row, column]) + np.float64(counts[ORANGE, row, column])
            unsure = np.float64(counts[WHITE, row, column]) + np.float64(counts[BLACK, row, column])
            merged[row, column] = (sure + 0.5 * unsure) / FULL


@njit(cache=True)
def binarize(merged: FloatArray, limits: BoundaryThresholds, field: npt.NDArray[np.bool_]) -> None:
    """3.1.2: which cells are field, into field (rows, columns).

    Rows beyond the image's lower edge are left out of the sums, which are means here: where none is left, the cell
    lies so low that only its own colour tells.
    """
    rows, columns = merged.shape
    sums = np.zeros((rows + 1, columns + 1))
    for row in range(rows):
        along = 0.0
        for column in range(columns):
            along += merged[row, column]
            sums[row + 1, column + 1] = sums[row, column + 1] + along
    for row in range(rows):
        below = min(row + 2, rows)
        row_mean = (sums[below, columns] - sums[row, columns]) / ((below - row) * columns)
        top, bottom = min(row + _FIRST, rows), min(row + _LAST + 1, rows)
        for column in range(columns):
            inside = merged[row, column] >= limits.pixel
            if inside and row_mean <= limits.row and bottom > top:
                left, right = max(column - _WIDE, 0), min(column + _WIDE + 1, columns)
                window = sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left]
                inside = window > limits.window * (bottom - top) * (right - left)
            field[row, column] = inside


@njit(cache=True)
def scan_columns(
    field: npt.NDArray[np.bool_], counts: CountArray, horizon: FloatArray, paper: bool, ends: FloatArray
) -> None:
    """3.1.3: the height (cells above the image's lower edge) where each column's field ends, into ends (columns,).

    horizon: (columns,) row above which no ground is seen. paper: without our additions: the robot's own body at the
    lower edge is passed over, the end is trimmed to the last carpet (a white wall behind the field passes all three
    thresholds), to a share of a cell.
    """
    rows, columns = field.shape
    for column in range(columns):
        last, zeros, begun = rows, 0, paper
        highest = 0 if paper else max(0, int(horizon[column]))
        for row in range(rows - 1, highest - 1, -1):
            begun = begun or counts[GREEN, row, column] >= _CARPET * FULL
            if field[row, column] and begun:
                last, zeros = row, 0
            elif begun:
                zeros += 1
                if zeros == _GAP:
                    break
        end = np.float64(rows - last)
        if not paper:
            while last < rows and counts[GREEN, last, column] < _CARPET * FULL:
                last += 1
            end = np.float64(rows - last)
            if last < rows - 1:
                full = max(np.float64(counts[GREEN, last + 1, column]), 0.5 * FULL)
                end -= 1.0 - min(1.0, np.float64(counts[GREEN, last, column]) / full)
        ends[column] = end


@njit(cache=True)
def smooth_boundary(ends: FloatArray, smoothed: FloatArray) -> None:
    """3.1.4: median and Gaussian filter, then once the local convex corner rule (1), into smoothed (columns,)."""
    columns = len(ends)
    calm, soft = np.empty(columns), np.empty(columns)
    for i in range(columns):
        calm[i] = np.median(ends[max(i - _MEDIAN, 0) : min(i + _MEDIAN + 1, columns)])
    for i in range(columns):
        soft[i] = 0.25 * calm[max(i - 1, 0)] + 0.5 * calm[i] + 0.25 * calm[min(i + 1, columns - 1)]
    corner = 0
    smoothed[0] = soft[0]
    for i in range(1, columns):
        last = i == columns - 1
        if not last and 2.0 * (soft[i] - soft[i - 1]) - (soft[i + 1] - soft[i - 1]) < 0.0:
            continue
        for k in range(corner + 1, i + 1):  # the straight line between two corners of the locally convex hull
            smoothed[k] = soft[corner] + (soft[i] - soft[corner]) * (k - corner) / (i - corner)
        corner = i


def boundary_pixels(ends: FloatArray, rows: int) -> FloatArray:
    """(columns, 2) u, v of the boundary in the middle of each column of cells; rows: of cells."""
    u = CELL_PX * np.arange(len(ends)) + 0.5 * (CELL_PX - 1)
    return np.column_stack((u, CELL_PX * (rows - ends) - 0.5))
