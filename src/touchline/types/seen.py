"""What was seen in one frame: line points, lines, crossings, landmarks, and all of them as one observation.

Everything is in the robot frame: x forward, y left, metres. Arrays are not copied: treat them as read-only.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cache
from itertools import compress
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
from numba import njit
from typing_extensions import Self

from touchline.enums import StrEnum
from touchline.errors import InputError
from touchline.geometry import BoolArray, FloatArray
from touchline.given import refused
from touchline.messages import counted

KindArray = npt.NDArray[np.str_]
Colors = tuple[str, ...]
"""From the ground up; empty where not known."""

MAX_OBSERVED_POINTS = 10_000_000
"""The most line points of one observation."""


@dataclass(frozen=True, eq=False, slots=True)
class _Seen:
    """What all things seen have in common: arrays with a row for each.

    SHAPES: of each array behind its (N,). KINDS: which ones there are.
    """

    NAME: ClassVar[str]
    SHAPES: ClassVar[Mapping[str, tuple[int, ...]]]
    KINDS: ClassVar[Mapping[str, Any]] = {}

    def __post_init__(self) -> None:
        count, wrong = (len(self),), []
        for name, rest in self.SHAPES.items():
            shape = getattr(self, name).shape
            if shape != count + rest:
                wrong.append(f"{name} {count + rest}, got {shape}")
        if wrong:
            raise ValueError(f"{self.NAME} need {'; '.join(wrong)}")
        unknown = set(getattr(self, "kinds", _ALL).tolist()).difference(self.KINDS) if self.KINDS else ()
        if unknown:
            known = ", ".join(self.KINDS)
            raise ValueError(f"{self.NAME} are of the kinds {known}, not {', '.join(sorted(map(str, unknown)))}")

    def __len__(self) -> int:
        return len(self.positions_m)  # type: ignore[attr-defined]

    def rows(self, kept: BoolArray) -> Self:
        """The rows of a mask (N,) alone; itself if that is all."""
        if kept is _ALL or kept.all():
            return self
        rows: dict[str, Any] = {}
        for each in fields(self):
            column = getattr(self, each.name)
            rows[each.name] = column[kept] if isinstance(column, np.ndarray) else tuple(compress(column, kept))
        return replace(self, **rows)

    def usable(self, max_range_m: float = math.inf) -> Self:
        """Those that are measurements: finite, no negative confidence or variance, within max_range_m."""
        places: Any = self
        return self.rows(_measured(places.positions_m, places.covariances_m2, places.confidences, max_range_m))

    @classmethod
    def none(cls) -> Self:
        """Nothing seen."""
        return _none(cls)  # type: ignore[arg-type]

    @classmethod
    def joined(cls, tables: Sequence[Self]) -> Self:
        """All rows of all tables."""
        tables = [table for table in tables if len(table)] or tables[:1]
        if len(tables) == 1:
            return tables[0]
        columns = ([getattr(table, each.name) for table in tables] for each in fields(cls))
        rows: list[Any] = [sum(c, ()) if isinstance(c[0], tuple) else np.concatenate(c) for c in columns]
        return cls(*rows)


@cache  # nothing can be changed in arrays without elements
def _none(kind: Any) -> Any:
    shapes = {name: np.zeros((0, *rest), np.str_ if name == "kinds" else None) for name, rest in kind.SHAPES.items()}
    return kind(**{each.name: shapes.get(each.name, ()) for each in fields(kind)})


@dataclass(frozen=True, eq=False, slots=True)
class LinePoints(_Seen):
    """Points on white lines; of an observation's `boundary`, points where the field's green ends.

    positions_m: (N, 2) robot frame. covariances_m2: (N, 2, 2) robot frame. confidences: (N,) in 0..1.
    pixels: (N, 2) u, v of where each was seen; NaN where unknown.
    """

    positions_m: FloatArray
    covariances_m2: FloatArray
    confidences: FloatArray
    pixels: FloatArray

    NAME = "line points"
    SHAPES: ClassVar = {"positions_m": (2,), "covariances_m2": (2, 2), "confidences": (), "pixels": (2,)}

    def __post_init__(self) -> None:
        arrays = positions_m, covariances_m2, confidences, pixels = (
            self.positions_m, self.covariances_m2, self.confidences, self.pixels
        )  # fmt: skip
        if type(positions_m) is type(covariances_m2) is type(confidences) is type(pixels) is np.ndarray:
            count, shapes = confidences.size, (positions_m.shape, pixels.shape, confidences.shape, covariances_m2.shape)
            if shapes == ((count, 2), (count, 2), (count,), (count, 2, 2)) and count <= MAX_OBSERVED_POINTS:
                return  # nearly always
        for name, given in zip(self.SHAPES, arrays, strict=True):
            if not isinstance(given, np.ndarray):
                try:
                    object.__setattr__(self, name, np.array(given, dtype=np.float64, ndmin=1))
                except (TypeError, ValueError):
                    raise refused(name, "an array of numbers", given) from None
        check_point_count(len(self))
        _Seen.__post_init__(self)


def _measured(
    positions_m: FloatArray, covariances_m2: FloatArray, confidences: FloatArray, max_range_m: float
) -> BoolArray:
    """Which places (N, 2) are measurements: finite, no negative confidence or variance, within max_range_m; (N,), or
    (1,) where plainly all are.
    """
    columns = [np.ascontiguousarray(each, dtype=np.float64) for each in (positions_m, covariances_m2, confidences)]
    if _all_measured(columns[0], columns[1], columns[2], max_range_m):
        return _ALL
    kept = np.isfinite(positions_m).all(axis=1) & np.isfinite(covariances_m2).all(axis=(1, 2))
    kept &= np.isfinite(confidences) & (confidences >= 0.0)
    kept &= (covariances_m2[:, 0, 0] >= 0.0) & (covariances_m2[:, 1, 1] >= 0.0)
    if max_range_m < math.inf:
        with np.errstate(over="ignore"):
            kept &= np.hypot(positions_m[:, 0], positions_m[:, 1]) <= max_range_m
    return np.asarray(kept)


@njit(cache=True)
def _all_measured(positions_m, covariances_m2, confidences, max_range_m):  # type: ignore[no-untyped-def]
    """Whether all places are measurements; quick, and False where that is not plain: far off."""
    for i in range(len(positions_m)):
        far_m = abs(positions_m[i, 0]) + abs(positions_m[i, 1])
        if not (far_m < math.inf and far_m <= max_range_m and 0.0 <= confidences[i] < math.inf):
            return False
        for a in range(2):
            if not (0.0 <= covariances_m2[i, a, a] < math.inf and abs(covariances_m2[i, a, 1 - a]) < math.inf):
                return False
    return True


_ALL = np.ones(1, dtype=np.bool_)


def check_point_count(count: int) -> int:
    """The count. Raises InputError for more points than one observation can hold."""
    if count > MAX_OBSERVED_POINTS:
        raise InputError(f"{count} points: one observation holds {MAX_OBSERVED_POINTS} at most")
    return count


def _positions(what: str, given: object) -> FloatArray:
    """(N, 2) positions. Raises InputError for what is none."""
    try:
        positions_m = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        positions_m = np.zeros(0)
    if positions_m.ndim != 2 or positions_m.shape[1] != 2:
        raise refused(what, "LinePoints or positions (N, 2) in m", given)
    return positions_m


def generic_covariances(positions_m: FloatArray) -> FloatArray:
    """Covariances (N, 2, 2) of positions (N, 2), robot frame, of which nobody says how precise they are.

    The same in all directions; standard deviation 1 cm and 2 % of the range, as of a usual camera's calibration.
    """
    covariances_m2: FloatArray = _generic(np.ascontiguousarray(positions_m, dtype=np.float64))[0]
    return covariances_m2


@njit(cache=True)
def _generic(positions_m):  # type: ignore[no-untyped-def]
    """`generic_covariances` of positions (N, 2); confidences (N,) and pixels (N, 2) of which nothing is known."""
    covariances_m2 = np.zeros((len(positions_m), 2, 2))
    for i in range(len(positions_m)):
        sigma_m = 0.01 + 0.02 * math.hypot(positions_m[i, 0], positions_m[i, 1])
        covariances_m2[i, 0, 0] = covariances_m2[i, 1, 1] = sigma_m * sigma_m
    return covariances_m2, np.ones(len(positions_m)), np.full(positions_m.shape, np.nan)


def points_at(positions_m: FloatArray) -> LinePoints:
    """Line points of which only the positions (N, 2), robot frame, are known: sure, with `generic_covariances`."""
    return LinePoints(positions_m, *_generic(np.ascontiguousarray(positions_m, dtype=np.float64)))


@dataclass(frozen=True, eq=False, slots=True)
class Lines(_Seen):
    """Visible parts of straight lines.

    ends_m: (N, 2, 2) both ends, robot frame. covariances_m2: (N, 2, 2, 2) of each end.
    confidences: (N,) in 0..1. pixels: (N, 2, 2) u, v of each end; NaN where unknown.
    """

    ends_m: FloatArray
    covariances_m2: FloatArray
    confidences: FloatArray
    pixels: FloatArray

    NAME = "lines"
    SHAPES: ClassVar = {"ends_m": (2, 2), "covariances_m2": (2, 2, 2), "confidences": (), "pixels": (2, 2)}

    def __len__(self) -> int:
        return len(self.ends_m)

    def usable(self, max_range_m: float = math.inf) -> Lines:
        """Those of which both ends are measurements, as `LinePoints.usable` says."""
        both = [
            _measured(self.ends_m[:, end], self.covariances_m2[:, end], self.confidences, max_range_m) for end in (0, 1)
        ]
        return self.rows(both[0] & both[1])


class CrossingKind(StrEnum):
    """How many arms of paint leave a crossing: two, three or four."""

    L = "L"
    T = "T"
    X = "X"


@dataclass(frozen=True, eq=False, slots=True)
class Crossings(_Seen):
    """Where lines meet.

    kinds: (N,) of `CrossingKind`. positions_m: (N, 2) robot frame. orientations_rad: (N,) robot frame, of L the
    bisector into the opening, of T the stem, away from the bar, of X either line modulo pi/2; NaN where unknown.
    covariances_m2: (N, 2, 2). confidences: (N,) in 0..1. pixels: (N, 2) u, v; NaN where unknown.
    """

    kinds: KindArray
    positions_m: FloatArray
    orientations_rad: FloatArray
    covariances_m2: FloatArray
    confidences: FloatArray
    pixels: FloatArray

    NAME = "crossings"
    KINDS = dict.fromkeys(CrossingKind)
    SHAPES: ClassVar = {
        **{"positions_m": (2,), "kinds": (), "orientations_rad": ()},
        **{"covariances_m2": (2, 2), "confidences": (), "pixels": (2,)},
    }

    def usable(self, max_range_m: float = math.inf) -> Crossings:
        """Those that are measurements, as `LinePoints.usable` says."""
        measured = _measured(self.positions_m, self.covariances_m2, self.confidences, max_range_m)
        return self.rows(measured & ~np.isinf(self.orientations_rad))


class LandmarkKind(StrEnum):
    """Things that stand or are painted at one known place of the field."""

    POST = "post"
    POLE = "pole"
    GOAL = "goal"
    PENALTY_MARK = "penalty_mark"
    CIRCLE = "circle"


@dataclass(frozen=True, eq=False, slots=True)
class Landmarks(_Seen):
    """Feet of goal posts and poles, middles of goals, penalty marks and the centre circle.

    kinds: (N,) of `LandmarkKind`. positions_m: (N, 2) robot frame. covariances_m2: (N, 2, 2).
    confidences: (N,) in 0..1. colors: of each from the ground up, empty where not known. pixels: (N, 2) u, v; NaN
    where unknown.
    """

    kinds: KindArray
    positions_m: FloatArray
    covariances_m2: FloatArray
    confidences: FloatArray
    colors: tuple[Colors, ...]
    pixels: FloatArray

    NAME = "landmarks"
    KINDS = dict.fromkeys(LandmarkKind)
    SHAPES: ClassVar = {"positions_m": (2,), "kinds": (), "covariances_m2": (2, 2), "confidences": (), "pixels": (2,)}

    def __post_init__(self) -> None:
        _Seen.__post_init__(self)
        if len(self.colors) != len(self):
            raise ValueError(f"{len(self)} landmarks need as many tuples of colours, got {len(self.colors)}")


@dataclass(frozen=True, eq=False, slots=True)
class Observation:
    """What was seen in one frame, in the robot frame. problem: why nothing could be seen, if so.

    points, boundary: LinePoints, or positions (N, 2) of which nobody says how precise they are.
    Raises InputError for what is neither.
    """

    stamp_ns: int
    points: LinePoints = field(default_factory=LinePoints.none)
    lines: Lines = field(default_factory=Lines.none)
    crossings: Crossings = field(default_factory=Crossings.none)
    landmarks: Landmarks = field(default_factory=Landmarks.none)
    boundary: LinePoints = field(default_factory=LinePoints.none)
    problem: str | None = None

    def __repr__(self) -> str:
        named = ((self.points, "line point"), (self.lines, "line"), (self.crossings, "crossing"))
        seen = [counted(len(of), what) for of, what in (*named, (self.landmarks, "landmark")) if len(of)]
        return f"Observation({self.stamp_ns / 1e9:.3f} s: {self.problem or ', '.join(seen) or 'nothing seen'})"

    def usable(self, max_range_m: float = math.inf) -> Observation:
        """Without points, lines, crossings and landmarks that are no measurements, or farther away than max_range_m."""
        kept: dict[str, Any] = {}
        given = ("points", self.points), ("lines", self.lines), ("crossings", self.crossings)
        for name, seen in (*given, ("landmarks", self.landmarks)):
            if len(seen) and (usable := seen.usable(max_range_m)) is not seen:
                kept[name] = usable
        return replace(self, **kept) if kept else self

    def __post_init__(self) -> None:
        for name, given in (("points", self.points), ("boundary", self.boundary)):
            if not isinstance(given, LinePoints):
                object.__setattr__(self, name, points_at(_positions(name, given)))
