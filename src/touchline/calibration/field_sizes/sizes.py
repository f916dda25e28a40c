"""The sizes of a field that may be other than the rules say, and the field that other sizes make."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from touchline.field import LETTERS, FieldModel, field_from_letters, open_field, preset_names
from touchline.geometry import FloatArray

# letters of sizes that lines show: no line's own width, and no corner arc, which is seen together with its corner
_MEASURED = "ABCDEFH"
_SAME_M = 0.005  # coordinates this near to each other are one size
_STEP_M = 0.001


class Size(NamedTuple):
    """A size: its letter ("" if the field has none), what it is, and its value (m)."""

    letter: str
    meaning: str
    value_m: float


@dataclass(frozen=True, eq=False)
class FieldSizes:
    """The sizes (J,) of a field: its letters, or where lines lie to both sides of the middle, and circles' radii."""

    base: FieldModel
    sizes: tuple[Size, ...]
    lettered: bool

    def field(self, change_m: FloatArray, name: str | None = None) -> FieldModel:
        """The field whose sizes are larger by change_m (J,). Raises InputError if its parts don't fit together."""
        if self.lettered:
            letters = {s.letter: round(s.value_m + float(c), 6) for s, c in zip(self.sizes, change_m, strict=True)}
            made = field_from_letters(name or self.base.name, letters, self.base)
            return replace(made, description=self.base.description)
        return _moved(self.base, self.sizes, change_m, name or self.base.name)


def sizes_of(field: FieldModel) -> FieldSizes:
    """The sizes of a field: its letters, or those of the preset whose lines it has; else its coordinates."""
    for base in (field, *(open_field(name) for name in preset_names())):
        if base.letters and _same_lines(base, field):
            letters = {key: base.letters[key] for key in _MEASURED if base.letters.get(key, 0.0) > 0.0}
            sizes = tuple(Size(key, LETTERS[key], value) for key, value in letters.items())
            found = FieldSizes(replace(field, letters=base.letters), sizes, True)
            if _same_lines(found.field(np.zeros(len(sizes))), field):
                return found
    return FieldSizes(field, tuple(_coordinates(field)), False)


def _same_lines(one: FieldModel, other: FieldModel) -> bool:
    rows = ((one.segments, other.segments), (one.circles, other.circles), (one.arcs, other.arcs))
    return all(a.shape == b.shape and np.allclose(a, b, atol=1e-5) for a, b in rows)


def line_velocities(sizes: FieldSizes, change_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How segments (S, 4) and circles and arcs (R, 3: cx, cy, radius) move with each size: (J, S, 4), (J, R, 3)."""
    segments, rounds = [], []
    for j in range(len(sizes.sizes)):
        step = np.zeros(len(change_m))
        step[j] = _STEP_M
        more, less = sizes.field(change_m + step), sizes.field(change_m - step)
        segments.append((more.segments - less.segments) / (2.0 * _STEP_M))
        rounds.append((round_lines(more) - round_lines(less)) / (2.0 * _STEP_M))
    return np.array(segments), np.array(rounds)


def round_lines(field: FieldModel) -> FloatArray:
    """Circles and arcs (R, 3): cx, cy, radius."""
    return np.concatenate((field.circles, field.arcs[:, :3]))


def _coordinates(field: FieldModel) -> list[Size]:
    """One size for each distance of lines from the middle along x, along y, and for each circle's radius."""
    sizes = []
    ends = np.concatenate((field.segments[:, :2], field.segments[:, 2:]))
    for axis, name in enumerate("xy"):
        for value in _distinct(np.abs(ends[:, axis])):
            sizes.append(Size("", f"between the lines at {name} = ± {value:.2f} m", 2.0 * value))
    for value in _distinct(field.circles[:, 2]):
        sizes.append(Size("", f"diameter of the circle of {value:.2f} m radius", 2.0 * value))
    return sizes


def _distinct(values: FloatArray) -> list[float]:
    kept: list[float] = []
    for value in sorted(values.tolist(), reverse=True):
        if value > _SAME_M and not any(abs(value - other) < _SAME_M for other in kept):
            kept.append(value)
    return kept


def _moved(field: FieldModel, sizes: tuple[Size, ...], change_m: FloatArray, name: str) -> FieldModel:
    """The field with its coordinates and radii moved by half of what its sizes change."""
    halves: dict[str, list[tuple[float, float]]] = {"x": [], "y": [], "r": []}
    for size, change in zip(sizes, change_m, strict=True):
        axis = "r" if size.meaning.startswith("diameter") else size.meaning.split(" at ")[1][0]
        halves[axis].append((0.5 * size.value_m, 0.5 * float(change)))

    def moved(values: FloatArray, axis: str) -> FloatArray:
        out: FloatArray = values.copy()
        for old, half in halves[axis]:
            near = np.abs(np.abs(values) - old) < _SAME_M
            out = np.where(near, values + np.sign(values) * half, out)
        return out

    segments, circles = field.segments.copy(), field.circles.copy()
    for end in (0, 2):
        segments[:, end] = moved(segments[:, end], "x")
        segments[:, end + 1] = moved(segments[:, end + 1], "y")
    circles[:, 2] = moved(circles[:, 2], "r")
    grown = [2.0 * max(halves[axis], default=(0.0, 0.0))[1] for axis in "xy"]
    arcs = field.arcs.copy()
    arcs[:, :2] += np.sign(arcs[:, :2]) * 0.5 * np.array(grown)  # they go with the outermost lines
    shifted = [replace(goal, x=goal.x + float(np.sign(goal.x)) * 0.5 * grown[0]) for goal in field.goals]
    return replace(
        field, name=name, length=field.length + grown[0], width=field.width + grown[1],
        segments=segments, circles=circles, arcs=arcs, goals=shifted, letters={},
    )  # fmt: skip
