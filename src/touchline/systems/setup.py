"""What every system is told of the robot that it runs on."""

from __future__ import annotations

import math
from dataclasses import dataclass

from touchline.camera import Camera, OmniCamera
from touchline.field import FieldModel

_MARGIN_M = 3.0  # a robot stands beside the field, a mirror leans, ranges are rough far away


@dataclass(frozen=True, eq=False, slots=True)
class RobotSetup:
    """The field a robot plays on, and how its sensors are mounted. A system takes what it uses and leaves the rest.

    camera: None if the frames bring their line points. wheel_directions_rad: rolling directions of two measuring wheels
    a and b in the robot frame; None where there are none, or nobody knows.
    """

    field: FieldModel
    camera: Camera | None = None
    wheel_directions_rad: tuple[float, float] | None = None

    @property
    def max_range_m(self) -> float:
        """What is farther away than this can't be a line of the field: the field's diagonal, or the end of the
        camera's range table if that is nearer, and a margin.
        """
        diagonal_m = math.hypot(self.field.length, self.field.width)
        calibrated_m = float(self.camera.range_m.max()) if isinstance(self.camera, OmniCamera) else math.inf
        return min(diagonal_m, calibrated_m) + _MARGIN_M


__all__ = ["RobotSetup"]
