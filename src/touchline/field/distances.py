"""Exact distances to the centre lines of a field: segments, circles and arcs.

`LineTables` hold the lines in the form that the loops want, computed once per field."""

import math
from typing import NamedTuple

import numba
import numpy as np

from touchline.geometry import FloatArray

_WHOLE_CIRCLE = -2.0
_ON_THE_LINE_M = 1e-9
_ROUNDED_RAD = 1e-5  # angles in files are rounded


class LineTables(NamedTuple):
    """The centre lines of a field, m, field frame.

    segments (S, 5): x, y, dx, dy of a segment from its first end, and 1 / (dx² + dy²).
    arcs (R, 10): cx, cy, radius, direction (ux, uy) of the middle of an arc, cosine of half its sweep,
    first end x, y, last end x, y. A whole circle has the "cosine" -2, so that every direction is on it.
    """

    segments: FloatArray
    arcs: FloatArray


def segment_table(segments: FloatArray) -> FloatArray:
    """Segments (S, 4) of x1, y1, x2, y2 (m) as rows (S, 5) of `LineTables.segments`."""
    start, step = segments[:, :2], segments[:, 2:] - segments[:, :2]
    return np.ascontiguousarray(np.column_stack((start, step, 1.0 / np.sum(step**2, axis=1))))


def arc_table(circles: FloatArray, arcs: FloatArray) -> FloatArray:
    """Circles (C, 3) of cx, cy, radius and arcs (A, 5) of cx, cy, radius, start, end (m, rad) as rows (C + A, 10)."""
    rows = np.zeros((len(circles) + len(arcs), 10))
    rows[: len(circles), :3] = circles
    rows[: len(circles), 5] = _WHOLE_CIRCLE
    for row, (cx, cy, radius, start, end) in zip(rows[len(circles) :], arcs, strict=True):
        sweep = arc_sweep(start, end)
        middle = start + 0.5 * sweep
        row[:6] = cx, cy, radius, math.cos(middle), math.sin(middle), math.cos(0.5 * sweep)
        row[6:8] = cx + radius * math.cos(start), cy + radius * math.sin(start)
        row[8:10] = cx + radius * math.cos(end), cy + radius * math.sin(end)
    return rows


def arc_sweep(start_rad: float, end_rad: float) -> float:
    """The angle in (0, 2 pi] from start counter-clockwise to end; next to nothing (0 to 6.283186) is a whole turn."""
    sweep = (end_rad - start_rad) % (2.0 * math.pi)
    return sweep if sweep > _ROUNDED_RAD else 2.0 * math.pi


@numba.njit(cache=True)
def nearest_line_point(lines, x, y):  # type: ignore[no-untyped-def]
    """Distance (m) to the nearest line centre and that point of the line: (distance, line_x, line_y).

    lines: LineTables. x, y: m, field frame. lines the distance is infinite. At the centre of a circle, where no
    point of it is nearest, the point returned is the centre itself.
    """
    segments, arcs = lines
    best = np.inf
    best_x, best_y = x, y
    for i in range(segments.shape[0]):
        px, py = x - segments[i, 0], y - segments[i, 1]
        along = (px * segments[i, 2] + py * segments[i, 3]) * segments[i, 4]
        along = min(max(along, 0.0), 1.0)
        px -= along * segments[i, 2]
        py -= along * segments[i, 3]
        squared = px * px + py * py
        if squared < best:
            best = squared
            best_x, best_y = x - px, y - py
    for i in range(arcs.shape[0]):
        px, py = x - arcs[i, 0], y - arcs[i, 1]
        radius = arcs[i, 2]
        squared_reach = px * px + py * py
        reach = math.sqrt(squared_reach)
        if px * arcs[i, 3] + py * arcs[i, 4] >= reach * arcs[i, 5]:
            squared = (reach - radius) * (reach - radius)
            if squared < best:
                best = squared
                scale = radius / reach if reach > 0.0 else 0.0
                best_x, best_y = arcs[i, 0] + scale * px, arcs[i, 1] + scale * py
        else:
            for end in (6, 8):
                px, py = x - arcs[i, end], y - arcs[i, end + 1]
                squared = px * px + py * py
                if squared < best:
                    best = squared
                    best_x, best_y = arcs[i, end], arcs[i, end + 1]
    return math.sqrt(best), best_x, best_y


@numba.njit(cache=True)
def distances_to_lines(lines, points):  # type: ignore[no-untyped-def]
    """Distances (N,) in m of points (N, 2) in m, field frame, to the nearest line centre; NaN for a NaN point."""
    distances = np.empty(points.shape[0])
    for i in range(points.shape[0]):
        if math.isnan(points[i, 0]) or math.isnan(points[i, 1]):
            distances[i] = np.nan
        else:
            distances[i] = nearest_line_point(lines, points[i, 0], points[i, 1])[0]
    return distances


@numba.njit(cache=True)
def nearest_line_points(lines, points):  # type: ignore[no-untyped-def]
    """The points (N, 2) of the lines that are nearest to points (N, 2), in m, field frame."""
    nearest = np.empty((points.shape[0], 2))
    for i in range(points.shape[0]):
        _, nearest[i, 0], nearest[i, 1] = nearest_line_point(lines, points[i, 0], points[i, 1])
    return nearest


@numba.njit(cache=True)
def sample_distances(lines, origin_x, origin_y, resolution_m, values):  # type: ignore[no-untyped-def]
    """Fill values (ny, nx, 3), float32, with distance (m) and gradient at the samples of a grid.

    Sample [iy, ix] lies at origin + resolution * (ix, iy), m, field frame. The gradient is the unit vector away
    from the nearest line point; on the line itself and at the centre of a circle it is zero.
    """
    for iy in range(values.shape[0]):
        y = origin_y + resolution_m * iy
        for ix in range(values.shape[1]):
            x = origin_x + resolution_m * ix
            distance, line_x, line_y = nearest_line_point(lines, x, y)
            away_x, away_y = x - line_x, y - line_y
            length = math.sqrt(away_x * away_x + away_y * away_y)
            scale = 1.0 / length if length > _ON_THE_LINE_M else 0.0
            values[iy, ix, 0] = distance
            values[iy, ix, 1] = scale * away_x
            values[iy, ix, 2] = scale * away_y
