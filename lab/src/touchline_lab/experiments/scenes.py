"""What the experiments share: views at the observation level, places, and fields drawn with matplotlib."""

import math
import os
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from touchline import palette
from touchline.camera import OmniCamera, require_omni
from touchline.field import FieldModel, open_field
from touchline.geometry import FloatArray, Pose
from touchline.sources import Recording, open_source
from touchline.types import ImageArray, LinePoints
from touchline_lab.simulation.observation.observed_lines import ObservedLines
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import MotionSettings, open_scenario

FIELD = "msl-18x12"
DATA_VARIABLE = "TOUCHLINE_DATA"  # names the folder of the public recordings
CARPET, PAINT, INK = "#7fae86", "#ffffff", "#20302a"
RED, BLUE, MAGENTA = palette.VERMILLION, palette.BLUE, palette.PURPLE


@cache
def the_camera() -> OmniCamera:
    """The papers' mirror of three parts, as designed."""
    return require_omni(
        Simulation(open_scenario("straight-tracks", changes=["ideal=true"]), level="points").camera, "the papers have"
    )


@cache
def the_views() -> ObservedLines:
    """What is seen through it on the 18 x 12 m field."""
    return ObservedLines(the_camera(), open_field(FIELD))


def points_from(place: Pose, seed: int, ideal: bool = False) -> LinePoints:
    """What a robot of this seed, as built or ideal, sees from a place of the 18 x 12 m field: observation level."""
    scenario = open_scenario("straight-tracks", seed, 0.2, ["ideal=true"] if ideal else [])
    motion = MotionSettings(kind="stand", pose=(place.x, place.y, math.degrees(place.heading)))
    return Simulation(scenario.model_copy(update={"motion": motion}), level="points").points(0)


def public_data(name: str) -> Path | None:
    """A path in the folder that TOUCHLINE_DATA names, or in ../shared/data; None where it is not found."""
    paths = [Path(folder) / name for folder in (os.environ.get(DATA_VARIABLE), "../shared/data") if folder is not None]
    return next((path for path in paths if path.exists()), None)


def public_recording(name: str) -> Recording | None:
    """A public recording; None where it is not found."""
    described = public_data(f"{name}/sequence.yaml")
    return None if described is None else open_source(described.parent)


def random_place(field: FieldModel, rng: np.random.Generator, margin_m: float = 0.0) -> Pose:
    """A pose anywhere on the field, at least margin_m inside its lines, facing anywhere."""
    x = rng.uniform(-1.0, 1.0) * (0.5 * field.length - margin_m)
    y = rng.uniform(-1.0, 1.0) * (0.5 * field.width - margin_m)
    return Pose(float(x), float(y), float(rng.uniform(-math.pi, math.pi)))


def field_axes(axes: Axes, field: FieldModel, beyond_m: float = 1.5) -> None:
    """Draw the field from above, x to the right, in metres."""
    reach_x, reach_y = 0.5 * field.length + beyond_m, 0.5 * field.width + beyond_m
    axes.add_patch(Rectangle((-reach_x, -reach_y), 2 * reach_x, 2 * reach_y, color=CARPET, zorder=0))
    for line in field.polylines():
        axes.plot(line[:, 0], line[:, 1], color=PAINT, linewidth=1.6, zorder=1, solid_capstyle="butt")
    axes.set_xlim(-reach_x, reach_x)
    axes.set_ylim(-reach_y, reach_y)
    axes.set_aspect("equal")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")


def new_figure(
    rows: int = 1,
    columns: int = 1,
    size_in: tuple[float, float] = (7.2, 4.2),
    titles: Sequence[str] = (),
    labels: tuple[str, str] = ("", ""),
    field: FieldModel | None = None,
    beyond_m: float = 1.5,
) -> tuple[Figure, list[Axes]]:
    """A figure and its axes, row by row. labels: of x and y of all of them; field: is drawn into each."""
    figure = Figure(figsize=size_in, layout="constrained")
    axes = list(np.atleast_1d(figure.subplots(rows, columns)).ravel())
    for number, each in enumerate(axes):
        each.grid(visible=True, color="#d8ddd8", linewidth=0.6)
        each.set_axisbelow(True)
        each.set(xlabel=labels[0], ylabel=labels[1])
        each.set_title(titles[number] if number < len(titles) else "", fontsize=10)
        if field is not None:
            field_axes(each, field, beyond_m)
    return figure, axes


def way(axes: Axes, poses: FloatArray, color: str, width: float = 1.0, **more: Any) -> None:
    """A line through poses (N, 3)."""
    axes.plot(*poses[:, :2].T, color=color, linewidth=width, **more)


def dots(axes: Axes, poses: FloatArray, color: str, size: float = 4.0, **more: Any) -> None:
    """A dot at each of poses or points (N, 2 or more)."""
    axes.plot(*poses[:, :2].T, more.pop("marker", "o"), color=color, markersize=size, **more)


def robot_dots(axes: Axes, values: Sequence[float], height: float, color: str, label: str | None = None) -> None:
    """A dot for each robot, at a height of its condition."""
    axes.plot(values, [height] * len(values), "o", color=color, markersize=3.5, alpha=0.8, label=label)


def image_figure(images: Sequence[ImageArray], size_in: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    """Images (BGR) side by side."""
    figure, axes = new_figure(1, len(images), size_in)
    for each, image in zip(axes, images, strict=True):
        each.imshow(image[..., ::-1])
        each.axis("off")
    return figure, axes
