"""Field lines from the fine graph (section 4.2): components of degree-two nodes, split and merge, end points projected.

All in the undistorted image plane, where straight lines are straight.
"""

import math

import numpy as np
from numba import njit

from touchline.geometry import FloatArray, IntArray
from touchline.perception.line_graph.chains import Chains

MAX_LINES = 64
_MIN_NODES = 3
_MAX_STACK = 256
_SAME_RAD = math.radians(4.0)  # directions of two components that may be merged
_BESIDE = 1.5  # how far, in splitting distances, one may lie off the other's line


def split_and_merge(nodes: FloatArray, chains: Chains, split: float, corners: bool) -> FloatArray:
    """Straight lines (L, 4) x0, y0, x1, y1 of chains of nodes (N, 2), all in the image plane.

    split: distance from the fitted line from which on a component is split. corners: whether one whose end is farthest
    off is split at its corner; else it loses that end.
    """
    found = np.empty((MAX_LINES, 4))
    parts = np.empty((MAX_LINES, 2), dtype=np.int64)
    count = _split(nodes, chains, split, corners, parts)
    members = np.arange(count)
    _merge(nodes, chains, split, parts[:count], members)
    return found[: _project_ends(nodes, chains, parts[:count], members, found)]


@njit(cache=True)
def fit_line(points: FloatArray, use: IntArray) -> tuple[float, float, float, float]:
    """Total least squares through points[use]: a point of the line and its direction, x, y, dx, dy."""
    n = max(len(use), 1)
    mx, my = 0.0, 0.0
    for k in use:
        mx += points[k, 0] / n
        my += points[k, 1] / n
    xx, xy, yy = 0.0, 0.0, 0.0
    for k in use:
        x, y = points[k, 0] - mx, points[k, 1] - my
        xx, xy, yy = xx + x * x, xy + x * y, yy + y * y
    angle = 0.5 * math.atan2(2.0 * xy, xx - yy)
    return mx, my, math.cos(angle), math.sin(angle)


@njit(cache=True)
def fit_with_ends(points: FloatArray, use: IntArray) -> tuple[float, float, float, float, float, float]:
    """`fit_line`, and how far along it the first and the last of the points lie."""
    x, y, dx, dy = fit_line(points, use)
    low, high = np.inf, -np.inf
    for k in use:
        along = (points[k, 0] - x) * dx + (points[k, 1] - y) * dy
        low, high = min(low, along), max(high, along)
    return x, y, dx, dy, low, high


@njit(cache=True)
def _split(nodes: FloatArray, chains: Chains, split: float, corners: bool, parts: IntArray) -> int:
    """First and last place in chains.nodes of every straight part, into parts (MAX_LINES, 2); returns how many."""
    stack = np.empty((_MAX_STACK, 2), dtype=np.int64)
    count = 0
    for chain in range(len(chains.starts) - 1):
        stack[0, 0], stack[0, 1] = chains.starts[chain], chains.starts[chain + 1] - 1
        depth = 1
        while depth > 0:
            depth -= 1
            first, last = stack[depth, 0], stack[depth, 1]
            if last - first + 1 < _MIN_NODES:
                continue
            x, y, dx, dy = fit_line(nodes, chains.nodes[first : last + 1])
            worst, at = 0.0, first
            for k in range(first, last + 1):
                n = chains.nodes[k]
                off = abs((nodes[n, 0] - x) * dy - (nodes[n, 1] - y) * dx)
                if off > worst:
                    worst, at = off, k
            if worst <= split:
                if count < len(parts):
                    parts[count, 0], parts[count, 1] = first, last
                    count += 1
            elif depth + 2 <= _MAX_STACK:
                end = at in (first, last)
                if end and not corners:
                    stack[depth, 0], stack[depth, 1] = first + (at == first), last - (at == last)
                    depth += 1
                    continue
                if end:
                    at = _farthest_from_chord(nodes, chains, first, last)
                stack[depth, 0], stack[depth, 1] = first, at
                stack[depth + 1, 0], stack[depth + 1, 1] = at, last
                depth += 2
    return count


@njit(cache=True)
def _farthest_from_chord(nodes: FloatArray, chains: Chains, first: int, last: int) -> int:
    """Where a component is split whose end is the node farthest from its line, as where a short arm leaves a long one.

    The corner is the node farthest from the straight line between both ends.
    """
    a, b = chains.nodes[first], chains.nodes[last]
    dx, dy = nodes[b, 0] - nodes[a, 0], nodes[b, 1] - nodes[a, 1]
    ring = dx * dx + dy * dy == 0.0
    worst, at = -1.0, (first + last) // 2
    for k in range(first + 1, last):
        x, y = nodes[chains.nodes[k], 0] - nodes[a, 0], nodes[chains.nodes[k], 1] - nodes[a, 1]
        off = math.hypot(x, y) if ring else abs(x * dy - y * dx)
        if off > worst:
            worst, at = off, k
    return at


@njit(cache=True)
def _members_of(chains: Chains, parts: IntArray, members: IntArray, group: int) -> IntArray:
    """Nodes of all parts of a group."""
    total = 0
    for k in range(len(parts)):
        if members[k] == group:
            total += parts[k, 1] - parts[k, 0] + 1
    use = np.empty(total, dtype=np.int64)
    at = 0
    for k in range(len(parts)):
        if members[k] == group:
            for m in range(parts[k, 0], parts[k, 1] + 1):
                use[at] = chains.nodes[m]
                at += 1
    return use


@njit(cache=True)
def _merge(nodes: FloatArray, chains: Chains, split: float, parts: IntArray, members: IntArray) -> None:
    """Give parts whose lines are alike the same number in members (K,)."""
    for a in range(len(parts)):
        one = _members_of(chains, parts, members, members[a])
        _, _, dxa, dya = fit_line(nodes, one)
        for b in range(a + 1, len(parts)):
            if members[a] == members[b]:
                continue
            other = _members_of(chains, parts, members, members[b])
            _, _, dxb, dyb = fit_line(nodes, other)
            if abs(dxa * dyb - dya * dxb) > math.sin(_SAME_RAD):
                continue
            both = np.concatenate((one, other))
            x, y, dx, dy = fit_line(nodes, both)
            worst = 0.0
            for n in both:
                worst = max(worst, abs((nodes[n, 0] - x) * dy - (nodes[n, 1] - y) * dx))
            if worst <= _BESIDE * split:
                gone = members[b]
                for k in range(len(parts)):
                    if members[k] == gone:
                        members[k] = members[a]
                one = _members_of(chains, parts, members, members[a])
                _, _, dxa, dya = fit_line(nodes, one)


@njit(cache=True)
def _project_ends(nodes: FloatArray, chains: Chains, parts: IntArray, members: IntArray, found: FloatArray) -> int:
    """The end points of each group of parts, projected onto its line, into found (L, 4); returns how many."""
    count = 0
    for group in range(len(parts)):
        use = _members_of(chains, parts, members, group)
        if len(use) == 0:
            continue
        x, y, dx, dy, low, high = fit_with_ends(nodes, use)
        found[count, 0], found[count, 1] = x + low * dx, y + low * dy
        found[count, 2], found[count, 3] = x + high * dx, y + high * dy
        count += 1
    return count
