"""Crossings verified in the colour cells, as the paper does (section 4.1): a circle about each key node, white ways.

A state machine confirms the changes from green to white and back along the circle: one white run for each connection.
"""

import math

import numpy as np

from touchline.geometry import FloatArray
from touchline.perception.line_graph.arms import judge_arms
from touchline.perception.line_graph.colour_classes import FULL, GREEN, WHITE, CountArray
from touchline.perception.line_graph.field_lines import cell_pixels
from touchline.perception.line_graph.graph import Graph, whiteness_between
from touchline.perception.line_graph.image_plane import ImagePlane, grounds_from_pixels
from touchline.perception.line_graph.key_nodes import key_nodes
from touchline.perception.line_graph.structure import Structure

_RADIUS, _SAMPLES = 4.0, 40  # of the circle, in cells
_WHITE, _GREEN = 0.2 * FULL, 0.5 * FULL  # pixels of a cell from which on it is
_MIN_KNOWN = 0.5  # share of the samples that is either
_WAY_NODES = 3  # that a way is followed for
_PALEST = 0.25  # least whiteness along a way, as a share of the node's
# arms go straight on or stand at right angles to within this, by their number: a T's node may lie beside its bar
_STRAIGHT_RAD = {2: math.radians(45.0), 3: math.radians(60.0), 4: math.radians(45.0)}
_CONFIDENCE = 0.8


def crossings_in_cells(structure: Structure, plane: ImagePlane, max_range_m: float) -> FloatArray:
    """The verified key nodes (K, 5): number of arms, x, y (m, robot frame), orientation (rad), confidence."""
    graph, corners = key_nodes(structure.graph)
    ground = grounds_from_pixels(plane, cell_pixels(corners[:, :2]))
    found: list[tuple[float, ...]] = []
    for (column, row, degree, node), place in zip(corners, ground, strict=True):
        if degree not in _STRAIGHT_RAD or not math.hypot(*place) <= max_range_m:
            continue
        angles = white_runs(structure.counts, column, row)
        if len(angles) != degree or not _ways_are_white(graph, int(node), structure.smooth):
            continue
        about = (column, row) + _RADIUS * np.column_stack((np.cos(angles), np.sin(angles)))
        aside = grounds_from_pixels(plane, cell_pixels(about)) - place
        arms, orientation = judge_arms(np.arctan2(aside[:, 1], aside[:, 0]), _STRAIGHT_RAD[int(degree)])
        if arms == degree:
            found.append((arms, *place, orientation, _CONFIDENCE))
    return np.array(found, dtype=np.float64).reshape(-1, 5)


def white_runs(counts: CountArray, column: float, row: float) -> FloatArray:
    """Angles (K,) in the image of the white runs on the circle about a place in cells, x to the right and y down.

    None where the circle leaves the image or shows much that is neither white nor green.
    """
    angles = 2.0 * np.pi * np.arange(_SAMPLES) / _SAMPLES
    columns = np.floor(column + _RADIUS * np.cos(angles) + 0.5).astype(int)
    rows = np.floor(row + _RADIUS * np.sin(angles) + 0.5).astype(int)
    if min(columns.min(), rows.min()) < 0 or columns.max() >= counts.shape[2] or rows.max() >= counts.shape[1]:
        return np.empty(0)
    white = counts[WHITE, rows, columns] >= _WHITE
    known = white | (counts[GREEN, rows, columns] >= _GREEN)
    if known.mean() < _MIN_KNOWN or white[known].all() or not white[known].any():
        return np.empty(0)
    state, angles = white[known], angles[known]
    begins = np.flatnonzero(state & ~np.roll(state, 1))
    middles = []
    for begin in begins:
        run = begin
        while state[(run + 1) % len(state)]:
            run += 1
        first, last = angles[begin], angles[run % len(state)]
        middles.append(first + 0.5 * ((last - first) % (2.0 * np.pi)))
    return np.array(middles)


def _ways_are_white(graph: Graph, node: int, smooth: FloatArray) -> bool:
    """Whether a white path leads from a node to the next ones in each direction."""
    column, row = graph.places[node]
    least = _PALEST * smooth[int(row + 0.5), int(column + 0.5)]
    for link in graph.links[node, : graph.degrees[node]]:
        before, here = node, int(link)
        for _ in range(_WAY_NODES):
            if whiteness_between(smooth, *graph.places[before], *graph.places[here]) < least:
                return False
            if graph.degrees[here] != 2:
                break
            a, b = graph.links[here, :2]
            before, here = here, int(b if a == before else a)
    return True
