"""What every system is told of the robot that it runs on."""

from __future__ import annotations

from dataclasses import dataclass

from touchline.camera import Camera
from touchline.field import FieldModel


@dataclass(frozen=True, eq=False, slots=True)
class RobotSetup:
    """The field a robot plays on, and how its sensors are mounted. A system takes what it uses and leaves the rest.

    camera: None if the frames bring their line points. wheel_directions_rad: rolling directions of two measuring wheels
    a and b in the robot frame; None where there are none, or nobody knows.
    """

    field: FieldModel
    camera: Camera | None = None
    wheel_directions_rad: tuple[float, float] | None = None


__all__ = ["RobotSetup"]
