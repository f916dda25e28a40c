"""What lights the hall: ceiling lamps, daylight everywhere, and the sun through windows in one wall.

Levels are relative: under level 1 white paint comes to about 230 of 255 at exposure_ms = 12, gain = 1.7.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from touchline.errors import InputError


@dataclass(frozen=True, slots=True)
class Lamp:
    """A lamp under the ceiling: position in the field frame (m); power 1 gives level 1 straight below it.

    colour: red, green, blue of its light, 1 each is white.
    """

    x: float
    y: float
    z: float = 6.0
    power: float = 1.0
    colour: tuple[float, float, float] = (1.0, 1.0, 1.0)


@dataclass(frozen=True, slots=True)
class Window:
    """A window in a wall of the hall. wall: north (+y), south (-y), east (+x) or west (-x).

    start_m, end_m: reach along the wall (x or y, field frame); bottom_m, top_m: heights; bars: along, up.
    """

    wall: Literal["north", "south", "east", "west"]
    start_m: float
    end_m: float
    bottom_m: float = 1.0
    top_m: float = 4.0
    bars: tuple[int, int] = (2, 1)
    bar_width_m: float = 0.12


@dataclass(frozen=True, slots=True)
class LightChange:
    """From time_s on, within fade_s, the named levels become these (None: unchanged). lamp: index, None for all."""

    time_s: float
    lamps: float | None = None
    sun: float | None = None
    ambient: float | None = None
    lamp: int | None = None
    fade_s: float = 0.0


@dataclass(frozen=True)
class Lights:
    """Lamps, ambient daylight and sun, with their changes over time.

    sun: level of direct sun on the ground where it falls through a window (0: none)
    in the same units as the lamps.
    sun_azimuth_rad: direction towards the sun, field frame; sun_elevation_rad above the horizon.
    Raises InputError for a lamp that does not exist.
    """

    lamps: Sequence[Lamp] = ()
    ambient: float = 0.35
    lamp_level: float = 1.0
    sun: float = 0.0
    sun_azimuth_rad: float = 0.5 * math.pi
    sun_elevation_rad: float = math.radians(35.0)
    windows: Sequence[Window] = ()
    changes: Sequence[LightChange] = field(default_factory=tuple)

    def __post_init__(self) -> None:
        for change in self.changes:
            if change.lamp is not None and not 0 <= change.lamp < len(self.lamps):
                raise InputError(
                    f"light change at {change.time_s} s: lamp {change.lamp} of {len(self.lamps)} is unknown"
                )

    def levels(self, time_s: float) -> tuple[np.ndarray, float, float]:
        """Levels at a time: of each lamp (L,) float64, of the sun and of the ambient light."""
        lamps = np.full(len(self.lamps), self.lamp_level)
        sun, ambient = self.sun, self.ambient
        for change in sorted(self.changes, key=lambda c: c.time_s):
            if time_s < change.time_s:
                break
            share = 1.0 if change.fade_s <= 0.0 else min(1.0, (time_s - change.time_s) / change.fade_s)
            if change.lamps is not None:
                chosen = slice(None) if change.lamp is None else slice(change.lamp, change.lamp + 1)
                lamps[chosen] += share * (change.lamps - lamps[chosen])
            sun += share * ((change.sun if change.sun is not None else sun) - sun)
            ambient += share * ((change.ambient if change.ambient is not None else ambient) - ambient)
        return lamps, sun, ambient


def hall_lamps(length_m: float, width_m: float, height_m: float = 6.0) -> tuple[Lamp, ...]:
    """Lamps in a grid about 4 m apart under a ceiling, of equal power."""
    columns, rows = max(2, round(length_m / 4.5)), max(2, round(width_m / 4.5))
    xs = (np.arange(columns) + 0.5) / columns * length_m - 0.5 * length_m
    ys = (np.arange(rows) + 0.5) / rows * width_m - 0.5 * width_m
    return tuple(Lamp(float(x), float(y), height_m) for y in ys for x in xs)


def lamps_on_ground(lamps: Sequence[Lamp], x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Share of each lamp (L, ...) in the level on the ground at x, y (field frame, m).

    Lambert's lamp above Lambert's floor: cos^4 of the angle from below the lamp. Scaled so that all lamps
    together give 0.65 in the middle of the hall.
    """
    shares = []
    for lamp in lamps:
        square = (x - lamp.x) ** 2 + (y - lamp.y) ** 2
        shares.append(lamp.power / (1.0 + square / lamp.z**2) ** 2)
    if not shares:
        return np.zeros((0, *x.shape))
    table = np.stack(shares)
    middle = sum(lamp.power / (1.0 + (lamp.x**2 + lamp.y**2) / lamp.z**2) ** 2 for lamp in lamps)
    return np.asarray(table * (0.65 / max(middle, 1e-9)))
