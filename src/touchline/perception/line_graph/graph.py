"""The line structure graph (section 3.3): nodes along the skeleton, connections between them.

After S. Behnke, M. Pfister, R. Rojas: Recognition of handwritten digits using structural information (1997), which the
paper names for the details.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.geometry import ByteArray, FloatArray, IntArray
from touchline.matrices import uncounted
from touchline.perception.line_graph.skeleton import NO_SKELETON
from touchline.perception.sorting import order_of

MAX_NODES = 1500
MAX_LINKS = 8
MAX_DEGREE = 4  # more lines never meet
_RANKS = 3
_REACH = 6.0  # cells that a candidate connection may bridge
_BESIDE = 1.0  # cells: a connection that passes a node by so closely leads through it
_TURN = math.radians(40.0)  # by how much a line may turn where a connection continues it
_TAN_TURN = math.tan(_TURN)
_MAX_CANDIDATES = 4096
_PALEST = 0.25  # least whiteness along a candidate connection, as a share of its nodes'


class Graph(NamedTuple):
    """Nodes and their connections.

    places: (N, 2) column, row in cells, the middle of a cell is whole. links: (N, 8) nodes that each is connected
    to, of which the first `degrees` (N,) count.
    """

    places: FloatArray
    links: IntArray
    degrees: IntArray


def line_graph(smooth: FloatArray, ranks: ByteArray, bridge: bool = True) -> Graph:
    """The graph of a skeleton: ranks (rows, columns) of `rank_cells`, smooth the whiteness it comes from.

    bridge: whether candidate connections over gaps are judged.
    """
    graph = Graph(np.empty((MAX_NODES, 2)), np.empty((MAX_NODES, MAX_LINKS), dtype=np.int64),
                  np.zeros(MAX_NODES, dtype=np.int64))  # fmt: skip
    count = _build(smooth, ranks, bridge, graph, np.full(ranks.shape, -1, dtype=np.int64))
    return Graph(graph.places[:count], graph.links[:count], graph.degrees[:count])


@njit(cache=True)
def _build(smooth: FloatArray, ranks: ByteArray, bridge: bool, graph: Graph, node_at: IntArray) -> int:
    """`line_graph`, into the graph; returns how many nodes there are."""
    smooth, ranks, graph, node_at = uncounted((smooth, ranks, graph, node_at))
    count = place_nodes(ranks, node_at, graph.places)
    connect_regions(ranks, node_at, graph)
    remove_triangles(graph, count)
    count = stretch_ends(ranks, node_at, graph, count)
    if bridge:
        bridge_gaps(smooth, graph, count)
    lead_through(graph, count)
    refine_places(smooth, graph, count)
    return count


@njit(cache=True)
def place_nodes(ranks: ByteArray, node_at: IntArray, cells: FloatArray) -> int:
    """Nodes at peaks of the skeleton, then along its ridges at least two cells apart.

    Writes the number of the node into node_at (rows, columns), column and row into cells; returns how many.
    """
    rows, columns = ranks.shape
    skeleton, number, count = np.empty((ranks.size, 2), dtype=np.int64), 0, 0
    for row in range(rows):
        for column in range(columns):
            if ranks[row, column] != NO_SKELETON:
                skeleton[number, 0], skeleton[number, 1] = row, column
                number += 1
    for rank in range(_RANKS):
        for row, column in skeleton[:number]:
            if ranks[row, column] != rank or count == len(cells):
                continue
            free = True
            for r in range(max(row - 1, 0), min(row + 2, rows)):
                for c in range(max(column - 1, 0), min(column + 2, columns)):
                    free = free and node_at[r, c] < 0
            if free:
                node_at[row, column] = count
                cells[count, 0], cells[count, 1] = column, row
                count += 1
    return count


@njit(cache=True)
def connected(graph: Graph, a: int, b: int) -> bool:
    """Whether two nodes are connected."""
    found = False
    for k in range(graph.degrees[a]):
        found = found or graph.links[a, k] == b
    return found


@njit(cache=True)
def connect(graph: Graph, a: int, b: int) -> None:
    """Connect two nodes, if they are not and have room."""
    if a == b or graph.degrees[a] == MAX_LINKS or graph.degrees[b] == MAX_LINKS or connected(graph, a, b):
        return
    graph.links[a, graph.degrees[a]] = b
    graph.links[b, graph.degrees[b]] = a
    graph.degrees[a] += 1
    graph.degrees[b] += 1


@njit(cache=True)
def _drop(graph: Graph, a: int, b: int) -> None:
    for k in range(graph.degrees[a]):
        if graph.links[a, k] == b:
            graph.degrees[a] -= 1
            graph.links[a, k] = graph.links[a, graph.degrees[a]]
            return


@njit(cache=True)
def disconnect(graph: Graph, a: int, b: int) -> None:
    """Remove the connection of two nodes."""
    _drop(graph, a, b)
    _drop(graph, b, a)


@njit(cache=True)
def _nodes_near(node_at: IntArray, row: int, column: int, near: IntArray) -> int:
    """Nodes whose 3 x 3 region holds a cell, into near (9,); returns how many."""
    rows, columns = node_at.shape
    count = 0
    for r in range(max(row - 1, 0), min(row + 2, rows)):
        for c in range(max(column - 1, 0), min(column + 2, columns)):
            if node_at[r, c] >= 0:
                near[count] = node_at[r, c]
                count += 1
    return count


@njit(cache=True)
def connect_regions(ranks: ByteArray, node_at: IntArray, graph: Graph) -> None:
    """Connect nodes whose 3 x 3 regions overlap or touch on the skeleton."""
    rows, columns = ranks.shape
    here, there = np.empty(9, dtype=np.int64), np.empty(9, dtype=np.int64)
    for row in range(rows):
        for column in range(columns):
            if ranks[row, column] == NO_SKELETON:
                continue
            count = _nodes_near(node_at, row, column, here)
            for k in range(count):
                for m in range(k + 1, count):
                    connect(graph, here[k], here[m])
            for r in range(row, min(row + 2, rows)):
                for c in range(max(column - 1, 0), min(column + 2, columns)):
                    if ranks[r, c] == NO_SKELETON or (r == row and c <= column):
                        continue
                    beside = _nodes_near(node_at, r, c, there)
                    for k in range(count):
                        for m in range(beside):
                            connect(graph, here[k], there[m])


@njit(cache=True)
def length_between(graph: Graph, a: int, b: int) -> float:
    """Of the connection of two nodes, in cells."""
    return math.hypot(graph.places[a, 0] - graph.places[b, 0], graph.places[a, 1] - graph.places[b, 1])


@njit(cache=True)
def remove_triangles(graph: Graph, count: int) -> None:
    """Of three nodes that are all connected the longest connection is redundant (simplicity)."""
    for a in range(count):
        k = 0
        while k < graph.degrees[a]:
            b, redundant = graph.links[a, k], False
            for m in range(graph.degrees[a]):
                c = graph.links[a, m]
                if c != b and connected(graph, b, c):
                    length = length_between(graph, a, b)
                    redundant = redundant or (
                        length >= length_between(graph, a, c) and length >= length_between(graph, b, c)
                    )
            if redundant:
                disconnect(graph, a, b)
            else:
                k += 1


@njit(cache=True)
def stretch_ends(ranks: ByteArray, node_at: IntArray, graph: Graph, count: int) -> int:
    """Move end nodes to the last cell of the skeleton, split nodes without connections; returns how many there are."""
    rows, columns = ranks.shape
    for node in range(count):
        if graph.degrees[node] > 1:
            continue
        column, row = int(graph.places[node, 0]), int(graph.places[node, 1])
        # of a lone node: the cell farthest from it, then the one farthest from that
        from_column, from_row = graph.places[node, 0], graph.places[node, 1]
        if graph.degrees[node] == 1:
            other = graph.links[node, 0]
            from_column, from_row = graph.places[other, 0], graph.places[other, 1]
        far_column, far_row, farthest = column, row, math.hypot(column - from_column, row - from_row)
        second_column, second_row, second = column, row, -1.0
        for turn in range(2 if graph.degrees[node] == 0 else 1):
            for r in range(max(row - 1, 0), min(row + 2, rows)):
                for c in range(max(column - 1, 0), min(column + 2, columns)):
                    if ranks[r, c] == NO_SKELETON:
                        continue
                    if turn == 0 and math.hypot(c - from_column, r - from_row) > farthest:
                        far_column, far_row, farthest = c, r, math.hypot(c - from_column, r - from_row)
                    if turn == 1 and math.hypot(c - far_column, r - far_row) > second:
                        second_column, second_row, second = c, r, math.hypot(c - far_column, r - far_row)
        graph.places[node, 0], graph.places[node, 1] = far_column, far_row
        if graph.degrees[node] == 0 and second >= 1.0 and count < len(graph.places):
            graph.places[count, 0], graph.places[count, 1] = second_column, second_row
            connect(graph, node, count)
            count += 1
    return count


@njit(cache=True)
def _turn(graph: Graph, before: int, node: int, after_x: float, after_y: float) -> float:
    """Angle (rad) between the connection before -> node and the direction (after_x, after_y)."""
    x, y = graph.places[node, 0] - graph.places[before, 0], graph.places[node, 1] - graph.places[before, 1]
    return abs(math.atan2(x * after_y - y * after_x, x * after_x + y * after_y))


@njit(cache=True)
def _goes_on(graph: Graph, before: int, node: int, after_x: float, after_y: float) -> bool:
    """Whether the way from the node before turns so little at a node that a line may go on along (after_x, after_y)."""
    x, y = graph.places[node, 0] - graph.places[before, 0], graph.places[node, 1] - graph.places[before, 1]
    along = x * after_x + y * after_y
    return bool(along >= 0.0 and abs(x * after_y - y * after_x) <= _TAN_TURN * along)


@njit(cache=True)
def whiteness_between(smooth: FloatArray, x0: float, y0: float, x1: float, y1: float) -> float:
    """Least whiteness on the straight line between two places (columns, rows), its ends left out."""
    steps = max(int(2.0 * max(abs(x1 - x0), abs(y1 - y0))), 2)
    least = np.inf
    for k in range(1, steps):
        x, y = x0 + (x1 - x0) * k / steps, y0 + (y1 - y0) * k / steps
        least = min(least, smooth[int(y + 0.5), int(x + 0.5)])
    return least


@njit(cache=True)
def _is_continued(graph: Graph, node: int, x: float, y: float) -> bool:
    """Whether a connection in direction (x, y) suits a node: continues its end, or leaves a straight line."""
    degree = graph.degrees[node]
    if degree == 0:
        return True
    if degree == 1:
        return _goes_on(graph, graph.links[node, 0], node, x, y)
    if degree == 2:
        a, b = graph.links[node, 0], graph.links[node, 1]
        bx, by = graph.places[b, 0] - graph.places[node, 0], graph.places[b, 1] - graph.places[node, 1]
        return _goes_on(graph, a, node, bx, by) or _goes_on(graph, a, node, x, y) or _goes_on(graph, b, node, x, y)
    return bool(degree < MAX_DEGREE)


@njit(cache=True)
def _cost(smooth: FloatArray, graph: Graph, end: int, other: int) -> float:
    """How badly a connection from an end to another node fits: infinite where it is not allowed.

    Closure: its length; continuity: how much the line turns; the whiteness along it like that of the nodes.
    """
    x, y = graph.places[other, 0] - graph.places[end, 0], graph.places[other, 1] - graph.places[end, 1]
    length = math.hypot(x, y)
    if length > _REACH or length == 0.0 or connected(graph, end, other):
        return np.inf
    if not (_is_continued(graph, end, x, y) and _is_continued(graph, other, -x, -y)):
        return np.inf
    turn = _turn(graph, graph.links[end, 0], end, x, y) if graph.degrees[end] == 1 else 0.5 * _TURN
    white = 0.5 * (
        smooth[int(graph.places[end, 1] + 0.5), int(graph.places[end, 0] + 0.5)]
        + smooth[int(graph.places[other, 1] + 0.5), int(graph.places[other, 0] + 0.5)]
    )
    between = whiteness_between(
        smooth, graph.places[end, 0], graph.places[end, 1], graph.places[other, 0], graph.places[other, 1]
    )
    paleness = max(0.0, 1.0 - between / max(white, 1e-6))
    if paleness > 1.0 - _PALEST:
        return np.inf
    return float(length / _REACH + turn / _TURN + paleness)


@njit(cache=True)
def _may_bridge(graph: Graph, end: int, other: int) -> bool:
    """Whether a candidate connection is to be judged at all: degrees, and no triangle (simplicity)."""
    if end == other or graph.degrees[end] > 1 or graph.degrees[other] >= MAX_DEGREE:
        return False
    return graph.degrees[end] == 0 or not connected(graph, graph.links[end, 0], other)


@njit(cache=True)
def bridge_gaps(smooth: FloatArray, graph: Graph, count: int) -> None:
    """Make the candidate connections of end nodes that fit, those that fit best first."""
    costs, pairs = np.empty(_MAX_CANDIDATES), np.empty((_MAX_CANDIDATES, 2), dtype=np.int64)
    found = 0
    for end in range(count):
        if graph.degrees[end] > 1:
            continue
        x, y = graph.places[end, 0], graph.places[end, 1]
        for other in range(count):
            if abs(graph.places[other, 0] - x) > _REACH or abs(graph.places[other, 1] - y) > _REACH:
                continue
            if found == _MAX_CANDIDATES or not _may_bridge(graph, end, other):
                continue
            cost = _cost(smooth, graph, end, other)
            if cost < np.inf:
                costs[found], pairs[found, 0], pairs[found, 1] = cost, end, other
                found += 1
    order = order_of(costs[:found])
    k = 0
    while k < found:
        end, other = pairs[order[k], 0], pairs[order[k], 1]
        # what has been connected meanwhile may rule it out, or be what it continues: then all are judged again
        if _may_bridge(graph, end, other) and _cost(smooth, graph, end, other) < np.inf:
            connect(graph, end, other)
            k = 0
        else:
            k += 1


@njit(cache=True)
def lead_through(graph: Graph, count: int) -> None:
    """Lead connections that pass a node by through it (simplicity), as where the end of a line lies on another one."""
    for node in range(count):
        if graph.degrees[node] == 0 or graph.degrees[node] >= MAX_DEGREE:
            continue
        x, y = graph.places[node, 0], graph.places[node, 1]
        for a in range(count):
            if a == node or abs(graph.places[a, 0] - x) > _REACH or abs(graph.places[a, 1] - y) > _REACH:
                continue
            for k in range(graph.degrees[a]):
                b = graph.links[a, k]
                if b > a and b != node and _passes_by(graph, a, b, x, y):
                    disconnect(graph, a, b)
                    connect(graph, a, node)
                    connect(graph, node, b)
                    break


@njit(cache=True)
def _passes_by(graph: Graph, a: int, b: int, x: float, y: float) -> bool:
    """Whether the connection of two nodes passes within a cell of a place between them."""
    ax, ay = graph.places[a, 0], graph.places[a, 1]
    dx, dy = graph.places[b, 0] - ax, graph.places[b, 1] - ay
    length2, along, aside = dx * dx + dy * dy, (x - ax) * dx + (y - ay) * dy, (x - ax) * dy - (y - ay) * dx
    return bool(0.0 < along < length2 and aside * aside <= _BESIDE**2 * length2)


@njit(cache=True)
def refine_places(smooth: FloatArray, graph: Graph, count: int) -> None:
    """Move nodes onto the ridge between cells: the top of a parabola across the line, along rows or columns.

    Junctions and lone nodes stay on their cell.
    """
    rows, columns = smooth.shape
    for node in range(count):
        degree = graph.degrees[node]
        column, row = int(graph.places[node, 0]), int(graph.places[node, 1])
        if degree == 0 or degree > 2:
            continue
        a, b = graph.links[node, 0], graph.links[node, 1] if degree == 2 else node
        upright = abs(graph.places[a, 0] - graph.places[b, 0]) < abs(graph.places[a, 1] - graph.places[b, 1])
        here = smooth[row, column]
        if upright and 0 < column < columns - 1:
            before, after = smooth[row, column - 1], smooth[row, column + 1]
        elif not upright and 0 < row < rows - 1:
            before, after = smooth[row - 1, column], smooth[row + 1, column]
        else:
            continue
        bend = before - 2.0 * here + after
        if bend < 0.0 and before <= here and after <= here:
            graph.places[node, 0 if upright else 1] += 0.5 * (before - after) / bend
