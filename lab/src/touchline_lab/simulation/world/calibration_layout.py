"""What lies on the ground for a calibration, and what is known of it: marks, points with names, coloured regions."""

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from touchline.geometry import FloatArray, Pose
from touchline_lab.simulation.world.world import PAINTS, GroundMark

STRIP_EDGES_M = (0.6, 0.73, 0.86, 1.01, 1.17, 1.35, 1.55, 1.79, 2.06, 2.38, 2.78, 3.3, 3.98, 4.97, 6.5)
_STRIP_HALF_WIDTH_M = 0.2
_CLASSES = ("green", "white", "black", "blue", "yellow", "orange", "magenta", "cyan")
_SQUARES, _SQUARE_M = (8, 6), 0.12


@dataclass(frozen=True, eq=False)
class Layout:
    """marks: painted on the ground. points: name to (2,) field position (m). known: whether marks.csv may tell them.

    regions: class and polygon (K, 2), field frame. sequence: additions to sequence.yaml.
    strip_heading_rad: direction of the strip in the field, None without one.
    """

    marks: tuple[GroundMark, ...] = ()
    points: Mapping[str, FloatArray] = field(default_factory=dict)
    known: bool = True
    regions: tuple[tuple[str, FloatArray], ...] = ()
    sequence: Mapping[str, Any] = field(default_factory=dict)
    strip_heading_rad: float | None = None


def make_layout(kind: str, regions: bool, start: Pose) -> Layout:
    """The layout of a calibration kind beside a robot that starts at `start`."""
    makers = {"strip": _strip, "fixed-marks": _fixed_marks, "chessboard": _chessboard, "marked-points": _marked_points}
    layout = makers[kind](start) if kind in makers else Layout()
    return _with_regions(layout, start) if regions else layout


def _strip(start: Pose) -> Layout:
    """Rectangles of black and white along the ray from the robot that runs parallel to the field's x axis."""
    heading = 0.0 if start.x <= 0.0 else math.pi  # towards the longer way
    edges = STRIP_EDGES_M
    marks, colours = [], []
    for index, (near, far) in enumerate(itertools.pairwise(edges)):
        colour = ("black", "white")[index % 2]
        middle = 0.5 * (near + far)
        x, y = start.x + middle * math.cos(heading), start.y + middle * math.sin(heading)
        marks.append(GroundMark(x, y, heading, far - near, 2.0 * _STRIP_HALF_WIDTH_M, PAINTS[colour]))
        colours.append(colour)
    sequence = {
        "patch_edges_m": list(edges),
        "patch_colors": colours,
        "patch_half_width_m": _STRIP_HALF_WIDTH_M,
        "patch_note": "edges are distances from the robot's base origin; colour i lies between edges i and i + 1",
    }
    return Layout(tuple(marks), sequence=sequence, strip_heading_rad=heading)


def _fixed_marks(start: Pose) -> Layout:
    """Four small marks before the robot, whose places nobody has measured."""
    places = {"near-left": (1.5, 0.45), "near-right": (1.5, -0.45), "far-left": (2.8, 0.9), "far-right": (2.8, -0.9)}
    points = {name: start.transform(np.array(place)) for name, place in places.items()}
    marks = tuple(_square(point, start.heading, 0.1, "orange") for point in points.values())
    return Layout(marks, points, known=False)


def _chessboard(start: Pose) -> Layout:
    """A board of dark and light squares in the middle of the field, with a white margin; its inner corners."""
    columns, rows = _SQUARES
    marks = [GroundMark(0.0, 0.0, 0.0, (columns + 1) * _SQUARE_M, (rows + 1) * _SQUARE_M, PAINTS["white"])]
    for column in range(columns):
        for row in range(rows):
            if (column + row) % 2 == 0:
                place = np.array([(column - 0.5 * (columns - 1)) * _SQUARE_M, (row - 0.5 * (rows - 1)) * _SQUARE_M])
                marks.append(_square(place, 0.0, _SQUARE_M, "black"))
    points = {
        f"corner-{column}-{row}": np.array([(column - 0.5 * columns) * _SQUARE_M, (row - 0.5 * rows) * _SQUARE_M])
        for column in range(1, columns)
        for row in range(1, rows)
    }
    sequence = {"chessboard": {"inner_corners": [columns - 1, rows - 1], "square_m": _SQUARE_M}}
    return Layout(tuple(marks), points, sequence=sequence)


def _marked_points(start: Pose) -> Layout:
    """White squares around the robot in eight directions, from 0.8 to 5 m."""
    points: dict[str, FloatArray] = {}
    for index, range_m in enumerate((0.8, 1.2, 1.7, 2.3, 3.0, 4.0, 5.0)):
        for step in range(8):
            bearing = math.pi / 4 * step + (math.pi / 8 if index % 2 else 0.0)
            place = np.array([range_m * math.cos(bearing), range_m * math.sin(bearing)])
            points[f"{range_m:g}m-{round(math.degrees(bearing))}deg"] = start.transform(place)
    marks = tuple(_square(point, start.heading, 0.08, "black") for point in points.values())
    return Layout(marks, points)


def _with_regions(layout: Layout, start: Pose) -> Layout:
    """A ring of coloured squares, one for each class of regions.yaml, and the polygons that lie inside them."""
    marks, regions = [], []
    for index, name in enumerate(_CLASSES):
        bearing = 2.0 * math.pi / len(_CLASSES) * index + math.pi / 16
        place = start.transform(np.array([1.45 * math.cos(bearing), 1.45 * math.sin(bearing)]))
        if name != "green":  # that is the carpet itself
            marks.append(_square(place, start.heading, 0.34, name))
        corners = np.array([(-0.12, -0.12), (0.12, -0.12), (0.12, 0.12), (-0.12, 0.12)])
        regions.append((name, Pose(place[0], place[1], start.heading).transform(corners)))
    return Layout((*layout.marks, *marks), layout.points, layout.known, tuple(regions), layout.sequence)


def _square(place: FloatArray, heading: float, side: float, colour: str) -> GroundMark:
    return GroundMark(float(place[0]), float(place[1]), heading, side, side, PAINTS[colour])
