"""The paint on the ground, evaluated exactly: lines, arcs, filled marks, painted rectangles.

Each 0.25 m cell of the ground lists the shapes near it; a point is tested against its cell's shapes alone.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.field import FieldModel
from touchline.geometry import BoolArray, FloatArray, Int32Array
from touchline_lab.simulation.world.world import GroundMark

CELL_M = 0.25
_SEGMENT, _ARC, _DISC = 0.0, 1.0, 2.0


class PaintGrid(NamedTuple):
    """Shapes on the ground for the loops.

    shapes (P, 8) float64: kind, then for a segment its middle, direction cosine and sine, half length, half width; for
    an arc (or circle) its centre, radius, half width, middle angle and half sweep; for a disc centre and radius; last
    the paint's index. starts (cells + 1,), items: shapes near each cell, row by row. frame: x, y of the first cell,
    columns, rows.
    """

    shapes: FloatArray
    starts: Int32Array
    items: npt.NDArray[np.int16]
    frame: FloatArray


def build_paint(field: FieldModel, marks: Sequence[GroundMark], hall: tuple[float, float, float]) -> PaintGrid:
    """The shapes of a field (paint 0) and of marks (paint 1, 2, ... in their order) in a grid as large as the hall."""
    half = 0.5 * field.line_width
    rows: list[list[float]] = []
    for x1, y1, x2, y2 in field.segments:
        dx, dy = x2 - x1, y2 - y1
        size = float(np.hypot(dx, dy))
        rows.append([_SEGMENT, 0.5 * (x1 + x2), 0.5 * (y1 + y2), dx / size, dy / size, 0.5 * size + half, half, 0.0])
    rows += [[_ARC, cx, cy, r, half, 0.0, np.pi, 0.0] for cx, cy, r in field.circles]
    for cx, cy, r, start, end in field.arcs:
        sweep = (end - start) % (2.0 * np.pi) or 2.0 * np.pi
        rows.append([_ARC, cx, cy, r, half, start + 0.5 * sweep, 0.5 * sweep + half / r, 0.0])
    rows += [[_DISC, cx, cy, 0.5 * diameter, 0.0, 0.0, 0.0, 0.0] for cx, cy, diameter in field.discs]
    for number, mark in enumerate(marks, start=1):
        c, s = np.cos(mark.heading), np.sin(mark.heading)
        half_size = 0.5 * mark.length, 0.5 * mark.width
        rows.append([_SEGMENT, mark.x, mark.y, float(c), float(s), *half_size, float(number)])
    shapes = np.array(rows, dtype=np.float64).reshape(-1, 8)
    columns, lines = (int(np.ceil(size / CELL_M)) + 2 for size in hall[:2])
    frame = np.array([-0.5 * columns * CELL_M, -0.5 * lines * CELL_M, columns, lines])
    near = _near_cells(shapes, frame, (lines, columns)).reshape(len(shapes), -1).T
    starts = np.concatenate(([0], np.cumsum(near.sum(axis=1)))).astype(np.int32)
    return PaintGrid(shapes, starts, np.nonzero(near)[1].astype(np.int16), frame)


@njit(cache=True, error_model="numpy")
def painted_cells(grid: PaintGrid, shape: tuple[int, int], per_m: int) -> BoolArray:
    """(ny, nx) which of the cells from the grid's first corner on, 1 / per_m wide, may hold paint."""
    painted, reach, each = np.zeros(shape, dtype=np.bool_), np.sqrt(0.5) / per_m, int(per_m * CELL_M)
    for j in range(shape[0]):
        for i in range(shape[1]):
            x, y = grid.frame[0] + (i + 0.5) / per_m, grid.frame[1] + (j + 0.5) / per_m
            cell = j // each * int(grid.frame[2]) + i // each
            for entry in range(grid.starts[cell], grid.starts[cell + 1]):
                painted[j, i] |= shape_depth(grid.shapes, grid.items[entry], x, y) > -reach
    return painted


@njit(cache=True, error_model="numpy")
def _near_cells(shapes: FloatArray, frame: FloatArray, shape: tuple[int, int]) -> BoolArray:
    """(P, ny, nx) which shapes come as near as its corners to the middle of each cell."""
    near, reach = np.zeros((len(shapes), *shape), dtype=np.bool_), np.sqrt(0.5) * CELL_M
    for k in range(len(shapes)):
        for j in range(shape[0]):
            for i in range(shape[1]):
                x, y = frame[0] + (i + 0.5) * CELL_M, frame[1] + (j + 0.5) * CELL_M
                near[k, j, i] = shape_depth(shapes, k, x, y) > -reach
    return near


@njit(cache=True, error_model="numpy")
def shape_depth(shapes: FloatArray, k: int, x: float, y: float) -> float:
    """How deep (m) a point lies in shape k; negative outside: there -depth is no more than the distance to it."""
    ex, ey = x - shapes[k, 1], y - shapes[k, 2]
    if shapes[k, 0] == _SEGMENT:
        along = abs(ex * shapes[k, 3] + ey * shapes[k, 4])
        across = abs(ey * shapes[k, 3] - ex * shapes[k, 4])
        return float(min(shapes[k, 5] - along, shapes[k, 6] - across))
    depth = shapes[k, 3] - np.sqrt(ex * ex + ey * ey)
    if shapes[k, 0] == _ARC:
        depth = shapes[k, 4] - abs(depth)
        if shapes[k, 6] < np.pi and depth > -CELL_M:
            turn = np.arctan2(ey, ex) - shapes[k, 5]
            turn = abs(turn - 2.0 * np.pi * np.round(turn / (2.0 * np.pi)))
            depth = min(depth, (shapes[k, 6] - turn) * shapes[k, 3])
    return float(depth)


@njit(cache=True, error_model="numpy")
def paint_at(grid: PaintGrid, x: float, y: float) -> int:
    """The paint's index at a ground point (m, field frame), -1 for none. The last shape that covers it counts."""
    column, row = int((x - grid.frame[0]) / CELL_M), int((y - grid.frame[1]) / CELL_M)
    if not (0 <= column < grid.frame[2] and 0 <= row < grid.frame[3]):
        return -1
    cell, paint = row * int(grid.frame[2]) + column, -1
    for entry in range(grid.starts[cell], grid.starts[cell + 1]):
        k = grid.items[entry]
        if shape_depth(grid.shapes, k, x, y) >= 0.0:
            paint = int(grid.shapes[k, 7])
    return paint
