"""Where the field ends in each column of cells (section 3.1): merged colours, thresholds, scan, smoothing, filling.

Rows of cells count from the top of the image, as in all images; the paper's j counts from the bottom.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.geometry import BoolArray, FloatArray, IntArray
from touchline.matrices import uncounted
from touchline.perception.line_graph.colour_classes import (
    BLACK,
    CELL_PX,
    FULL,
    GREEN,
    ORANGE,
    WHITE,
    CountArray,
)
from touchline.perception.line_graph.image_plane import (
    ImagePlane,
    Lens,
    ground_covariances,
    ground_from_pixel,
    horizon_rows,
    plane_from_pixel,
)
from touchline.perception.sorting import median_of

_GAP = 4  # cells in a row that are no field: the boundary is reached
_WIDE, _FIRST, _LAST = 4, 4, 8  # s: columns i - 4 .. i + 4, rows j - 8 .. j - 4
_CARPET = 0.15  # share of green from which on a cell shows carpet
_MEDIAN = 2  # cells to each side of the median filter
_EDGES = 3  # of the carpet in one image
_FREE, _ON_EDGE, _BEYOND = range(3)  # of where a column ends: below all edges, on one, above one or unknown
_ON, _ABOVE = 0.75, 1.5  # cells from an edge: up to here on it, from here on above it
_PAIRS_APART, _EVERY = 8, 3  # columns between two that an edge is laid through; every such column is tried
_MANY = 60  # from twice as many columns on (960 pixels) every second of these is tried, and so on
_MIN_ON = 0.12  # share of the columns that show an edge
_SOLID = 0.3  # share of green in a cell of carpet that is not beside its edge
_CARPET_COUNTS = 3  # a column with carpet above an edge speaks against it as so many do that end above it
_LOWERED = 4  # steps: the lens bends edges a little


class BoundaryThresholds(NamedTuple):
    """Shares of a full cell (t_pix), of two full rows (t_row) and of a full window below (t_win)."""

    pixel: float
    row: float
    window: float


@njit(cache=True)
def find_boundary(counts, plane, limits, plain, horizon, ends):  # type: ignore[no-untyped-def]
    """All of section 3.1: the height of the boundary, smoothed, into ends (columns,), and the highest row that sees
    ground into horizon (columns,). plain: as the paper has it, without our additions.
    """
    counts, plane, horizon, ends = uncounted((counts, plane, horizon, ends))
    rows, columns = counts.shape[1:]
    merged, field, rough = np.empty((rows, columns)), np.empty((rows, columns), dtype=np.bool_), np.empty(columns)
    field_colour(counts, merged)
    binarize(merged, limits, field)
    horizon_rows(plane, columns, rows, horizon)
    scan_columns(field, counts, horizon, plain, rough)
    if not plain:
        cut_to_edges(plane.lens, counts, rough)
    smooth_boundary(rough, ends)


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
def binarize(merged: FloatArray, limits: BoundaryThresholds, field: BoolArray) -> None:
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
def scan_columns(field: BoolArray, counts: CountArray, horizon: FloatArray, paper: bool, ends: FloatArray) -> None:
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


@njit(cache=True, error_model="numpy")
def cut_to_edges(lens: Lens, counts: CountArray, ends: FloatArray) -> None:
    """Cut what rises above the carpet's edges off the heights ends (columns,), in place. Ours, no part of the paper.

    The carpet is convex, so each of its edges, straight in the undistorted plane, bounds all of it from above: green
    boxes behind the field and white walls are cut off, what stands on the field hides an edge and is left as it is.
    An edge is where many columns end and few end above, fewer yet with carpet all the way up.
    """
    rows, columns = counts.shape[1:]
    points, carpet = np.empty((columns, 2)), np.empty(columns)
    state = np.empty(columns, dtype=np.int64)
    for i in range(columns):
        points[i, 0], points[i, 1] = _end_in_plane(lens, rows, i, ends[i])  # a whole row takes a second to compile
        carpet[i] = _end_in_plane(lens, rows, i, _carpet_end(counts, i, ends[i]))[1]
        known = 0.0 < ends[i] < rows - 0.5 and not np.isnan(points[i, 0] + points[i, 1])
        state[i] = _FREE if known else _BEYOND
    edges = np.empty((_EDGES, 2))
    count = 0
    while count < _EDGES and _next_edge(points, carpet, state, CELL_PX / lens.pinhole[1], edges[count]):
        count += 1
    for i in range(columns):
        for _ in range(_LOWERED):
            x, y = _end_in_plane(lens, rows, i, ends[i])
            over = 0.0
            for edge in edges[:count]:
                over = max(over, edge[0] + edge[1] * x - y)
            over *= lens.pinhole[1] / CELL_PX
            if not over > _ABOVE:
                break
            ends[i] = max(ends[i] - over, 0.0)


@njit(cache=True, error_model="numpy")
def _end_in_plane(lens: Lens, rows: int, column: int, end: float) -> tuple[float, float]:
    return plane_from_pixel(lens, CELL_PX * column + 0.5 * (CELL_PX - 1), CELL_PX * (rows - end) - 0.5)


@njit(cache=True)
def _carpet_end(counts: CountArray, column: int, end: float) -> float:
    """How high green reaches in a column without two cells in a row that are none."""
    rows = counts.shape[1]
    last, zeros, begun = rows, 0, False
    for row in range(rows - 1, rows - 1 - int(end + 0.5), -1):
        if counts[GREEN, row, column] >= _SOLID * FULL:
            last, zeros, begun = row, 0, True
        elif begun:
            zeros += 1
            if zeros == 2:
                break
    return np.float64(rows - last)


@njit(cache=True, error_model="numpy")
def _next_edge(points: FloatArray, carpet: FloatArray, state: IntArray, cell: float, edge: FloatArray) -> bool:
    """Lay an edge y = edge[0] + edge[1] x through the free ones of points (columns, 2) if many are on it.

    carpet: (columns,) y up to where each column is carpet. state: (columns,) of the points; is brought up to date.
    cell: size of one in the plane.
    """
    columns = len(points)
    best, every = 0, _EVERY * max(columns // _MANY, 1)
    x, y, free = points[:, 0].copy(), points[:, 1].copy(), points[:, 1].copy()
    for k in range(columns):  # what is NaN counts nowhere
        y[k] = np.nan if state[k] == _BEYOND else y[k]
        free[k] = free[k] if state[k] == _FREE else np.nan
    for i in range(0, columns - _PAIRS_APART, every):
        for j in range(i + _PAIRS_APART, columns, every):
            if state[i] != _FREE or state[j] != _FREE:
                continue
            slope = (y[j] - y[i]) / (x[j] - x[i])
            offset = y[i] - slope * x[i]
            on = against = 0
            for k in range(columns):
                edge_y = offset + slope * x[k]
                on += abs(edge_y - free[k]) < _ON * cell
                above = edge_y - y[k] > _ABOVE * cell
                against += above + (_CARPET_COUNTS - 1) * (above & (edge_y - carpet[k] > _ABOVE * cell))
            if on - against > best and on >= _MIN_ON * columns:
                best = on - against
                edge[0], edge[1] = offset, slope
    for k in range(columns):
        over = edge[0] + edge[1] * points[k, 0] - points[k, 1]
        if best > 0 and over >= -_ON * cell:
            state[k] = _BEYOND if over > _ABOVE * cell else max(state[k], _ON_EDGE)
    return best > 0


@njit(cache=True)
def smooth_boundary(ends: FloatArray, smoothed: FloatArray) -> None:
    """3.1.4: median and Gaussian filter, then once the local convex corner rule (1), into smoothed (columns,)."""
    columns = len(ends)
    calm, soft = np.empty(columns), np.empty(columns)
    for i in range(columns):
        calm[i] = median_of(ends[max(i - _MEDIAN, 0) : min(i + _MEDIAN + 1, columns)])
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


@njit(cache=True, error_model="numpy")
def boundary_points(plane: ImagePlane, ends: FloatArray, rows: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Pixels (N, 2) of the boundary that see ground, its points (N, 2) and their covariances (N, 2, 2)."""
    pixels, ground, count = np.empty((len(ends), 2)), np.empty((len(ends), 2)), 0
    for i in range(len(ends)):
        u, v = CELL_PX * i + 0.5 * (CELL_PX - 1), CELL_PX * (rows - ends[i]) - 0.5
        x, y = ground_from_pixel(plane, u, v)
        if ends[i] > 0.0 and v > 0.0 and math.isfinite(x + y):
            pixels[count, 0], pixels[count, 1], ground[count, 0], ground[count, 1] = u, v, x, y
            count += 1
    return pixels[:count], ground[:count], ground_covariances(plane, pixels[:count], 0.5 * CELL_PX, 0.05)
