"""Pictures of the steps, as in figures 1 and 2: classes, boundary, low-pass, skeleton, nodes, graph, key nodes."""

import cv2
import numpy as np

from touchline.camera import GroundView
from touchline.geometry import FloatArray
from touchline.perception.feature_pictures import Canvas, draw_features
from touchline.perception.line_graph.colour_classes import (
    BLACK,
    BLUE,
    CELL_PX,
    CYAN,
    FULL,
    GREEN,
    MAGENTA,
    ORANGE,
    WHITE,
    YELLOW,
)
from touchline.perception.line_graph.field_boundary import boundary_pixels
from touchline.perception.line_graph.field_lines import cell_pixels
from touchline.perception.line_graph.graph import Graph
from touchline.perception.line_graph.key_nodes import key_nodes
from touchline.perception.line_graph.skeleton import NO_SKELETON
from touchline.perception.line_graph.structure import Structure
from touchline.perception.stages import BOUNDARY_PAINT, Paint, draw_paths, enlarged, with_legend
from touchline.types import ImageArray, Observation

SHADES: dict[int, tuple[str, Paint]] = {
    WHITE: ("white", (245, 245, 245)),
    GREEN: ("green", (70, 140, 50)),
    BLACK: ("black", (0, 0, 0)),
    BLUE: ("blue", (220, 90, 20)),
    YELLOW: ("yellow", (30, 200, 230)),
    ORANGE: ("orange", (20, 120, 240)),
    MAGENTA: ("magenta", (190, 40, 200)),
    CYAN: ("cyan", (210, 200, 40)),
}
UNCLASSIFIED: Paint = (85, 85, 85)
_LINK_PAINT: Paint = (255, 255, 0)
_NODES: dict[int, tuple[str, Paint]] = {  # by degree
    1: ("ends", (255, 0, 255)),
    2: ("on a line", (255, 110, 0)),
    3: ("three lines meet", (0, 170, 255)),
    4: ("four lines meet", (0, 0, 255)),
}
_KEYS: dict[int, tuple[str, Paint]] = {
    1: ("ends", (255, 0, 255)),
    2: ("bent: L?", (0, 255, 255)),
    3: ("three lines: T?", (0, 170, 255)),
    4: ("four lines: X?", (0, 0, 255)),
}
_MAX_DEGREE = 4


def step_pictures(
    image: ImageArray, structure: Structure, seen: Observation, view: GroundView, circle_m: float = 0.0
) -> dict[str, ImageArray]:
    """Title -> picture of each step for an image (H, W, 3). circle_m: radius of the field's centre circle."""
    graph = structure.graph
    cleaned, corners = key_nodes(graph)
    return {
        "colour classes": with_legend(_in_cells(_classes(structure), image), _classes_shown(structure)),
        "field boundary": _with_boundary(image, structure),
        "low-pass inside the boundary": _in_cells(_smooth(structure), image),
        "skeleton": _in_cells(_skeleton(structure), image),
        "nodes": with_legend(_with_nodes(_dark(image), graph), list(_NODES.values())),
        "line structure graph": with_legend(
            _with_nodes(_with_links(_dark(image), graph), graph), list(_NODES.values())
        ),
        "key nodes": with_legend(_with_keys(image, cleaned, corners), list(_KEYS.values())),
        "lines and crossings": _with_features(image, structure, seen, view, circle_m),
    }


def _classes(structure: Structure) -> FloatArray:
    shares = structure.counts / FULL
    rest = 1.0 - np.minimum(shares.sum(axis=0), 1.0)
    picture: FloatArray = rest[..., np.newaxis] * np.array(UNCLASSIFIED, dtype=np.float64)
    for kind, (_, paint) in SHADES.items():
        picture += shares[kind][..., np.newaxis] * np.array(paint)
    return picture


def _classes_shown(structure: Structure) -> list[tuple[str, Paint]]:
    shown = [entry for kind, entry in SHADES.items() if (structure.counts[kind] > FULL // 4).any()]
    return [*shown, ("no class", UNCLASSIFIED)]


def _smooth(structure: Structure) -> FloatArray:
    """White after the low-pass, its square root: lines far away are pale."""
    brightest = max(float(structure.smooth.max()), 1.0)
    grey: FloatArray = 255.0 * np.sqrt(np.maximum(structure.smooth, 0.0) / brightest)
    return np.repeat(grey[..., np.newaxis], 3, axis=2)


def _skeleton(structure: Structure) -> FloatArray:
    picture = 0.5 * _smooth(structure)
    picture[structure.ranks != NO_SKELETON] = (80, 80, 255)
    return picture


def _in_cells(cells: FloatArray, image: ImageArray) -> ImageArray:
    """Cells (rows, columns, 3) as large as an enlarged image."""
    large = enlarged(np.zeros_like(image))
    size = 2 * CELL_PX
    blown = np.kron(np.clip(cells, 0, 255).astype(np.uint8), np.ones((size, size, 1), dtype=np.uint8))
    large[: blown.shape[0], : blown.shape[1]] = blown
    return large


def _dark(image: ImageArray) -> ImageArray:
    return enlarged((image // 3).astype(np.uint8))


def _with_boundary(image: ImageArray, structure: Structure) -> ImageArray:
    picture = enlarged(image)
    path = boundary_pixels(structure.ends, structure.smooth.shape[0])
    draw_paths(picture, [path], (20, 20, 20), closed=False, width=7)
    draw_paths(picture, [path], BOUNDARY_PAINT, closed=False, width=4)
    return picture


def _with_links(picture: ImageArray, graph: Graph) -> ImageArray:
    places = cell_pixels(graph.places)
    for node, degree in enumerate(graph.degrees):
        ways = [np.stack((places[node], places[other])) for other in graph.links[node, :degree]]
        draw_paths(picture, ways, _LINK_PAINT, closed=False, width=2)
    return picture


def _with_nodes(picture: ImageArray, graph: Graph) -> ImageArray:
    for place, degree in zip(cell_pixels(graph.places), graph.degrees, strict=True):
        if degree > 0:
            cv2.circle(picture, _large(place), 6, _NODES[min(int(degree), _MAX_DEGREE)][1], -1, cv2.LINE_AA)
    return picture


def _with_keys(image: ImageArray, graph: Graph, corners: FloatArray) -> ImageArray:
    """The cleaned graph with ends of lines and candidates for crossings (C, 3): column, row, degree."""
    picture = _with_links(_dark(image), graph)
    for place in cell_pixels(graph.places[graph.degrees == 1]):
        cv2.circle(picture, _large(place), 7, _KEYS[1][1], -1, cv2.LINE_AA)
    for place, degree in zip(cell_pixels(corners[:, :2]), corners[:, 2], strict=True):
        cv2.circle(picture, _large(place), 12, (20, 20, 20), -1, cv2.LINE_AA)
        cv2.circle(picture, _large(place), 10, _KEYS[min(int(degree), _MAX_DEGREE)][1], -1, cv2.LINE_AA)
    return picture


def _with_features(
    image: ImageArray, structure: Structure, seen: Observation, view: GroundView, circle_m: float
) -> ImageArray:
    picture = _with_boundary(image, structure)
    legend = draw_features(Canvas(picture, view, 2), seen, circle_m)
    return with_legend(picture, [*legend, ("field boundary", BOUNDARY_PAINT)])


def _large(pixel: FloatArray) -> tuple[int, int]:
    return round(2.0 * float(pixel[0]) + 0.5), round(2.0 * float(pixel[1]) + 0.5)
