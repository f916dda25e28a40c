"""Where lines meet: crossings typed L, T and X with their orientation, from the geometry alone.

After Schulz and Behnke (2012), section 4.1: the number of arms of paint that leave a meeting point is its type.
The centre circle on the halfway line makes two X, a corner arc on a touch line or goal line makes a T whose stem is
the arc. Crossings that a circle or arc takes part in are marked as curved, so that a matcher can leave them out.
"""

import itertools
import math
from dataclasses import dataclass

from touchline.field.distances import arc_sweep
from touchline.geometry import FloatArray, wrap_angle
from touchline.types import CrossingKind

Point = tuple[float, float]

_SAME_ARM_RAD = math.radians(15.0)  # arms closer than this are one line, painted in two pieces
_FLAT_RAD = math.radians(150.0)  # two arms that differ by more go straight on


@dataclass(frozen=True, slots=True)
class Crossing:
    """A crossing of line centres at x, y (m, field frame).

    orientation_rad: of an L the bisector into the corner's opening; of a T the direction of its stem, away from the
    bar; of an X one of its arms, in [0, pi/2), as it looks the same after a quarter turn. L and T: (-pi, pi].
    curved: a circle or an arc takes part.
    """

    kind: CrossingKind
    x: float
    y: float
    orientation_rad: float
    curved: bool


@dataclass(frozen=True, slots=True)
class _Bar:
    """A straight line, from its first end along a unit direction for a length (m)."""

    x: float
    y: float
    ux: float
    uy: float
    length: float

    def arms(self, point: Point, slack_m: float) -> list[float]:
        """Directions (rad) in which paint leaves the point: those with more than the slack left."""
        along = (point[0] - self.x) * self.ux + (point[1] - self.y) * self.uy
        forward = math.atan2(self.uy, self.ux)
        leaving = [forward] if self.length - along > slack_m else []
        return leaving + ([wrap_angle(forward + math.pi)] if along > slack_m else [])

    def holds(self, point: Point, slack_m: float) -> bool:
        """Whether a point of the straight line lies between the ends, or beyond one by no more than the slack."""
        along = (point[0] - self.x) * self.ux + (point[1] - self.y) * self.uy
        return -slack_m <= along <= self.length + slack_m


@dataclass(frozen=True, slots=True)
class _Bow:
    """A circle or arc: centre, radius (m), start and sweep (rad); a whole turn has no ends."""

    cx: float
    cy: float
    radius: float
    start: float
    sweep: float

    def _along(self, point: Point) -> float:
        """Arc length (m) from the start to the point, in half a gap before the start to half a gap after the end."""
        angle = math.atan2(point[1] - self.cy, point[0] - self.cx)
        return self.radius * (0.5 * self.sweep + wrap_angle(angle - self.start - 0.5 * self.sweep))

    def arms(self, point: Point, slack_m: float) -> list[float]:
        """Directions (rad) in which paint leaves the point."""
        onward = math.atan2(point[1] - self.cy, point[0] - self.cx) + 0.5 * math.pi
        whole = self.sweep >= 2.0 * math.pi
        along = self._along(point)
        leaving = [wrap_angle(onward)] if whole or self.radius * self.sweep - along > slack_m else []
        return leaving + ([wrap_angle(onward + math.pi)] if whole or along > slack_m else [])

    def holds(self, point: Point, slack_m: float) -> bool:
        """Whether a point of the whole circle lies on the arc, or beyond an end by no more than the slack."""
        whole = self.sweep >= 2.0 * math.pi
        return whole or -slack_m <= self._along(point) <= self.radius * self.sweep + slack_m


_Line = _Bar | _Bow


def find_crossings(
    segments: FloatArray, circles: FloatArray, arcs: FloatArray, line_width: float
) -> tuple[Crossing, ...]:
    """Crossings of segments (S, 4), circles (C, 3) and arcs (A, 5) in m, rad, field frame, sorted by kind and place.

    Paint is line_width wide and reaches half of it beyond both ends, so that an end touches any line whose centre is
    no farther than one line width; a line that goes on for no more than that has no arm there.
    """
    lines: list[_Line] = []
    for x1, y1, x2, y2 in segments.tolist():
        length = math.hypot(x2 - x1, y2 - y1)
        lines.append(_Bar(x1, y1, (x2 - x1) / length, (y2 - y1) / length, length))
    lines += [_Bow(cx, cy, radius, 0.0, 2.0 * math.pi) for cx, cy, radius in circles.tolist()]
    lines += [_Bow(cx, cy, radius, start, arc_sweep(start, end)) for cx, cy, radius, start, end in arcs.tolist()]
    slack_m = line_width * (1.0 + 1e-6)
    found = [_typed(points, members, slack_m) for points, members in _meetings(lines, slack_m)]
    return tuple(sorted((c for c in found if c is not None), key=lambda c: (c.kind, c.x, c.y)))


def _meetings(lines: list[_Line], slack_m: float) -> list[tuple[list[Point], set[_Line]]]:
    """Meeting points of pairs of lines, those closer than the slack gathered into one with all its lines."""
    groups: list[tuple[list[Point], set[_Line]]] = []
    for one, other in itertools.combinations(lines, 2):
        for point in _common_points(one, other):
            if not (one.holds(point, slack_m) and other.holds(point, slack_m)):
                continue
            for points, members in groups:
                if math.dist(points[0], point) <= slack_m:
                    points.append(point)
                    members.update((one, other))
                    break
            else:
                groups.append(([point], {one, other}))
    return groups


def _common_points(one: _Line, other: _Line) -> list[Point]:
    """Points common to the endless straight lines or whole circles that two lines are parts of."""
    if isinstance(one, _Bar) and isinstance(other, _Bar):
        cross = one.ux * other.uy - one.uy * other.ux
        if abs(cross) < math.sin(_SAME_ARM_RAD):
            return []
        along = ((other.x - one.x) * other.uy - (other.y - one.y) * other.ux) / cross
        return [(one.x + along * one.ux, one.y + along * one.uy)]
    if isinstance(one, _Bow) and isinstance(other, _Bow):
        return _common_points_of_circles(one, other)
    bar, bow = (one, other) if isinstance(one, _Bar) else (other, one)
    assert isinstance(bar, _Bar)
    assert isinstance(bow, _Bow)
    foot = (bow.cx - bar.x) * bar.ux + (bow.cy - bar.y) * bar.uy
    aside = (bow.cx - bar.x) * bar.uy - (bow.cy - bar.y) * bar.ux
    if abs(aside) >= bow.radius:
        return []
    half_chord = math.sqrt(bow.radius**2 - aside**2)
    return [(bar.x + s * bar.ux, bar.y + s * bar.uy) for s in (foot - half_chord, foot + half_chord)]


def _common_points_of_circles(one: _Bow, other: _Bow) -> list[Point]:
    apart = math.dist((one.cx, one.cy), (other.cx, other.cy))
    if not abs(one.radius - other.radius) < apart < one.radius + other.radius:
        return []
    along = (apart**2 + one.radius**2 - other.radius**2) / (2.0 * apart)
    aside = math.sqrt(max(one.radius**2 - along**2, 0.0))
    ux, uy = (other.cx - one.cx) / apart, (other.cy - one.cy) / apart
    return [(one.cx + along * ux - s * uy, one.cy + along * uy + s * ux) for s in (aside, -aside)]


def _typed(points: list[Point], members: set[_Line], slack_m: float) -> Crossing | None:
    """The crossing at a meeting point, or None where lines only touch or go straight on."""
    x = sum(point[0] for point in points) / len(points)
    y = sum(point[1] for point in points) / len(points)
    arms: list[float] = []
    for line in members:
        for arm in line.arms((x, y), slack_m):
            if all(abs(wrap_angle(arm - known)) > _SAME_ARM_RAD for known in arms):
                arms.append(arm)
    curved = any(isinstance(line, _Bow) for line in members)
    if len(arms) == 2 and abs(wrap_angle(arms[0] - arms[1])) < _FLAT_RAD:
        return Crossing(CrossingKind.L, x, y, _middle(arms), curved)
    if len(arms) == 3:
        bar = max(itertools.combinations(arms, 2), key=lambda pair: abs(wrap_angle(pair[0] - pair[1])))
        stem = next(arm for arm in arms if arm not in bar)
        return Crossing(CrossingKind.T, x, y, wrap_angle(stem), curved)
    if len(arms) == 4:
        quarter = _middle([4.0 * arm for arm in arms]) / 4.0
        return Crossing(CrossingKind.X, x, y, _in_first_quarter(quarter), curved)
    return None


def _middle(angles: list[float]) -> float:
    return math.atan2(sum(map(math.sin, angles)), sum(map(math.cos, angles)))


def _in_first_quarter(angle: float) -> float:
    """The angle modulo pi/2, where a rounding error below zero is zero and not almost pi/2."""
    reduced = angle % (0.5 * math.pi)
    return 0.0 if min(reduced, 0.5 * math.pi - reduced) < 1e-9 else reduced
