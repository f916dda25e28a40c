"""The paint on the ground, evaluated exactly: lines, arcs, filled marks, painted rectangles.

Each 0.25 m cell of the ground lists the shapes within 0.3 m of it; a point is tested against its cell's shapes alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.field import FieldModel
from touchline.geometry import FloatArray
from touchline.simulation.world.world import GroundMark

CELL_M = 0.25
MARGIN_M, MIDDLE_MARGIN_M, TIGHT_MARGIN_M = 0.3, 0.1, 0.03
Shape = tuple[float, float, float, float, float, float, float]
_BAR, _RING, _DISC = 0.0, 1.0, 2.0


class PaintGrid(NamedTuple):
    """Shapes on the ground for the loops.

    shapes (P, 8) float64: kind, then for a bar its middle, direction cosine and sine, half length, half width; for a
    ring (circle or arc) its centre, radius, half width, middle angle and half sweep; for a disc centre and radius;
    last the paint's index. starts (cells + 1,), items: shapes within 0.3 m of each cell, row by row. frame: x, y of
    the first cell, columns, rows.
    """

    shapes: npt.NDArray[np.float64]
    starts: npt.NDArray[np.int32]
    items: npt.NDArray[np.int16]
    frame: npt.NDArray[np.float64]


def build_paint(field: FieldModel, marks: Sequence[GroundMark], hall: tuple[float, float, float]) -> PaintGrid:
    """The shapes of a field (paint 0) and of marks (paint 1, 2, ... in their order) in a grid as large as the hall."""
    half = 0.5 * field.line_width
    rows: list[list[float]] = []
    for x1, y1, x2, y2 in field.segments:
        dx, dy = x2 - x1, y2 - y1
        size = float(np.hypot(dx, dy))
        rows.append([_BAR, 0.5 * (x1 + x2), 0.5 * (y1 + y2), dx / size, dy / size, 0.5 * size + half, half, 0.0])
    rows += [[_RING, cx, cy, r, half, 0.0, np.pi, 0.0] for cx, cy, r in field.circles]
    for cx, cy, r, start, end in field.arcs:
        sweep = (end - start) % (2.0 * np.pi) or 2.0 * np.pi
        rows.append([_RING, cx, cy, r, half, start + 0.5 * sweep, 0.5 * sweep + half / r, 0.0])
    rows += [[_DISC, cx, cy, 0.5 * diameter, 0.0, 0.0, 0.0, 0.0] for cx, cy, diameter in field.discs]
    for number, mark in enumerate(marks, start=1):
        c, s = np.cos(mark.heading), np.sin(mark.heading)
        rows.append([_BAR, mark.x, mark.y, float(c), float(s), 0.5 * mark.length, 0.5 * mark.width, float(number)])
    shapes = np.array(rows, dtype=np.float64).reshape(-1, 8)
    columns, lines = (int(np.ceil(size / CELL_M)) + 2 for size in hall[:2])
    frame = np.array([-0.5 * columns * CELL_M, -0.5 * lines * CELL_M, columns, lines])
    x = frame[0] + (np.arange(columns) + 0.5) * CELL_M
    y = frame[1] + (np.arange(lines) + 0.5) * CELL_M
    centres = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    near = _near_shapes(shapes, centres, MARGIN_M + CELL_M * np.sqrt(0.5))
    starts = np.concatenate(([0], np.cumsum(near.sum(axis=1)))).astype(np.int32)
    return PaintGrid(shapes, starts, np.nonzero(near)[1].astype(np.int16), frame)


@njit(cache=True, error_model="numpy")
def mark_paint(grid: PaintGrid, per_m: float, flags: npt.NDArray[np.uint8], bits: tuple[int, int, int]) -> None:
    """Set bits in the flags (ny, nx) of cells with paint within 0.03 m, 0.1 m and 0.3 m of them."""
    half = np.sqrt(0.5) / per_m
    for j in range(flags.shape[0]):
        for i in range(flags.shape[1]):
            x, y = grid.frame[0] + (i + 0.5) / per_m, grid.frame[1] + (j + 0.5) / per_m
            cell = int(j / per_m * 4.0) * int(grid.frame[2]) + int(i / per_m * 4.0)
            for entry in range(grid.starts[cell], grid.starts[cell + 1]):
                depth = shape_depth(shape_row(grid.shapes, grid.items[entry]), x, y, 1.0) + half
                flags[j, i] |= bits[2]
                if depth > -MIDDLE_MARGIN_M:
                    flags[j, i] |= bits[1]
                if depth > -TIGHT_MARGIN_M:
                    flags[j, i] |= bits[0]


@njit(cache=True, error_model="numpy")
def _near_shapes(shapes: FloatArray, points: FloatArray, reach: float) -> npt.NDArray[np.bool_]:
    near = np.zeros((len(points), len(shapes)), dtype=np.bool_)
    for i in range(len(points)):
        for k in range(len(shapes)):
            near[i, k] = shape_depth(shape_row(shapes, k), points[i, 0], points[i, 1], reach) > -reach
    return near


@njit(cache=True, error_model="numpy", inline="always")
def shape_row(shapes: FloatArray, k: int | np.uint32) -> Shape:
    """Shape k as numbers: arrays handed to a function for each point would have their references counted."""
    return (
        shapes[k, 0], shapes[k, 1], shapes[k, 2], shapes[k, 3], shapes[k, 4], shapes[k, 5], shapes[k, 6]
    )  # fmt: skip


@njit(cache=True, error_model="numpy", inline="always")
def shape_depth(shape: Shape, x: float, y: float, reach: float) -> float:
    """How deep (m) a point lies in a shape; negative outside: there -depth is no more than the distance to it.

    The ends of arcs count only where the depth is more than -reach otherwise.
    """
    ex, ey = x - shape[1], y - shape[2]
    if shape[0] == 0.0:
        along = abs(ex * shape[3] + ey * shape[4])
        across = abs(ey * shape[3] - ex * shape[4])
        depth = min(shape[5] - along, shape[6] - across)
    else:
        distance = np.sqrt(ex * ex + ey * ey)
        depth = shape[3] - distance
        if shape[0] == 1.0:
            depth = shape[4] - abs(depth)
            if shape[6] < np.pi and depth > -reach:
                turn = np.arctan2(ey, ex) - shape[5]
                turn = abs(turn - 2.0 * np.pi * np.round(turn / (2.0 * np.pi)))
                depth = min(depth, (shape[6] - turn) * shape[3])
    return float(depth)


@njit(cache=True, error_model="numpy", inline="always")
def paint_at(
    shapes: FloatArray,
    starts: npt.NDArray[np.int32],
    items: npt.NDArray[np.int16],
    frame: FloatArray,
    x: float,
    y: float,
    px: float = 0.0,
    py: float = 0.0,
    qx: float = 0.0,
    qy: float = 0.0,
) -> tuple[int, bool]:
    """The paint's index at a ground point (m, field frame), -1 for none, and whether an edge of paint is near.

    Near: within the parallelogram with corners at (+-px +-qx, +-py +-qy) (m). The last shape that covers the point
    counts. Only shapes of this cell are looked at.
    """
    column, row = int((x - frame[0]) * 4.0), int((y - frame[1]) * 4.0)
    paint, edge = -1, False
    if 0 <= column < frame[2] and 0 <= row < frame[3]:
        cell = row * int(frame[2]) + column
        reach = 1.2 * (abs(px) + abs(py) + abs(qx) + abs(qy))
        for entry in range(starts[cell], starts[cell + 1]):
            k = np.uint32(items[entry])
            shape = shape_row(shapes, k)
            depth = shape_depth(shape, x, y, reach)
            if depth >= 0.0:
                paint = int(shapes[k, 7])
            if abs(depth) < reach and not edge:
                edge = _near_edge(shape, x, y, px, py, qx, qy)
    return paint, edge


@njit(cache=True, error_model="numpy", inline="always")
def _near_edge(shape: Shape, x: float, y: float, px: float, py: float, qx: float, qy: float) -> bool:
    """Whether an edge of a shape passes through the parallelogram around a point; see `paint_at`."""
    ex, ey = x - shape[1], y - shape[2]
    if shape[0] == 0.0:
        c, s = shape[3], shape[4]
        over = abs(px * c + py * s) + abs(qx * c + qy * s)
        up = abs(px * s - py * c) + abs(qx * s - qy * c)
        along, across = abs(ex * c + ey * s) - shape[5], abs(ey * c - ex * s) - shape[6]
        return bool(along < over and across < up and (along > -over or across > -up))
    square = (abs(px) + abs(qx)) ** 2 + (abs(py) + abs(qy)) ** 2
    distance, reach = np.sqrt(ex * ex + ey * ey), np.sqrt(square)
    radial = (abs(ex * px + ey * py) + abs(ex * qx + ey * qy) + square) / max(distance, reach)
    if shape[0] == 2.0:
        return bool(abs(distance - shape[3]) < radial)
    off = abs(distance - shape[3]) - shape[4]
    if abs(off) < radial:
        return True
    if shape[6] >= np.pi or off > radial:
        return False
    turn = np.arctan2(ey, ex) - shape[5]
    turn = abs(turn - 2.0 * np.pi * np.round(turn / (2.0 * np.pi)))
    return bool(abs(shape[6] - turn) * shape[3] < 1.2 * reach)
