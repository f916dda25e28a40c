"""Field lines of an observation: from the graph's components to places on the ground, with their points."""

from __future__ import annotations

import numpy as np

from touchline.geometry import FloatArray
from touchline.perception.line_graph.colour_classes import CELL_PX
from touchline.perception.line_graph.image_plane import (
    ImagePlane,
    ground_covariances,
    grounds_from_pixels,
    pixel_from_plane,
    planes_from_pixels,
)
from touchline.perception.line_graph.lines import split_and_merge
from touchline.perception.line_graph.profiles import Pixels
from touchline.perception.line_graph.refine import POINT_COLUMNS, refine_line
from touchline.perception.line_graph.settings import LineGraphSettings
from touchline.perception.line_graph.structure import Structure
from touchline.types import LinePoints, Lines, no_lines

_MOST_POINTS = 2000


def find_lines(
    structure: Structure, pixels: Pixels, plane: ImagePlane, settings: LineGraphSettings
) -> tuple[Lines, LinePoints]:
    """The field lines, and points on them. Short and far ones are left out."""
    nodes = planes_from_pixels(plane, cell_pixels(structure.graph.places))
    focal = plane.lens.pinhole[0]
    candidates = split_and_merge(nodes, structure.chains, settings.split_px / focal)
    points, count = np.empty((_MOST_POINTS, POINT_COLUMNS)), 0
    kept: list[FloatArray] = []
    confidences: list[float] = []
    for line in candidates:
        confidence, total = refine_line(pixels, plane, line, len(kept), points, count)
        if confidence > 0.0 and _is_long(line, plane, settings):
            kept.append(line)
            confidences.append(confidence)
            count = total
    if not kept:
        return no_lines(), _points_on_lines(points[:0], plane, settings)
    ends = np.array(kept).reshape(-1, 2)
    uv = np.array([pixel_from_plane(plane.lens, x, y) for x, y in ends])
    covariances = ground_covariances(plane, uv, settings.noise_px, settings.noise_m).reshape(-1, 2, 2, 2)
    ground: FloatArray = grounds_from_pixels(plane, uv).reshape(-1, 2, 2)
    lines = Lines(ground, covariances, np.array(confidences), uv.reshape(-1, 2, 2))
    return lines, _points_on_lines(points[:count], plane, settings)


def cell_pixels(places: FloatArray) -> FloatArray:
    """Pixels (N, 2) of the middles of places (N, 2) in cells."""
    return CELL_PX * places + 0.5 * (CELL_PX - 1)


def _is_long(line: FloatArray, plane: ImagePlane, settings: LineGraphSettings) -> bool:
    uv = np.array([pixel_from_plane(plane.lens, x, y) for x, y in line.reshape(2, 2)])
    ground = grounds_from_pixels(plane, uv)
    length_m, length_px = np.hypot(*(ground[1] - ground[0])), np.hypot(*(uv[1] - uv[0]))
    nearest_m = np.hypot(*ground.T).min()
    return bool(
        length_m >= settings.min_line_m and length_px >= settings.min_line_px and nearest_m <= settings.farthest_m
    )


def _points_on_lines(points: FloatArray, plane: ImagePlane, settings: LineGraphSettings) -> LinePoints:
    uv = np.ascontiguousarray(points[:, :2])
    ground = grounds_from_pixels(plane, uv)
    covariances = ground_covariances(plane, uv, settings.noise_px, settings.noise_m)
    return LinePoints(ground, covariances, np.clip(points[:, 3], 0.0, 1.0), uv)
