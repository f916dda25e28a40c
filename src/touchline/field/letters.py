"""A field from the letters of the Middle Size League's rulebook (version 24.1, 2023, law 1): A to Q, in metres.

All sizes include the lines: they reach to the outer edge. A letter of zero leaves its part out.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from touchline.errors import InputError
from touchline.field.catalogue import open_field
from touchline.field.model import FieldModel, Goal

LETTERS: Mapping[str, str] = {
    "A": "field length",
    "B": "field width",
    "C": "penalty area width",
    "D": "goal area width",
    "E": "penalty area depth",
    "F": "goal area depth",
    "G": "corner arc radius",
    "H": "centre circle diameter",
    "I": "penalty mark: its middle from the goal line's outer edge",
    "J": "diameter of the marks",
    "K": "line width",
    "L": "border: carpet beyond the lines",
    "M": "technical area, first size of four (draws nothing)",
    "N": "technical area, second size (draws nothing)",
    "O": "technical area, third size (draws nothing)",
    "P": "technical area, fourth size (draws nothing)",
    "Q": "restart spots, off-centre distance (draws nothing: they are no lines)",
}
_NEEDED = ("A", "B", "K")
# What a size measured to the middle of the lines grows by, in line widths, when measured to their outer edge.
_FROM_MIDDLE = {"A": 1.0, "B": 1.0, "C": 1.0, "D": 1.0, "E": 1.0, "F": 1.0, "G": 1.0, "H": 1.0, "I": 0.5, "L": -0.5}


def field_from_letters(
    name: str,
    letters: Mapping[str, float],
    base: str | Path | FieldModel = "msl-22x14",
    measured_to: Literal["edge", "middle"] = "edge",
    goal_width_m: float | None = None,
) -> FieldModel:
    """A field from rulebook letters (m); those not given are the base's, as are goals and poles, moved with the edge.

    measured_to: what the letters given here reach to, the outer edge of the lines as in the rules or their middle; the
    radius G of a corner arc is then how far it reaches along the lines. The field's own letters are to the edge.
    goal_width_m: between the insides of a goal's posts, which no letter names; None: as the base's.
    Raises InputError for an unknown letter, a size that is no length, parts that do not fit into each other, and a
    base whose letters are not known.
    """
    origin = open_field(base)
    if not origin.letters:
        raise InputError(f"{origin.name}: has no rulebook letters to start from; use a preset as the base")
    given = {key: _length(key, value) for key, value in letters.items()}
    if measured_to == "middle":
        line = given.get("K", origin.line_width)
        for key in given.keys() & _FROM_MIDDLE.keys():
            given[key] = round(max(given[key] + _FROM_MIDDLE[key] * line, 0.0), 9) if given[key] > 0.0 else 0.0
    values = {**origin.letters, **given}
    for key in _NEEDED:
        if values.get(key, 0.0) <= 0.0:
            raise InputError(f"letter {key}, the {LETTERS[key]}: must be positive")
    size = {key: values.get(key, 0.0) for key in LETTERS}
    _check_fit(size)
    shift_x, shift_y = 0.5 * (size["A"] - origin.length), 0.5 * (size["B"] - origin.width)
    goals = [replace(_of_width(goal, goal_width_m), x=_moved(goal.x, shift_x)) for goal in origin.goals]
    for goal in goals:
        if max(map(abs, goal.y_posts)) + 0.5 * goal.post_width > 0.5 * size["B"]:
            raise InputError(f"letter B, the field width of {size['B']:g} m: the goal of {origin.name} does not fit")
    poles = [replace(pole, x=_moved(pole.x, shift_x), y=_moved(pole.y, shift_y)) for pole in origin.poles]
    return FieldModel(
        name=name,
        length=size["A"],
        width=size["B"],
        line_width=size["K"],
        border=size["L"],
        goals=goals,
        poles=poles,
        letters=values,
        **_paint(size),
    )


def _of_width(goal: Goal, inside_m: float | None) -> Goal:
    """A goal as wide between its posts as given; one of other than two posts, and None, leave it as it is."""
    if inside_m is None or len(goal.y_posts) != 2:
        return goal
    if not (math.isfinite(inside_m) and inside_m > 0.0):
        raise InputError(f"goal width: expected a positive number of metres, found {inside_m!r}")
    half = round(0.5 * (inside_m + goal.post_width), 9)
    return replace(goal, y_posts=(-half, half))


def _moved(coordinate: float, outwards: float) -> float:
    """A coordinate moved away from the field's axis; one on the axis stays there."""
    return round(coordinate + math.copysign(1.0, coordinate) * outwards, 9) if coordinate else 0.0


def _length(key: str, value: float) -> float:
    if key not in LETTERS:
        raise InputError(f"letter {key}: is not one of the rulebook's, A to Q")
    if not math.isfinite(value) or value < 0.0:
        raise InputError(f"letter {key}, the {LETTERS[key]}: expected metres, found {value!r}")
    return float(value)


def _check_fit(size: Mapping[str, float]) -> None:
    """Refuse parts that do not fit into each other; each check leaves green between two lines."""
    for one, other, part in (("C", "E", "penalty area"), ("D", "F", "goal area")):
        if (size[one] > 0.0) != (size[other] > 0.0):
            raise InputError(f"letters {one}, {other}: a {part} needs both its width and its depth, or neither")
    line = size["K"]
    rules = (  # smaller side: letter, its extent; larger side: letter, its extent
        ("K", 3.0 * line, "A", size["A"]),
        ("K", 3.0 * line, "B", size["B"]),
        ("K", 2.0 * line, "C", size["C"]),
        ("K", line, "E", size["E"]),
        ("K", 2.0 * line, "D", size["D"]),
        ("K", line, "F", size["F"]),
        ("K", line, "G", size["G"]),
        ("K", 2.0 * line, "H", size["H"]),
        ("C", size["C"] + 2.0 * line, "B", size["B"]),
        ("E", 2.0 * size["E"] + line, "A", size["A"]),
        ("D", size["D"] + 2.0 * line, "C", size["C"]),
        ("F", size["F"] + line, "E", size["E"]),
        ("D", size["D"] + 2.0 * line, "B", size["B"]),
        ("F", 2.0 * size["F"] + line, "A", size["A"]),
        ("H", size["H"] + 2.0 * line, "B", size["B"]),
        ("H", size["H"] + 2.0 * line, "A", size["A"]),
        ("G", 2.0 * size["G"], "B", size["B"]),
        ("G", 2.0 * size["G"], "A", size["A"]),
        ("I", 2.0 * size["I"], "A", size["A"]),
    )
    for small, needed, large, available in rules:
        if size[small] > 0.0 and size[large] > 0.0 and needed >= available:
            raise InputError(
                f"letters {small}, {large}: the {_short(small)} of {size[small]:g} m does not fit into "
                f"the {_short(large)} of {size[large]:g} m"
            )


def _short(key: str) -> str:
    return LETTERS[key].partition(",")[0].partition(":")[0]


def _paint(size: Mapping[str, float]) -> dict[str, Any]:
    """Centre lines of the paint: rows of segments, circles, arcs and discs."""
    half = 0.5 * size["K"]
    x, y = 0.5 * size["A"] - half, 0.5 * size["B"] - half
    segments = [[-x, y, x, y], [-x, -y, x, -y], [x, -y, x, y], [-x, -y, -x, y], [0.0, -y, 0.0, y]]
    for width, depth in (("C", "E"), ("D", "F")):
        if size[width] > 0.0:
            front, side = 0.5 * size["A"] - size[depth] + half, 0.5 * size[width] - half
            for s in (1.0, -1.0):
                segments.append([s * front, -side, s * front, side])
                segments += [[s * front, -side, s * x, -side], [s * front, side, s * x, side]]
    circles = [[0.0, 0.0, 0.5 * size["H"] - half]] if size["H"] > 0.0 else []
    corners = ((1.0, 1.0, 2), (-1.0, 1.0, 3), (-1.0, -1.0, 0), (1.0, -1.0, 1))  # signs of x, y; first quarter turn
    arcs = [
        [
            sx * 0.5 * size["A"],
            sy * 0.5 * size["B"],
            size["G"] - half,
            quarter * math.pi / 2,
            (quarter + 1) * math.pi / 2,
        ]
        for sx, sy, quarter in corners
        if size["G"] > 0.0
    ]
    discs = [[0.0, 0.0, size["J"]]] if size["J"] > 0.0 else []
    if size["I"] > 0.0 and discs:
        discs += [[s * (0.5 * size["A"] - size["I"]), 0.0, size["J"]] for s in (1.0, -1.0)]
    paint = {"segments": segments, "circles": circles, "arcs": arcs, "discs": discs}
    # Rounded to a nanometre: 0.5 * 4.05 - 0.025 is 2.0 on the field and should be in the file.
    return {key: np.round(np.array(rows, dtype=np.float64), 9) for key, rows in paint.items() if rows}
