"""The key-node graph (section 4.1): what is left of the fine graph once it is smoothed and cleaned, and where it bends.

Its nodes of degree two with a sharp angle, of degree three and of degree four are the candidates for L, T and X.
"""

import math

import numpy as np
from numba import njit

from touchline.geometry import FloatArray, IntArray
from touchline.matrices import uncounted
from touchline.perception.line_graph.graph import Graph, connect, disconnect, length_between

_SPUR = 2.6  # cells: shorter lines that end in a junction are eliminated
_MERGE = 3.2  # cells: connected junctions closer than this are one crossing
_STRAIGHT = 0.9  # cells: a node nearer than this to the line between its neighbours is no corner
_SHARP_COS = math.cos(math.radians(155.0))  # of the angle between the two ways that leave a corner


def key_nodes(graph: Graph) -> tuple[Graph, FloatArray]:
    """The cleaned graph, and the candidates for crossings (C, 4): column, row (cells), degree, number of the node."""
    cleaned = Graph(graph.places.copy(), graph.links.copy(), graph.degrees.copy())
    found = np.empty((max(len(graph.degrees), 1), 4))
    return cleaned, found[: _clean(cleaned, found)]


@njit(cache=True)
def _clean(graph: Graph, found: FloatArray) -> int:
    """Clean the graph; its candidates into found (C, 4); returns how many."""
    graph = uncounted(graph)
    remove_spurs(graph)
    merge_junctions(graph)
    remove_spurs(graph)
    return _corners(graph, found)


@njit(cache=True)
def _other(graph: Graph, node: int, before: int) -> int:
    """The neighbour of a node of degree two that is not `before`."""
    return int(graph.links[node, 1] if graph.links[node, 0] == before else graph.links[node, 0])


@njit(cache=True)
def remove_spurs(graph: Graph) -> None:
    """Eliminate short lines that begin at a node of degree one and end in a junction."""
    for node in range(len(graph.degrees)):
        if graph.degrees[node] != 1:
            continue
        before, here = node, int(graph.links[node, 0])
        length, steps = length_between(graph, node, here), 0
        while graph.degrees[here] == 2 and length <= _SPUR and steps < 8:
            before, here = here, _other(graph, here, before)
            length += length_between(graph, before, here)
            steps += 1
        if graph.degrees[here] < 3 or length > _SPUR:
            continue
        here = node
        while graph.degrees[here] == 1:
            following = int(graph.links[here, 0])
            stop = graph.degrees[following] != 2
            disconnect(graph, here, following)
            if stop:
                break
            here = following


@njit(cache=True)
def merge_junctions(graph: Graph) -> None:
    """Draw junctions that are connected over a short way into one, at that node of the way that is most in its middle:
    on the skeleton.

    The ways between them go; a crossing never gets more than the connections that lead elsewhere.
    """
    merged = True
    while merged:
        merged = False
        for node in range(len(graph.degrees)):
            if graph.degrees[node] < 3:
                continue
            for k in range(graph.degrees[node]):
                before, here = node, int(graph.links[node, k])
                length = length_between(graph, node, here)
                while graph.degrees[here] == 2 and length <= _MERGE and here != node:
                    before, here = here, _other(graph, here, before)
                    length += length_between(graph, before, here)
                if here != node and graph.degrees[here] >= 3 and length <= _MERGE:
                    _contract(graph, node, k, here)
                    merged = True
                    break
            if merged:
                break


@njit(cache=True)
def _contract(graph: Graph, node: int, link: int, other: int) -> None:
    """Take the way from a node over one of its links to another junction away, and give this one its connections."""
    x = 0.5 * (graph.places[node, 0] + graph.places[other, 0])
    y = 0.5 * (graph.places[node, 1] + graph.places[other, 1])
    before, here, middle = node, int(graph.links[node, link]), node
    disconnect(graph, before, here)
    while True:
        if math.hypot(graph.places[here, 0] - x, graph.places[here, 1] - y) < math.hypot(
            graph.places[middle, 0] - x, graph.places[middle, 1] - y
        ):
            middle = here
        if here == other:
            break
        before, here = here, int(graph.links[here, 0])
        disconnect(graph, before, here)
    graph.places[node, 0], graph.places[node, 1] = graph.places[middle, 0], graph.places[middle, 1]
    while graph.degrees[other] > 0:
        neighbour = int(graph.links[other, 0])
        disconnect(graph, other, neighbour)
        connect(graph, node, neighbour)


@njit(cache=True)
def _corners(graph: Graph, found: FloatArray) -> int:
    """Junctions, and places of degree two where the way bends sharply over three nodes to each side."""
    count = 0
    for node in range(len(graph.degrees)):
        degree = graph.degrees[node]
        if degree >= 3 or (degree == 2 and _is_sharp(graph, node)):
            found[count, 0], found[count, 1] = graph.places[node, 0], graph.places[node, 1]
            found[count, 2], found[count, 3] = degree, node
            count += 1
    return count


@njit(cache=True)
def _along(graph: Graph, node: int, following: int, way: IntArray) -> int:
    """Up to three nodes that follow a node by way of one connected to it, into way (3,); returns how many."""
    before, here, count = node, following, 0
    while count < len(way):
        way[count] = here
        count += 1
        if graph.degrees[here] != 2:
            break
        before, here = here, _other(graph, here, before)
    return count


@njit(cache=True)
def _is_sharp(graph: Graph, node: int) -> bool:
    """Whether a node of degree two is where two straight ways meet at an angle."""
    one, other = np.empty(3, dtype=np.int64), np.empty(3, dtype=np.int64)
    a, b = _along(graph, node, graph.links[node, 0], one), _along(graph, node, graph.links[node, 1], other)
    if a == 0 or b == 0:
        return False
    places, x0, y0 = graph.places, graph.places[node, 0], graph.places[node, 1]
    ax, ay = places[one[a - 1], 0] - x0, places[one[a - 1], 1] - y0
    bx, by = places[other[b - 1], 0] - x0, places[other[b - 1], 1] - y0
    la, lb = math.hypot(ax, ay), math.hypot(bx, by)
    if not (la > 0.0 and lb > 0.0) or (ax * bx + ay * by) / (la * lb) < _SHARP_COS:
        return False
    # the corner itself, not its neighbours: no node nearby is farther from the line between the two far ones
    cx, cy = bx - ax, by - ay
    length = max(math.hypot(cx, cy), 1e-9)
    here = abs(ax * cy - ay * cx) / length
    if here < _STRAIGHT:
        return False
    for way in (one[: a - 1], other[: b - 1]):
        for k in way:
            x, y = places[k, 0] - x0 - ax, places[k, 1] - y0 - ay
            if abs(x * cy - y * cx) / length > here:
                return False
    return True
