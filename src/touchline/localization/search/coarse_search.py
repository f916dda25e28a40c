"""The first look at a whole field: every pose of a grid judged by table look-ups, and the best of them."""

import math
from typing import NamedTuple

import numba
import numpy as np

from touchline.field.distance_map import DistanceMap
from touchline.geometry import Float32Array, FloatArray
from touchline.localization.search.pose_grid import PoseGrid

_CELL_M = 0.1  # fine enough for poses half a metre apart
_LANES = 8  # rows of poses are filled up to a multiple of this: whole vector registers
_SAMPLED = 19  # every so many errors tell a bound for the smallest ones; prime, so that all columns are among them


class ShiftTable(NamedTuple):
    """1 - e(t) on a grid of cells, sorted such that the cells one pose spacing apart are neighbours in memory.

    values: float32 (n, n, X, Y): [px, py, bx, by] is cell (n bx + px, n by + py); n cells are one spacing. Beyond the
    distance map its edge is repeated, so far that a shift of all poses never leaves the table.
    first_x, first_y: cell, as a fraction, on which the first pose's own position lies. cell_m: size of a cell.
    """

    values: Float32Array
    first_x: float
    first_y: float
    cell_m: float


class Window(NamedTuple):
    """A piece of a grid: rows and columns of its positions from first ones on, and headings (H,) of their own."""

    first_row: int
    rows: int
    first_column: int
    columns: int
    headings: FloatArray


class CoarseSearch:
    """The poses of a grid that are worth refining, by their mean error (equation 2 of Xiong et al.) with one width c.

    A point seen at one heading is shifted by the same whole number of cells at all positions, since these are a whole
    number of cells apart. So it adds one block of the table to the sums of all positions at once.
    """

    def __init__(self, distance_map: DistanceMap, grid: PoseGrid, c_m: float) -> None:
        self._grid = grid
        self._table = _shift_table(distance_map, grid, c_m)

    def best(self, points: FloatArray, count: int, window: Window | None = None, neighbours: int = 1) -> FloatArray:
        """The best poses (up to count, 3), the better first, no two of them neighbours on the grid.

        points (N, 2) robot frame. window: of the grid, by default all of it. neighbours: up to so many steps of the
        positions apart; 0 for those at the same position alone.
        """
        of = window or self.whole
        return self.smallest(self.errors(points, of), count, of, neighbours)

    def smallest(self, errors: Float32Array, count: int, of: Window, neighbours: int) -> FloatArray:
        """The poses (up to count, 3) of a window with the smallest of its errors (H, K); see `best`."""
        near = ((neighbours + 0.5) * self._grid.spacing_m, 2.5 * self._grid.spacing_rad)
        for likely in (10 * count, 100 * count):  # the first do mostly; beyond the last no pick is reached
            poses = self._first(errors.ravel(), min(likely, errors.size), of)
            picks = _far_apart(poses, *near, count)
            if len(picks) == count or likely >= errors.size:
                break
        return np.asarray(poses[picks])

    def _first(self, errors: Float32Array, count: int, of: Window) -> FloatArray:
        """The poses (count, 3) with the smallest of a window's errors, in their order."""
        sample = errors[::_SAMPLED]  # below its bound are some twice as many as wanted, soon sorted
        last = min(2 * count // _SAMPLED + 4, len(sample) - 1)
        order = np.flatnonzero(errors <= np.partition(sample, last)[last])
        order = order[np.argsort(errors[order])[: count + 1]]
        if len(order) <= count or (np.diff(errors[order]) == 0.0).any():  # equal ones as a partition leaves them
            order = np.argpartition(errors, count - 1)[:count]
            order = order[np.argsort(errors[order])]
        order = order[:count]
        of_heading, of_position = np.divmod(order, of.rows * of.columns)
        row, column = np.divmod(of_position, of.columns)
        place = (row + of.first_row) * self._grid.shape[1] + column + of.first_column
        return np.column_stack((self._grid.positions[place], of.headings[of_heading]))

    def errors(self, points: FloatArray, window: Window | None = None) -> Float32Array:
        """Mean error (H, K) of the points (N, 2), all alike, at every heading and position of a window."""
        of, table = window or self.whole, self._table
        n = table.values.shape[0]
        shifted = table._replace(first_x=table.first_x + n * of.first_row, first_y=table.first_y + n * of.first_column)
        likeness = _likeness(points, of.headings, shifted, of.rows, _filled_up(of.columns))
        sums = likeness[:, :, : of.columns].reshape(len(likeness), -1)
        return np.asarray(1.0 - sums / np.float32(len(points)))

    @property
    def whole(self) -> Window:
        """All of the grid."""
        return Window(0, self._grid.shape[0], 0, self._grid.shape[1], self._grid.headings)

    @property
    def half(self) -> Window:
        """The half at positive x: on a symmetric field a pose of the other half is one's twin."""
        first = self._grid.shape[0] // 2
        return self.whole._replace(first_row=first, rows=self._grid.shape[0] - first)


def _filled_up(columns: int) -> int:
    return -(-columns // _LANES) * _LANES


def _shift_table(distance_map: DistanceMap, grid: PoseGrid, c_m: float) -> ShiftTable:
    n = max(round(grid.spacing_m / _CELL_M), 1)
    cell_m = grid.spacing_m / n
    rows, columns = grid.shape
    size_y, size_x, _ = distance_map.values.shape
    resolution_m = distance_map.resolution_m
    sources, first = [], []
    for axis, (size, poses, filled) in enumerate(((size_x, rows, rows), (size_y, columns, _filled_up(columns)))):
        cells = math.floor((size - 1) * resolution_m / cell_m + 1e-9) + 1
        reach = n * (poses - 1)  # from the first pose to the last, and as far below the map as above it
        blocks = -(-(cells + reach) // n) + filled
        of_map = np.clip(np.arange(n * blocks) - reach, 0, cells - 1)
        sources.append(np.minimum(np.rint(of_map * (cell_m / resolution_m)).astype(np.intp), size - 1))
        first.append(float((grid.positions[0, axis] - distance_map.origin_m[axis]) / cell_m + reach))
    distances = distance_map.values[np.ix_(sources[1], sources[0], [0])][:, :, 0]
    likeness = (1.0 / (1.0 + (distances / c_m) ** 2)).astype(np.float32).T
    blocks_of = likeness.reshape(len(sources[0]) // n, n, len(sources[1]) // n, n)
    return ShiftTable(np.ascontiguousarray(blocks_of.transpose(1, 3, 0, 2)), first[0], first[1], cell_m)


@numba.njit(cache=True)
def _likeness(points, headings, table, rows, columns):  # type: ignore[no-untyped-def]
    """Sum of 1 - e (H, rows, columns) over the points at every heading (H,) and position; table: ShiftTable."""
    values, first_x, first_y, cell_m = table
    n = values.shape[0]
    last_x, last_y = float(n * (values.shape[2] - rows)), float(n * (values.shape[3] - columns))
    sums = np.zeros((headings.shape[0], rows, columns), dtype=np.float32)
    for h in range(headings.shape[0]):
        cosine, sine = math.cos(headings[h]) / cell_m, math.sin(headings[h]) / cell_m
        for i in range(points.shape[0]):
            x = first_x + cosine * points[i, 0] - sine * points[i, 1] + 0.5
            y = first_y + sine * points[i, 0] + cosine * points[i, 1] + 0.5
            cell_x = int(min(x, last_x) if x > 0.0 else 0.0)  # written so that NaN never becomes an index
            cell_y = int(min(y, last_y) if y > 0.0 else 0.0)
            block = values[cell_x % n, cell_y % n]
            low = cell_y // n
            for row in range(rows):
                seen = block[cell_x // n + row, low : low + columns]
                total = sums[h, row]
                for column in range(columns):
                    total[column] += seen[column]
    return sums


@numba.njit(cache=True)
def _far_apart(poses, near_m, near_rad, count):  # type: ignore[no-untyped-def]
    """Indices (up to count,) of poses (N, 3): in their order, those that are no neighbours of one before them."""
    picks = np.empty(count, dtype=np.int64)
    found = 0
    for i in range(poses.shape[0]):
        free = True
        for k in range(found):
            other = picks[k]
            turn = abs(poses[i, 2] - poses[other, 2]) % (2.0 * math.pi)
            if (
                abs(poses[i, 0] - poses[other, 0]) < near_m
                and abs(poses[i, 1] - poses[other, 1]) < near_m
                and min(turn, 2.0 * math.pi - turn) < near_rad
            ):
                free = False
                break
        if free:
            picks[found] = i
            found += 1
            if found == count:
                break
    return picks[:found]
