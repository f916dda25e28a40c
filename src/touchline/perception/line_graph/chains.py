"""Chains of a graph: the ways between nodes that are no mere passages, as field lines and key nodes start from."""

from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.geometry import BoolArray, IntArray
from touchline.perception.line_graph.graph import Graph


class Chains(NamedTuple):
    """nodes: (M,) of all chains, end nodes included; chain k is nodes[starts[k] : starts[k + 1]], starts (K + 1,)."""

    nodes: IntArray
    starts: IntArray


def find_chains(graph: Graph) -> Chains:
    """Connected nodes of degree two, with the nodes of other degree that are connected directly to them.

    Two nodes of other degree that are connected make a chain of two. A closed ring begins and ends with the same node.
    """
    total = int(graph.degrees.sum()) + len(graph.degrees) + 8
    nodes, starts = np.empty(2 * total, dtype=np.int64), np.zeros(total + 1, dtype=np.int64)
    count = _trace(graph, nodes, starts)
    return Chains(nodes[: starts[count]], starts[: count + 1])


@njit(cache=True)
def _follow(graph: Graph, begin: int, link: int, used: BoolArray, nodes: IntArray) -> int:
    """Write the chain that leaves a node by one of its links, and return its length; used: (N, 8) links walked."""
    nodes[0] = begin
    at = 1
    node, out = begin, link
    while True:
        following = graph.links[node, out]
        used[node, out] = True
        for k in range(graph.degrees[following]):
            if graph.links[following, k] == node:
                used[following, k] = True
                out = k
        nodes[at] = following
        at += 1
        if graph.degrees[following] != 2 or following == begin:
            return at
        node, out = following, 1 - out


@njit(cache=True)
def _trace(graph: Graph, nodes: IntArray, starts: IntArray) -> int:
    """Chains from nodes of other degree than two, then what is left: rings."""
    used = np.zeros(graph.links.shape, dtype=np.bool_)
    count, at = 0, 0
    for ring in (False, True):
        for node in range(len(graph.degrees)):
            if (graph.degrees[node] == 2) != ring:
                continue
            for k in range(graph.degrees[node]):
                if not used[node, k]:
                    at += _follow(graph, node, k, used, nodes[at:])
                    count += 1
                    starts[count] = at
    return count
