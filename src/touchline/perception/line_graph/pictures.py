"""Pictures of the steps, as in figures 1 and 2: classes, boundary, skeleton, nodes with connections, features."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from touchline.geometry import FloatArray
from touchline.perception.line_graph.colour_classes import BLUE, CELL_PX, FULL, GREEN, WHITE, YELLOW
from touchline.perception.line_graph.field_boundary import boundary_pixels
from touchline.perception.line_graph.field_lines import cell_pixels
from touchline.perception.line_graph.graph import Graph
from touchline.perception.line_graph.key_nodes import key_nodes
from touchline.perception.line_graph.skeleton import NO_SKELETON
from touchline.perception.line_graph.structure import Structure
from touchline.perception.stages import BOUNDARY_PAINT, POINT_PAINT, RAY_PAINT, draw_paths, enlarged
from touchline.types import ImageArray, Observation

_SHADES = ((WHITE, (245, 245, 245)), (GREEN, (70, 140, 50)), (BLUE, (200, 80, 20)), (YELLOW, (30, 200, 230)))
_NODE_PAINTS = ((160, 160, 160), (255, 0, 255), (255, 80, 0), (0, 200, 255), (0, 0, 255))  # by degree
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def step_pictures(image: ImageArray, structure: Structure, seen: Observation) -> dict[str, ImageArray]:
    """Title -> picture of each step for an image (H, W, 3)."""
    return {
        "colour classes": _in_cells(_classes(structure), image),
        "field boundary": _with_boundary(image, structure),
        "skeleton": _in_cells(_skeleton(structure), image),
        "nodes and connections": _with_graph(image, structure.graph),
        "key nodes": _with_graph(image, key_nodes(structure.graph)[0]),
        "lines and crossings": _with_features(image, structure, seen),
    }


def _classes(structure: Structure) -> FloatArray:
    shares = structure.counts / FULL
    picture = np.zeros((*shares.shape[1:], 3))
    for kind, paint in _SHADES:
        picture += shares[kind][..., np.newaxis] * np.array(paint)
    return picture


def _skeleton(structure: Structure) -> FloatArray:
    picture = np.repeat(np.clip(structure.smooth, 0.0, FULL)[..., np.newaxis] * 2.0, 3, axis=2)
    picture[structure.ranks != NO_SKELETON] = (80, 80, 255)
    return picture


def _in_cells(cells: FloatArray, image: ImageArray) -> ImageArray:
    """Cells (rows, columns, 3) as large as an enlarged image."""
    large = enlarged(np.zeros_like(image))
    size = 2 * CELL_PX
    blown = np.kron(np.clip(cells, 0, 255).astype(np.uint8), np.ones((size, size, 1), dtype=np.uint8))
    large[: blown.shape[0], : blown.shape[1]] = blown
    return large


def _with_boundary(image: ImageArray, structure: Structure) -> ImageArray:
    picture = enlarged(image)
    path = boundary_pixels(structure.ends, structure.smooth.shape[0])
    draw_paths(picture, [path], BOUNDARY_PAINT, closed=False, width=2)
    return picture


def _with_graph(image: ImageArray, graph: Graph) -> ImageArray:
    picture = enlarged((image // 2).astype(np.uint8))
    places = cell_pixels(graph.places)
    for node, degree in enumerate(graph.degrees):
        ways = [np.stack((places[node], places[other])) for other in graph.links[node, :degree]]
        draw_paths(picture, ways, RAY_PAINT, closed=False)
    for node, degree in enumerate(graph.degrees):
        if degree > 0:
            cv2.circle(picture, _large(places[node]), 3, _NODE_PAINTS[min(int(degree), 4)], -1, cv2.LINE_AA)
    return picture


def _with_features(image: ImageArray, structure: Structure, seen: Observation) -> ImageArray:
    picture = _with_boundary(image, structure)
    draw_paths(picture, list(seen.lines.pixels), POINT_PAINT, closed=False, width=2)
    for kind, pixel in zip(seen.crossings.kinds, seen.crossings.pixels, strict=True):
        _name(picture, pixel, str(kind))
    for kind, pixel in zip(seen.landmarks.kinds, seen.landmarks.pixels, strict=True):
        if np.isfinite(pixel).all():
            _name(picture, pixel, str(kind))
    return picture


def _name(picture: ImageArray, pixel: npt.NDArray[np.floating], text: str) -> None:
    u, v = _large(pixel)
    cv2.circle(picture, (u, v), 9, (0, 0, 0), 2, cv2.LINE_AA)
    for paint, width in (((0, 0, 0), 5), ((0, 255, 255), 2)):
        cv2.putText(picture, text, (u + 8, v - 8), _FONT, 0.9, paint, width, cv2.LINE_AA)


def _large(pixel: npt.NDArray[np.floating]) -> tuple[int, int]:
    return round(2.0 * float(pixel[0]) + 0.5), round(2.0 * float(pixel[1]) + 0.5)
