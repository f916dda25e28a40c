"""Which crossing, post or mark of the field an observation means: tables from a place to the nearest one of its kind.

Schulz and Behnke 2012, section 5.1: the L-crossings are split into four sets by their orientation, the T-crossings are
sought by position, and a coarse table holds the nearest of each set for every place of the field. Here the T-crossings
have four sets as well; how many crossings a set has depends on the field.
"""

import math
from collections.abc import Collection
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from touchline.field.model import FieldModel
from touchline.geometry import FloatArray, IntArray
from touchline.types import Colors, CrossingKind, LandmarkKind

CELL_M = 0.1  # of the tables: a fifth of the shortest distance between two crossings of one set
BEYOND_M = 1.5  # how far beyond the field the tables reach: observations err, robots stand outside
QUARTERS = 4
NO_PLACE = -1


class AssociationTables(NamedTuple):
    """The places of a field that point features are seen at, and tables of the nearest one.

    places_m: (P, 2) field frame. nearest: int16 (K, ny, nx), index of the nearest place of set k at
    origin + CELL_M * (ix, iy), -1 where the set is empty. origin_x, origin_y: m.
    """

    places_m: FloatArray
    nearest: npt.NDArray[np.int16]
    origin_x: float
    origin_y: float


class Association(NamedTuple):
    """How an observation finds its place.

    table: the first of its sets, -1 without one. sets: 1, or 4 by orientation. turn_rad: orientation at which the first
    of four begins. candidates: indices (C,) of places that are tried one by one, without a table.
    """

    table: int
    sets: int
    turn_rad: float
    candidates: IntArray


_NOTHING = Association(NO_PLACE, 1, 0.0, np.zeros(0, np.int64))


class FieldAssociations:
    """The association tables of one field, and what looks like what. `tables`: for the loops."""

    def __init__(self, field: FieldModel) -> None:
        # a corner arc of 1 m is too short for a crossing; the centre circle crosses the halfway line at right angles
        crossings = [c for c in field.crossings if not c.curved or c.kind is CrossingKind.X]
        landmarks = _landmarks(field)
        self.crossing_count = len(crossings)
        self._landmarks = [(kind, colors) for kind, colors, _, _ in landmarks]
        self._of_landmark: dict[tuple[str, Colors], Association] = {}
        places = [(c.x, c.y) for c in crossings] + [(x, y) for _, _, x, y in landmarks]
        self._of_kind = {kind: np.array([i for i, c in enumerate(crossings) if c.kind is kind], np.int64)
                         for kind in CrossingKind}  # fmt: skip
        orientations = np.array([c.orientation_rad for c in crossings])
        corners, tees = self._of_kind[CrossingKind.L], self._of_kind[CrossingKind.T]
        sets = [
            *(corners[_quarter(orientations[corners], 0.0) == k] for k in range(QUARTERS)),
            corners,
            *(tees[_quarter(orientations[tees], -0.25 * math.pi) == k] for k in range(QUARTERS)),
            tees,
        ]
        self.tables = _tables(np.array(places, dtype=np.float64).reshape(-1, 2), sets, field)

    def of_crossing(self, kind: str, oriented: bool) -> Association:
        """The sets of a crossing. oriented: by its orientation, which is known, too; else by position alone."""
        first = {CrossingKind.L.value: 0, CrossingKind.T.value: QUARTERS + 1}.get(kind)
        if first is None:  # X: the most likely one of each particle, equation (4)
            return Association(NO_PLACE, 1, 0.0, self._of_kind[CrossingKind(kind)])
        turn_rad = 0.0 if first == 0 else -0.25 * math.pi
        if not oriented:
            return Association(first + QUARTERS, 1, 0.0, _NOTHING.candidates)
        return Association(first, QUARTERS, turn_rad, _NOTHING.candidates)

    def of_landmark(self, kind: str, colors: Colors) -> Association:
        """All landmarks of that kind, and of those colours where they are known."""
        if (kind, colors) not in self._of_landmark:
            same = [i for i, (k, c) in enumerate(self._landmarks) if k == kind and (not colors or not c or c == colors)]
            places = np.array(same, np.int64) + self.crossing_count
            self._of_landmark[kind, colors] = Association(NO_PLACE, 1, 0.0, places)
        return self._of_landmark[kind, colors]

    @property
    def tell_ends_apart(self) -> bool:
        """Whether a landmark's colours tell the two ends of a field apart whose lines don't."""
        return self.tells_ends_apart([kind.value for kind in LandmarkKind])

    def tells_ends_apart(self, kinds: Collection[str]) -> bool:
        """The same of landmarks of these kinds alone."""
        places = self.tables.places_m[self.crossing_count :]
        for (kind, colors), place in zip(self._landmarks, places, strict=True):
            across = np.hypot(*(places + place).T)
            same = [k == kind and c == colors for k, c in self._landmarks]
            if kind in kinds and not np.any((across < CELL_M) & np.array(same)):
                return True
        return False


def _landmarks(field: FieldModel) -> list[tuple[str, Colors, float, float]]:
    """Kind, colours from the ground up and place of each."""
    kinds = {"goal": LandmarkKind.POST.value, "pole": LandmarkKind.POLE.value}
    found: list[tuple[str, Colors, float, float]] = [
        (kinds[post.kind], post.colors_from_ground, post.x, post.y) for post in field.posts
    ]
    found += [
        (LandmarkKind.GOAL.value, (goal.color,), goal.x, float(np.mean(goal.y_posts)))
        for goal in field.goals
        if goal.y_posts
    ]
    marks = [(float(x), float(y)) for x, y, _ in field.discs if math.hypot(x, y) > CELL_M]
    found += [(LandmarkKind.PENALTY_MARK.value, (), x, y) for x, y in marks]
    found += [(LandmarkKind.CIRCLE.value, (), float(x), float(y)) for x, y, _ in field.circles]
    return found


def _quarter(orientations_rad: FloatArray, turn_rad: float) -> IntArray:
    return np.floor((orientations_rad - turn_rad) / (0.5 * math.pi) + 1e-9).astype(np.int64) % QUARTERS


def _tables(places: FloatArray, sets: list[IntArray], field: FieldModel) -> AssociationTables:
    half_x, half_y = 0.5 * field.length + BEYOND_M, 0.5 * field.width + BEYOND_M
    x = np.arange(-half_x, half_x + CELL_M, CELL_M)
    y = np.arange(-half_y, half_y + CELL_M, CELL_M)
    nearest = np.full((len(sets), len(y), len(x)), NO_PLACE, dtype=np.int16)
    for table, members in zip(nearest, sets, strict=True):
        if len(members):
            squares = (x[:, np.newaxis] - places[members, 0]) ** 2  # (nx, C)
            squares = squares + (y[:, np.newaxis, np.newaxis] - places[members, 1]) ** 2
            table[:] = members[np.argmin(squares, axis=2)]
    return AssociationTables(places, nearest, float(x[0]), float(y[0]))
