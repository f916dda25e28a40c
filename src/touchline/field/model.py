"""A marked field: its paint as centre lines, its goals and poles, and what follows from them."""

import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from touchline.errors import InputError
from touchline.field.crossings import Crossing, find_crossings
from touchline.field.distance_map import DistanceMap
from touchline.field.distances import (
    LineTables,
    arc_sweep,
    arc_table,
    distances_to_lines,
    sample_distances,
    segment_table,
)
from touchline.files.new import write_new_file
from touchline.geometry import FloatArray, pairs_of
from touchline.messages import length_unit

MAX_M = 200.0  # of a field's sides: a football field for people has 120
_MAX_LINE_M = 1.0
MAX_LINES = 1_000  # of each kind: the crossings of all pairs are looked for
MAX_MAP_MB = 500
_SAMPLE_BYTES = 12
COLUMNS = {"segments": 4, "circles": 3, "arcs": 5, "discs": 3}
_CARPET, _PAINT, _NET = "#2c7c3a", "#f8f8f8", "#54924f"  # of a picture
_YAML_HEADER = """\
# A marked field. Origin at the centre mark, x along the length towards the opponent goal, y left; metres, radians.
# length and width reach to the outer edge of the lines; the rows are centre lines: segments x1, y1, x2, y2;
# circles cx, cy, radius; arcs cx, cy, radius, start, end (counter-clockwise); discs cx, cy, diameter of a filled mark.
"""


@dataclass(frozen=True, slots=True)
class Goal:
    """A goal: x of the middles of its posts, y of each, sizes in m; post_shape is round or square."""

    x: float
    y_posts: tuple[float, ...]
    post_width: float
    post_shape: str
    height: float
    depth: float
    color: str


@dataclass(frozen=True, slots=True)
class Pole:
    """A pole beside the field: position and sizes in m, colours of its equal bands from the ground up."""

    x: float
    y: float
    diameter: float
    height: float
    bands_from_ground: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Post:
    """Something upright that a robot can see: a goal post or a pole. Position, diameter and height in m."""

    kind: str
    x: float
    y: float
    diameter: float
    height: float
    colors_from_ground: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class FieldModel:
    """A marked field. Field frame: origin at the centre mark, x to the opponent goal, y left; m and rad.

    length, width: to the outer edge of the lines. border: carpet beyond that edge.
    segments (S, 4): x1, y1, x2, y2; circles (C, 3): cx, cy, radius; arcs (A, 5): cx, cy, radius, start, end, from
    start counter-clockwise to end; discs (D, 3): cx, cy, diameter of a filled mark. All float64, all centre lines:
    the paint is line_width wide and reaches half of it beyond both ends. Treat the arrays as read-only.
    letters: the rulebook letters (m) it was built from, if known; they and the description are no part of equality.
    Raises InputError for sizes and shapes that are no field.
    """

    name: str
    length: float
    width: float
    line_width: float
    border: float = 1.0
    segments: FloatArray = field(default_factory=lambda: np.zeros((0, 4)))
    circles: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    arcs: FloatArray = field(default_factory=lambda: np.zeros((0, 5)))
    discs: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    goals: Sequence[Goal] = ()
    poles: Sequence[Pole] = ()
    description: str = ""
    letters: Mapping[str, float] = field(default_factory=dict)
    _maps: dict[tuple[float, float], DistanceMap] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        for key in ("length", "width", "line_width", "border"):
            value = float(getattr(self, key))
            if not math.isfinite(value) or value < 0.0 or (value == 0.0 and key != "border"):
                raise InputError(f"{key}: expected a positive number of metres, found {getattr(self, key)!r}")
            longest_m = _MAX_LINE_M if key == "line_width" else MAX_M
            if value > longest_m:
                unit = length_unit(value, 0.3 * longest_m)
                raise InputError(
                    f"{key}: {value:g} m is more than any field has ({longest_m:g} m at most); it looks like {unit}"
                )
            object.__setattr__(self, key, value)
        for key, columns in COLUMNS.items():
            object.__setattr__(self, key, _checked_rows(key, getattr(self, key), columns))
        object.__setattr__(self, "goals", tuple(self.goals))
        object.__setattr__(self, "poles", tuple(self.poles))
        _check_places("goals", self.goals)
        _check_places("poles", self.poles)
        if len(self.segments) + len(self.circles) + len(self.arcs) == 0:
            raise InputError("segments, circles, arcs: a field needs at least one line")

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, FieldModel):
            return NotImplemented
        plain = ("name", "length", "width", "line_width", "border", "goals", "poles")
        return all(getattr(self, key) == getattr(other, key) for key in plain) and all(
            np.array_equal(getattr(self, key), getattr(other, key)) for key in COLUMNS
        )

    def __hash__(self) -> int:
        return hash((self.name, self.length, self.width, self.line_width))

    def __repr__(self) -> str:
        lines = len(self.segments) + len(self.circles) + len(self.arcs)
        return (
            f"FieldModel({self.name}: {self.length:g} × {self.width:g} m, {lines} lines {self.line_width:g} m wide, "
            f"{len(self.discs)} marks, {len(self.posts)} posts and poles)"
        )

    def _repr_svg_(self) -> str:
        """The field from above, as a notebook shows it."""
        return self.svg()

    def svg(self, width_px: int = 640, marks: str = "") -> str:
        """The field from above as SVG: lines, marks, goals and posts; x to the right, y up, metres within.

        marks: SVG that is drawn on top.
        """
        beyond = max([self.border, *(goal.depth + 0.1 for goal in self.goals)])
        length, width = self.length + 2.0 * beyond, self.width + 2.0 * beyond
        paths = " ".join("M" + " ".join(f"{x:.3f},{y:.3f}" for x, y in line) for line in self.polylines(0.1))
        discs = "".join(
            f'<circle cx="{x:.3f}" cy="{y:.3f}" r="{d / 2:.3f}" fill="{_PAINT}"/>' for x, y, d in self.discs
        )
        nets = "".join(
            f'<rect x="{min(goal.x, goal.x + (goal.depth if goal.x > 0 else -goal.depth)):.3f}" '
            f'y="{min(goal.y_posts):.3f}" width="{goal.depth:.3f}" '
            f'height="{max(goal.y_posts) - min(goal.y_posts):.3f}" fill="{_NET}"/>'
            for goal in self.goals
        )
        posts = "".join(
            f'<circle cx="{post.x:.3f}" cy="{post.y:.3f}" r="{max(post.diameter, 0.1) / 2:.3f}" fill="#111" '
            f'stroke="{html.escape(post.colors_from_ground[0], quote=True)}" stroke-width="0.04"/>'
            for post in self.posts
        )
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width_px}" style="max-width:100%" '
            f'viewBox="{-length / 2:.3f} {-width / 2:.3f} {length:.3f} {width:.3f}"><g transform="scale(1,-1)">'
            f'<rect x="{-length / 2:.3f}" y="{-width / 2:.3f}" width="{length:.3f}" height="{width:.3f}" '
            f'fill="{_CARPET}"/>{nets}<path d="{paths}" fill="none" stroke="{_PAINT}" '
            f'stroke-width="{self.line_width:g}" stroke-linecap="square"/>{discs}{posts}{marks}</g></svg>'
        )

    @cached_property
    def line_tables(self) -> LineTables:
        """The lines for the loops of `touchline.field.distances`."""
        return LineTables(segment_table(self.segments), arc_table(self.circles, self.arcs))

    @cached_property
    def crossings(self) -> tuple[Crossing, ...]:
        """Where lines meet, typed L, T and X with orientation; see `touchline.field.crossings`."""
        return find_crossings(self.segments, self.circles, self.arcs, self.line_width)

    @cached_property
    def is_symmetric(self) -> bool:
        """Whether the lines look the same after half a turn about the centre mark, so that each pose has a twin."""
        turned = -np.concatenate(self.polylines(0.1))
        return bool(np.all(self.line_distances(turned) < 1e-5))

    @cached_property
    def posts(self) -> tuple[Post, ...]:
        """Goal posts, then poles."""
        of_goals = [
            Post("goal", goal.x, y, goal.post_width, goal.height, (goal.color,))
            for goal in self.goals
            for y in goal.y_posts
        ]
        of_poles = [Post("pole", p.x, p.y, p.diameter, p.height, p.bands_from_ground) for p in self.poles]
        return (*of_goals, *of_poles)

    def polylines(self, step_m: float = 0.05) -> list[FloatArray]:
        """Centre lines as polylines (M, 2) in m, field frame, for plots and for projection into images.

        One each for segments, circles (closed) and arcs, in this order; neighbouring points are at most step_m apart.
        """
        lines: list[FloatArray] = []
        for x1, y1, x2, y2 in self.segments:
            steps = max(1, math.ceil(math.hypot(x2 - x1, y2 - y1) / step_m))
            lines.append(np.linspace((x1, y1), (x2, y2), steps + 1))
        turns = [(cx, cy, radius, 0.0, 2.0 * math.pi) for cx, cy, radius in self.circles]
        turns += [(cx, cy, radius, start, arc_sweep(start, end)) for cx, cy, radius, start, end in self.arcs]
        for cx, cy, radius, start, sweep in turns:
            angles = start + np.linspace(0.0, sweep, max(8, math.ceil(radius * sweep / step_m)) + 1)
            lines.append(np.column_stack((cx + radius * np.cos(angles), cy + radius * np.sin(angles))))
        return lines

    def to_yaml(self, path: Path) -> None:
        """Write a field.yaml that loads as an equal field. Raises InputError where a file is already, or cannot be."""
        write_new_file(path, field_to_text(self).encode())

    def line_distances(self, points: npt.ArrayLike) -> FloatArray:
        """Exact distances (N,) in m of points (N, 2) in m, field frame, to the nearest line centre.

        Filled marks are no lines. NaN points have NaN distances. Raises ValueError for another shape.
        """
        return distances_to_lines(self.line_tables, pairs_of(points))

    def distance_map(self, resolution_m: float = 0.025, margin_m: float = 3.0) -> DistanceMap:
        """Distance to the nearest line and its gradient on a grid that reaches margin_m beyond length and width.

        The grid is centred on the centre mark, so that the map of a symmetric field is symmetric. Each sample is
        computed from the geometry, not from a raster. The same arguments return the same map again.
        Raises InputError for a resolution or margin that makes no map.
        """
        key = (float(resolution_m), float(margin_m))
        if key not in self._maps:
            self._maps[key] = self._sample_map(*key)
        return self._maps[key]

    def _sample_map(self, resolution_m: float, margin_m: float) -> DistanceMap:
        if not (math.isfinite(resolution_m) and resolution_m > 0.0):
            raise InputError(f"distance map: expected a positive resolution in metres, found {resolution_m}")
        if not (math.isfinite(margin_m) and margin_m >= 0.0):
            raise InputError(f"distance map: expected a margin of zero or more metres, found {margin_m}")
        half_x, half_y = 0.5 * self.length + margin_m, 0.5 * self.width + margin_m
        megabytes = _SAMPLE_BYTES * 1e-6 * (2.0 * half_x / resolution_m + 3.0) * (2.0 * half_y / resolution_m + 3.0)
        if megabytes > MAX_MAP_MB:
            raise InputError(
                f"distance map: {resolution_m} m is too fine for a field of {self.length} x {self.width} m: the map "
                f"would have {megabytes:.3g} MB, and {MAX_MAP_MB} MB are the most"
            )
        steps_x, steps_y = (math.ceil(half / resolution_m - 1e-9) for half in (half_x, half_y))
        origin = np.array([-steps_x * resolution_m, -steps_y * resolution_m])
        values = np.empty((2 * steps_y + 1, 2 * steps_x + 1, 3), dtype=np.float32)
        sample_distances(self.line_tables, origin[0], origin[1], resolution_m, values)
        return DistanceMap(values, origin, resolution_m)


def field_to_text(field: FieldModel) -> str:
    """The text of a field.yaml that loads as an equal field."""
    tree: dict[str, Any] = {"name": field.name}
    if field.description:
        tree["description"] = field.description
    for key in ("length", "width", "line_width", "border"):
        tree[key] = getattr(field, key)
    if field.letters:
        tree["letters"] = dict(field.letters)
    for key in ("segments", "circles", "arcs", "discs"):
        tree[key] = getattr(field, key).tolist()
    tree["goals"] = [{**asdict(goal), "y_posts": list(goal.y_posts)} for goal in field.goals]
    tree["poles"] = [{**asdict(pole), "bands_from_ground": list(pole.bands_from_ground)} for pole in field.poles]
    return _YAML_HEADER + yaml.safe_dump(tree, sort_keys=False, default_flow_style=None, allow_unicode=True, width=120)


def _check_places(key: str, posts: Sequence[Goal | Pole]) -> None:
    """Raises InputError for a goal or pole that can't stand at a field."""
    if len(posts) > MAX_LINES:
        raise InputError(f"{key}: {len(posts)} rows are too many; {MAX_LINES} are the most")
    for number, post in enumerate(posts, start=1):
        for name, value in asdict(post).items():
            metres = [value] if isinstance(value, int | float) else value if name == "y_posts" else []
            if any(not abs(number_m) <= MAX_M for number_m in metres):
                raise InputError(f"{key}, row {number}: {name} is too far; a field has {MAX_M:g} m at most")


def _checked_rows(key: str, rows: npt.ArrayLike, columns: int) -> FloatArray:
    """The rows as float64 (N, columns); InputError names the row that is no line."""
    table = np.array(rows, dtype=np.float64)
    if table.size == 0:
        table = np.zeros((0, columns))
    if table.ndim != 2 or table.shape[1] != columns:
        raise InputError(f"{key}: expected rows of {columns} numbers, found the shape {table.shape}")
    if len(table) > MAX_LINES:
        raise InputError(f"{key}: {len(table)} rows are too many; {MAX_LINES} are the most")
    for number, row in enumerate(table, start=1):
        if not np.all(np.isfinite(row)):
            raise InputError(f"{key}, row {number}: holds a value that is not finite")
        metres = row[:3] if key == "arcs" else row
        if np.abs(metres).max() > MAX_M:
            what = f"{metres[np.abs(metres).argmax()]:g} m is too far; a field has {MAX_M:g} m at most"
            raise InputError(f"{key}, row {number}: {what}")
        if key == "segments" and np.array_equal(row[:2], row[2:]):
            raise InputError(f"{key}, row {number}: both ends are the same point")
        if key != "segments" and row[2] <= 0.0:
            raise InputError(f"{key}, row {number}: the {'diameter' if key == 'discs' else 'radius'} is not positive")
        if key == "arcs" and row[3] == row[4]:
            raise InputError(f"{key}, row {number}: start and end are the same angle")
    return table
