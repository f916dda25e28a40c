"""The centre circle among the graph's nodes: the middle of a circle of the field's radius through many of them.

An addition of ours: its arcs are distinguished from straight lines, and its middle is a landmark. If the camera's roll
or pitch is off by degrees, a circle 5 m away is half as long again on the ground: it is
searched at other rolls and pitches, too.
"""

import math
from collections import Counter
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.geometry import BoolArray, FloatArray, Pose3
from touchline.perception.line_graph.graph import Graph
from touchline.types import LandmarkKind, Landmarks, Lines

_SECTORS = 24
_MIN_SECTORS = 7  # 105° of the circle
_NEAR_M, _NEAR_RATIO = 0.05, 0.012  # how far a node may lie off the circle, and how much more per metre of range
_TANGENT_COS = math.cos(math.radians(16.0))
_ROUNDS = 4
_LONG = 1.4  # of a line, in radii
_EVERY = 3  # so many nodes apart are those that propose a middle
_ARC_SAMPLES, _ARC_SHARE, _ARC_COS = 11, 0.6, 0.7  # so much of an arc lies on the circle, and not radially
_MIN_M, _LEANING_M = 0.02, 0.06  # standard deviation of the best middle, and of one seen at another lean
_PITCHES_DEG, _ROLLS_DEG = (0.0, 1.4, -1.4, 2.8, -2.8, 4.2, -4.2), (0.0, 2.5, -2.5)
NO_LEAN, *_OTHERS = ((math.radians(roll), math.radians(pitch)) for pitch in _PITCHES_DEG for roll in _ROLLS_DEG)
OTHER_LEANS = tuple(_OTHERS)
_CLEARLY = 2  # sectors more
_LEAN_IMAGES = 5  # first images in which the circle is looked for at every lean of the camera: 3 ms each
_STEP_M = 0.01


class Circle(NamedTuple):
    """x, y: middle (m, robot frame), if the camera leans as it is thought to but for `lean`: roll and pitch (rad) more,
    about the robot's own axes. radius_m. sectors: how many of 24 show it. deviation_m: of the nodes on it.
    """

    x: float
    y: float
    radius_m: float
    sectors: int
    deviation_m: float
    lean: tuple[float, float] = NO_LEAN


class LeanMemory:
    """At which `leans` the circle is looked for: at all in the first images, then at that of most circles in these."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        self.leans, self._images, self._seen = OTHER_LEANS, 0, Counter[tuple[float, float]]()

    def take(self, circle: Circle | None, ends_image: bool) -> None:
        """Take what a part of an image shows; ends_image: whether images are counted by this part."""
        if self._images >= _LEAN_IMAGES:
            return
        if circle is not None:
            self._seen[circle.lean] += 1
        self._images += ends_image
        if self._images >= _LEAN_IMAGES:
            self.leans = tuple(lean for lean, _ in self._seen.most_common(1) if lean != NO_LEAN)


@njit(cache=True)
def _follows(circle: tuple[float, float, float], ends_m: FloatArray) -> bool:
    """Whether a line's ends (2, 2) are those of an arc, though profiles may have drawn it out beyond the circle."""
    middle_x, middle_y, radius_m = circle
    (x, y), dx, dy = ends_m[0], ends_m[1, 0] - ends_m[0, 0], ends_m[1, 1] - ends_m[0, 1]
    on = 0
    for k in range(_ARC_SAMPLES):
        px, py = x + dx * k / (_ARC_SAMPLES - 1), y + dy * k / (_ARC_SAMPLES - 1)
        off = abs(math.hypot(px - middle_x, py - middle_y) - radius_m)
        on += off < 2.0 * _NEAR_M + 2.0 * _NEAR_RATIO * math.hypot(px, py)
    out_x, out_y = x + 0.5 * dx - middle_x, y + 0.5 * dy - middle_y
    radial = abs(dx * out_x + dy * out_y) / max(math.hypot(dx, dy) * math.hypot(out_x, out_y), 1e-9)
    return on >= _ARC_SHARE * _ARC_SAMPLES and radial < _ARC_COS


def circle_landmark(circle: Circle | None, at: tuple[float, float, float]) -> Landmarks:
    """The middle of the circle; none without one. Its error is that of a few independent nodes, not of all.

    at: x, y, height (m) of the camera, robot frame.
    """
    if circle is None:
        return Landmarks.none()
    middle, axes = np.array([[circle.x, circle.y]]), np.eye(2)
    deviation = _MIN_M if circle.lean == NO_LEAN else _LEANING_M
    deviation += circle.deviation_m / math.sqrt(circle.sectors / 4.0)
    if circle.lean != NO_LEAN:
        beside = _leaned(middle + _STEP_M * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), at, circle.lean, back=True)
        middle, axes = beside[:1], (beside[1:] - beside[0]).T / _STEP_M
        if not np.isfinite(beside).all():  # above the horizon as it is thought to be
            return Landmarks.none()
    return Landmarks(
        np.array([LandmarkKind.CIRCLE.value]),
        middle,
        deviation**2 * (axes @ axes.T)[np.newaxis],
        np.array([min(1.0, 2.0 * circle.sectors / _SECTORS)]),
        ((),),
        np.full((1, 2), np.nan),
    )


def _leaned(
    points_m: FloatArray, at: tuple[float, float, float], lean: tuple[float, float], back: bool = False
) -> FloatArray:
    """Ground points (…, 2) as a camera `at` x, y, height would see them that leans by roll and pitch more, Rx(roll)
    Ry(pitch); NaN above its horizon. back: from such a camera's.
    """
    if lean == NO_LEAN:
        return points_m
    turn, leaned = _turn(*lean), np.empty(points_m.shape)
    _lean(points_m.reshape(-1, 2), at, turn.T if back else turn, leaned.reshape(-1, 2))
    return leaned


@njit(cache=True, error_model="numpy")
def _lean(points_m, at, turn, leaned):  # type: ignore[no-untyped-def]
    """Ground points (N, 2) as a camera `at` x, y, height sees them that is turned (3, 3), into leaned (N, 2)."""
    for i in range(len(points_m)):
        x, y = points_m[i, 0] - at[0], points_m[i, 1] - at[1]
        down = at[2] * turn[2, 2] - turn[2, 0] * x - turn[2, 1] * y
        scale = at[2] / down if down > 0.0 else math.nan
        for k in range(2):
            leaned[i, k] = at[k] + scale * (turn[k, 0] * x + turn[k, 1] * y - turn[k, 2] * at[2])


@lru_cache(maxsize=64)
def _turn(roll: float, pitch: float) -> FloatArray:
    """(3, 3) Rx(roll) Ry(pitch)."""
    return Pose3.from_roll_pitch_yaw(roll, 0.0, 0.0).rotation @ Pose3.from_roll_pitch_yaw(0.0, pitch, 0.0).rotation


def without_arcs(lines: Lines, circle: Circle, at: tuple[float, float, float]) -> Lines:
    """The lines that are no chords of a circle. at: as of `circle_landmark`."""
    own = circle.x, circle.y, circle.radius_m
    ends_m = _leaned(lines.ends_m, at, circle.lean)
    return lines.rows(np.array([not _follows(own, ends) for ends in ends_m], dtype=np.bool_))


def find_leaning_circle(
    graph: Graph,
    ground: FloatArray,
    lines_m: FloatArray,
    radius_m: float,
    max_range_m: float,
    at: tuple[float, float, float],
    leans: Sequence[tuple[float, float]],
) -> Circle | None:
    """`find_circle`, or that of a camera `at` x, y, height (m) that leans by a roll and pitch of `leans` more, if
    clearly more of it is seen so: the one of which most is, and of those the truest.
    """
    found = []
    for lean in (NO_LEAN, *leans):
        nodes, ends_m = _leaned(ground, at, lean), _leaned(lines_m, at, lean)
        circle = find_circle(graph, nodes, ends_m, radius_m, max_range_m)
        if circle is not None:
            found.append(circle._replace(lean=lean))
    if not found:
        return None
    first, best = found[0], max(found, key=lambda one: (one.sectors, -one.deviation_m))
    return first if first.lean == NO_LEAN and best.sectors < first.sectors + _CLEARLY else best


def find_circle(
    graph: Graph, ground: FloatArray, lines_m: FloatArray, radius_m: float, max_range_m: float
) -> Circle | None:
    """The circle of a known radius that most nodes lie on which no long line passes; None where less than 105° is seen.

    ground: (N, 2) ground points of the graph's nodes (m); NaN above the horizon. lines_m: (L, 2, 2) ends of the lines.
    """
    tangents = _tangents(graph, ground, max_range_m)
    _leave_out(ground, lines_m, _LONG * radius_m, tangents)
    found = np.empty(4)
    if not _best_circle(ground, tangents, radius_m, found):
        return None
    return Circle(float(found[0]), float(found[1]), radius_m, int(found[2]), float(found[3]))


@njit(cache=True, error_model="numpy")
def _tangents(graph: Graph, ground: FloatArray, max_range_m: float) -> FloatArray:
    """(N, 2) unit directions of the line at nodes of degree two within a range; NaN of the others."""
    tangents = np.full((len(ground), 2), np.nan)
    for node in range(len(ground)):
        if graph.degrees[node] != 2 or not math.hypot(ground[node, 0], ground[node, 1]) <= max_range_m:
            continue
        a, b = graph.links[node, 0], graph.links[node, 1]
        x, y = ground[b, 0] - ground[a, 0], ground[b, 1] - ground[a, 1]
        length = math.hypot(x, y)
        if length > 0.0:
            tangents[node, 0], tangents[node, 1] = x / length, y / length
    return tangents


@njit(cache=True, error_model="numpy")
def _leave_out(ground: FloatArray, lines_m: FloatArray, long_m: float, tangents: FloatArray) -> None:
    """Forget the tangents (N, 2) of nodes that lie on a line longer than any chord that looks straight."""
    for k in range(len(lines_m)):
        x, y = lines_m[k, 0]
        dx, dy = lines_m[k, 1, 0] - x, lines_m[k, 1, 1] - y
        length = math.hypot(dx, dy)
        if length < long_m:
            continue
        for node in range(len(ground)):
            px, py = ground[node, 0] - x, ground[node, 1] - y
            along, slack = (px * dx + py * dy) / length, _NEAR_M + _NEAR_RATIO * math.hypot(px + x, py + y)
            if abs(px * dy - py * dx) < slack * length and -slack < along < length + slack:
                tangents[node, 0] = tangents[node, 1] = np.nan


@njit(cache=True, error_model="numpy")
def _members(nodes: FloatArray, radius_m: float, x: float, y: float, use: BoolArray) -> int:
    """Mark those of nodes (N, 5) that lie on a circle and along it; returns in how many of 24 sectors there are some.

    nodes: ground point, unit direction of the line there, and how far off the circle it may lie.
    """
    sectors, count = 0, 0
    for node in range(len(nodes)):
        dx, dy, slack = nodes[node, 0] - x, nodes[node, 1] - y, nodes[node, 4]
        distance = math.sqrt(dx * dx + dy * dy)
        use[node] = (
            abs(distance - radius_m) < slack
            and distance > 0.0
            and abs(dx * nodes[node, 3] - dy * nodes[node, 2]) > _TANGENT_COS * distance
        )
        if use[node]:
            sectors |= 1 << int((math.atan2(dy, dx) + math.pi) / (2.0 * math.pi) * _SECTORS) % _SECTORS
    for sector in range(_SECTORS):
        count += sectors >> sector & 1
    return count


@njit(cache=True, error_model="numpy")
def _best_circle(ground: FloatArray, tangents: FloatArray, radius_m: float, found: FloatArray) -> bool:
    """The middle that most sectors speak for, then by least squares; x, y, sectors, deviation into found (4,)."""
    nodes, use = np.empty((len(ground), 5)), np.zeros(len(ground), dtype=np.bool_)
    known = 0
    for node in range(len(ground)):
        if math.isnan(tangents[node, 0]):
            continue
        x, y = ground[node, 0], ground[node, 1]
        nodes[known, 0], nodes[known, 1], nodes[known, 4] = x, y, _NEAR_M + _NEAR_RATIO * math.hypot(x, y)
        nodes[known, 2], nodes[known, 3] = tangents[node, 0], tangents[node, 1]
        known += 1
    nodes, best = nodes[:known], 0
    for node in range(0, len(ground), _EVERY):
        if math.isnan(tangents[node, 0]):
            continue
        for side in (-radius_m, radius_m):
            x, y = ground[node, 0] - side * tangents[node, 1], ground[node, 1] + side * tangents[node, 0]
            sectors = _members(nodes, radius_m, x, y, use)
            if sectors > best:
                best = sectors
                found[0], found[1] = x, y
    if best < _MIN_SECTORS:
        return False
    for _ in range(_ROUNDS):
        best = _members(nodes, radius_m, found[0], found[1], use)
        if best < _MIN_SECTORS:
            return False
        a, b, c, p, q, squares, count = 1e-9, 0.0, 1e-9, 0.0, 0.0, 0.0, 0
        for node in range(known):
            if not use[node]:
                continue
            dx, dy = found[0] - nodes[node, 0], found[1] - nodes[node, 1]
            distance = math.hypot(dx, dy)
            dx, dy, off = dx / distance, dy / distance, radius_m - distance
            a, b, c, p, q = a + dx * dx, b + dx * dy, c + dy * dy, p + dx * off, q + dy * off
            squares, count = squares + off * off, count + 1
        det = a * c - b * b
        found[0] += (c * p - b * q) / det
        found[1] += (a * q - b * p) / det
        found[3] = math.sqrt(squares / max(count - 2, 1))
    found[2] = best
    return True
