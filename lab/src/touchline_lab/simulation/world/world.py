"""The analytic world of the simulator: what stands where, as plain values; `scene.py` makes arrays of them.

Field frame, metres, radians. Colours are linear reflectances red, green, blue in 0..1 (see `PAINTS`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

from touchline.errors import InputError
from touchline.field import FieldModel
from touchline_lab.simulation.world.lights import Lights

Colour = tuple[float, float, float]
BlockKind = Literal["box", "cylinder"]

PAINTS: dict[str, Colour] = {
    "white": (0.925, 0.87, 0.735),
    "black": (0.020, 0.022, 0.022),
    "dark": (0.034, 0.036, 0.038),
    "grey": (0.28, 0.27, 0.23),
    "light grey": (0.53, 0.52, 0.45),
    "carpet": (0.066, 0.249, 0.071),
    "green": (0.020, 0.170, 0.045),
    "blue": (0.031, 0.074, 0.420),
    "yellow": (0.740, 0.570, 0.025),
    "orange": (0.800, 0.250, 0.020),
    "red": (0.560, 0.035, 0.025),
    "magenta": (0.560, 0.045, 0.310),
    "cyan": (0.030, 0.480, 0.620),
    "brown": (0.300, 0.170, 0.080),
}


@dataclass(frozen=True, slots=True)
class GroundMark:
    """A painted rectangle on the ground: centre, direction of its length, full length and width, colour.

    It lies on top of carpet and lines; later marks lie on top of earlier ones (calibration strip, chessboard, marks).
    """

    x: float
    y: float
    heading: float
    length: float
    width: float
    colour: Colour


@dataclass(frozen=True, slots=True)
class Block:
    """A standing thing: an upright prism (box) or cylinder from bottom to top (m).

    kind: box (length x width about its heading) or cylinder (diameter = length). decal: a rectangle of another colour
    in the middle of the two broad faces, half as wide and a third as high.
    bands: colours from the bottom up in equal bands; one colour for a plain block.
    """

    kind: BlockKind
    x: float
    y: float
    heading: float
    length: float
    width: float
    bottom: float
    top: float
    bands: tuple[Colour, ...]
    decal: Colour | None = None


@dataclass(frozen=True, slots=True)
class RobotActor:
    """Another robot: where it starts and what it looks like: a dark body, a marker band, a dark top.

    `robot_blocks` builds the body in its own frame. shape: msl (broad wheeled), humanoid (two legs) or person.
    """

    x: float
    y: float
    heading: float
    radius: float = 0.26
    height: float = 0.80
    body_colour: Colour = PAINTS["dark"]
    marker_colour: Colour = PAINTS["magenta"]
    shape: Literal["msl", "humanoid", "person"] = "msl"


@dataclass(frozen=True, slots=True)
class BallActor:
    """A ball on the ground: where it starts, radius (m), colour."""

    x: float
    y: float
    radius: float = 0.11
    colour: Colour = PAINTS["orange"]


@dataclass(frozen=True)
class World:
    """Everything that stands still or begins somewhere.

    hall: length and width between the walls, height of the ceiling (m), centred on the field.
    board_height: of the dark barrier around the carpet (0: none). seam_spacing: carpet strips run across the field's
    length, this far apart (0: none). carpet_contrast: 1 is the wear and pile of a used carpet, 0 is plain colour.
    carpet_border_m: how far outside the lines the carpet ends (None: as the field says); floor: colour beside it.
    line_wear: how much of the lines' paint is rubbed off, and how dirty they are, 0 to 1 each. gloss: share of the
    light that the carpet mirrors at grazing angles.
    """

    field: FieldModel
    hall: tuple[float, float, float]
    lights: Lights
    clutter: Sequence[Block] = ()
    robots: Sequence[RobotActor] = ()
    balls: Sequence[BallActor] = ()
    marks: Sequence[GroundMark] = ()
    board_height: float = 0.0
    seam_spacing: float = 2.0
    carpet_contrast: float = 1.0
    carpet_border_m: float | None = None
    floor: Colour = (0.40, 0.375, 0.35)
    line_wear: tuple[float, float] = (0.0, 0.0)
    gloss: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        length, width = self.carpet
        if self.hall[0] < length or self.hall[1] < width or self.hall[2] <= 0.0:
            raise InputError(
                f"hall: {self.hall[0]} x {self.hall[1]} m does not hold the carpet of {length} x {width} m"
            )
        named: dict[str, Sequence[RobotActor | BallActor | Block]]
        named = {"robot": self.robots, "ball": self.balls, "clutter": self.clutter}
        for kind, things in named.items():
            for number, thing in enumerate(things):
                self.check_inside(f"{kind} {number}", thing.x, thing.y)

    @property
    def carpet(self) -> tuple[float, float]:
        """Length and width of the green carpet (m)."""
        border = self.field.border if self.carpet_border_m is None else self.carpet_border_m
        return self.field.length + 2.0 * border, self.field.width + 2.0 * border

    def check_inside(self, name: str, x: float, y: float) -> None:
        """InputError unless a position (field frame) lies in the hall."""
        if not (abs(x) <= 0.5 * self.hall[0] and abs(y) <= 0.5 * self.hall[1]):
            raise InputError(
                f"{name} at {x:g}, {y:g} is outside the hall of {self.hall[0]:g} x {self.hall[1]:g} m "
                "(centred on the field)"
            )


@dataclass(frozen=True)
class WorldState:
    """Where everything that moves is at one time.

    robots: x, y, heading of each robot of the world; balls: x, y of each. Empty: where the world says.
    covered: the camera sees nothing. occluded_rad: directions (start, end) in the base frame, counter-clockwise, that a
    cover hides over all ranges. mirror_swing_rad: lean of the camera's mirror about x and y beyond that of its mount.
    """

    time_s: float = 0.0
    robots: Sequence[tuple[float, float, float]] = ()
    balls: Sequence[tuple[float, float]] = ()
    covered: bool = False
    occluded_rad: Sequence[tuple[float, float]] = field(default_factory=tuple)
    mirror_swing_rad: tuple[float, float] = (0.0, 0.0)


def robot_blocks(robot: RobotActor) -> tuple[Block, ...]:
    """The body of a robot in its own frame (x forward, origin on the ground below its centre)."""
    r, h, dark = robot.radius, robot.height, robot.body_colour
    if robot.shape == "humanoid":
        grey = PAINTS["light grey"]
        sides = (-r, r)
        return (
            *(Block("box", 0.0, 0.45 * y, 0.0, 0.45 * r, 0.4 * r, 0.05, 0.5 * h, (grey,)) for y in sides),
            *(Block("box", 0.1 * r, 0.5 * y, 0.0, 1.1 * r, 0.6 * r, 0.0, 0.05, (dark,)) for y in sides),
            *(Block("box", 0.0, y, 0.0, 0.35 * r, 0.3 * r, 0.42 * h, 0.84 * h, (dark,)) for y in sides),
            Block("box", 0.0, 0.0, 0.0, 0.7 * r, 1.5 * r, 0.5 * h, 0.58 * h, (robot.marker_colour,)),
            Block("box", 0.0, 0.0, 0.0, 0.8 * r, 1.7 * r, 0.58 * h, 0.86 * h, (dark,)),
            Block("box", 0.0, 0.0, 0.0, 0.6 * r, 0.7 * r, 0.88 * h, h, (dark,)),
        )
    if robot.shape == "person":
        skin = (0.45, 0.27, 0.18)
        return (
            *(Block("box", 0.06, y, 0.0, 0.29, 0.10, 0.0, 0.09, (PAINTS["white"],)) for y in (-0.12, 0.12)),
            *(Block("cylinder", 0.0, y, 0.0, 0.14, 0.14, 0.09, 0.5 * h, (dark,)) for y in (-0.11, 0.11)),
            Block("box", 0.0, 0.0, 0.0, 0.24, 0.44, 0.5 * h, 0.84 * h, (robot.marker_colour,)),
            Block("cylinder", 0.0, 0.0, 0.0, 0.2, 0.2, 0.86 * h, h, (skin,)),
        )
    side = r * math.sqrt(2.0) * 1.08
    return (
        Block("box", 0.0, 0.0, 0.0, side, side, 0.03, 0.48 * h, (dark,), PAINTS["light grey"]),
        Block("cylinder", 0.0, 0.0, 0.0, 1.1 * r, 1.1 * r, 0.48 * h, 0.70 * h, (robot.marker_colour,)),
        Block("cylinder", 0.0, 0.0, 0.0, 0.9 * r, 0.9 * r, 0.70 * h, h, (dark,)),
    )
