"""Two measuring wheels: what they roll when the robot moves, and how it moved by what they rolled."""

import math
from dataclasses import dataclass

from touchline.errors import InputError

_MIN_ANGLE_RAD = math.radians(10.0)


@dataclass(frozen=True, slots=True)
class WheelPair:
    """Free-running wheels a and b under the robot: wheel travel = rolling direction · displacement + lever · turn.

    dir: rolling directions in the robot frame (rad). lever_m: travel per radian of a rotation about the robot's
    origin; 0 for a wheel on the line through the origin along its rolling direction.

    Raises InputError for directions so near to parallel that they can't tell forward from sideways.
    """

    a_dir_rad: float
    b_dir_rad: float
    a_lever_m: float = 0.0
    b_lever_m: float = 0.0

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (self.a_dir_rad, self.b_dir_rad, self.a_lever_m, self.b_lever_m))):
            raise InputError("measuring wheels: rolling directions and levers have to be finite numbers (rad, m)")
        if abs(math.sin(self.b_dir_rad - self.a_dir_rad)) < math.sin(_MIN_ANGLE_RAD):
            a_deg, b_deg = math.degrees(self.a_dir_rad), math.degrees(self.b_dir_rad)
            raise InputError(
                f"measuring wheels: the rolling directions {a_deg:.1f}° (a) and {b_deg:.1f}° (b) are parallel, or "
                f"nearer than {math.degrees(_MIN_ANGLE_RAD):.0f}° to it: such wheels can't tell forward from "
                "sideways; correct a_dir_rad and b_dir_rad (radians)"
            )

    def travels(self, forward_m: float, left_m: float, turn_rad: float) -> tuple[float, float]:
        """What a and b roll (m) during a small displacement and turn of the robot."""
        a_m = math.cos(self.a_dir_rad) * forward_m + math.sin(self.a_dir_rad) * left_m + self.a_lever_m * turn_rad
        b_m = math.cos(self.b_dir_rad) * forward_m + math.sin(self.b_dir_rad) * left_m + self.b_lever_m * turn_rad
        return a_m, b_m

    def displacement(self, a_m: float, b_m: float, turn_rad: float, heading_rad: float) -> tuple[float, float]:
        """Equations (2) and (3): displacement (m) in the frame in which the robot's heading is `heading_rad`.

        M. A. Ismail, D. Purwanto, A. Arifin: Soccer robot localization based on sensor fusion from odometry and
        omnivision. As printed, with α_A = a_dir − π/2 and α_B = b_dir + π/2, they are these two lines for levers of 0.
        """
        a_m, b_m = a_m - self.a_lever_m * turn_rad, b_m - self.b_lever_m * turn_rad
        a, b = self.a_dir_rad + heading_rad, self.b_dir_rad + heading_rad
        crossing = math.sin(self.b_dir_rad - self.a_dir_rad)
        return (a_m * math.sin(b) - b_m * math.sin(a)) / crossing, (b_m * math.cos(a) - a_m * math.cos(b)) / crossing

    def gain(self, heading_rad: float) -> tuple[tuple[float, float], tuple[float, float]]:
        """Derivatives of `displacement`: of its x by the travels of a and b, and of its y."""
        a, b = self.a_dir_rad + heading_rad, self.b_dir_rad + heading_rad
        crossing = math.sin(self.b_dir_rad - self.a_dir_rad)
        return (math.sin(b) / crossing, -math.sin(a) / crossing), (-math.cos(b) / crossing, math.cos(a) / crossing)
