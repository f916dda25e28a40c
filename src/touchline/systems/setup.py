"""What every system knows of the robot that it runs on."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Protocol

from touchline.camera import Camera, OmniCamera, PerspectiveCamera, open_camera
from touchline.errors import InputError
from touchline.field import FieldModel, open_field
from touchline.given import given_numbers, refused
from touchline.localization.camera_errors import camera_errors
from touchline.localization.estimator.monitor import Monitor, NoMonitor
from touchline.messages import did_you_mean

_EXPECTED = "a RobotSetup, a field's name or a dict of field, camera, wheel_directions_rad, height_m"
CAMERA_HEIGHT_M = 1.0  # where it is unknown: that of a robot between kid and adult size
_MARGIN_M = 3.0  # a robot stands beside the field, a mirror leans, ranges are rough far away


@dataclass(frozen=True, eq=False, slots=True)
class RobotSetup:
    """The field a robot plays on, and how its sensors are mounted. A system takes what it uses and leaves the rest.

    Names and paths are opened: a field's, as `open_field` takes them, and that of a camera.yaml.
    camera: None if the frames bring their line points. wheel_directions_rad: rolling directions of two measuring wheels
    a and b in the robot frame; None where there are none, or nobody knows. height_m: of the camera behind a detector of
    the robot's own; None where nobody knows. Raises InputError for anything else.
    """

    field: FieldModel
    camera: Camera | None = None
    wheel_directions_rad: tuple[float, float] | None = None
    height_m: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "field", open_field(self.field))
        object.__setattr__(self, "camera", None if self.camera is None else open_camera(self.camera))
        if self.wheel_directions_rad is not None:
            what, expected = "wheels", "the two rolling directions (rad) as (a, b)"
            directions = given_numbers(what, expected, self.wheel_directions_rad, 2)
            if not all(map(math.isfinite, directions)):
                raise refused(what, expected, self.wheel_directions_rad)
            object.__setattr__(self, "wheel_directions_rad", directions)
        if self.height_m is not None:
            (height_m,) = given_numbers("height_m", "the height of the camera (m)", (self.height_m,), 1)
            if not 0.0 < height_m < math.inf:
                raise refused("height_m", "the height of the camera (m), above 0", self.height_m)
            object.__setattr__(self, "height_m", height_m)

    @property
    def walks(self) -> bool:
        """Whether the robot has legs, as one whose camera sees a sector: a mirror stands on wheels."""
        return self.height_m is not None if self.camera is None else isinstance(self.camera, PerspectiveCamera)

    @property
    def leans(self) -> bool:
        """Whether what is seen depends on the body's lean: not so of a mirror, but for one with `use_attitude`."""
        return self.camera is None or self.camera.use_attitude or self.walks

    @property
    def max_range_m(self) -> float:
        """What is farther away than this can't be a line of the field: the field's diagonal, or the end of the
        camera's range table if that is nearer, and a margin.
        """
        diagonal_m = math.hypot(self.field.length, self.field.width)
        calibrated_m = float(self.camera.range_m.max()) if isinstance(self.camera, OmniCamera) else math.inf
        return min(diagonal_m, calibrated_m) + _MARGIN_M

    def __repr__(self) -> str:
        camera = self.camera
        seen = "no camera" if camera is None else f"{camera.model} camera {camera.width}×{camera.height}"
        return f"RobotSetup({self.field.name}, {seen}{', two measuring wheels' if self.wheel_directions_rad else ''})"


def as_setup(given: object) -> RobotSetup:
    """A RobotSetup, from the name or path of a field alone, or from a dict of a RobotSetup's arguments.

    Raises InputError for anything else.
    """
    if isinstance(given, RobotSetup):
        return given
    if isinstance(given, Mapping):
        known = [field.name for field in fields(RobotSetup)]
        for key in given:
            if key not in known:
                nearest = did_you_mean(str(key), known)
                raise InputError(f"setup: expected a RobotSetup, which has no '{key}'; {nearest}")
        if "field" not in given:
            raise InputError("setup: expected a RobotSetup; 'field' is missing")
        return RobotSetup(**given)
    if not isinstance(given, str | FieldModel):
        raise refused("setup", _EXPECTED, given)
    try:
        return RobotSetup(open_field(given))
    except InputError as error:
        raise InputError(f"setup: expected {_EXPECTED}; {error}") from None


def open_monitor(setup: RobotSetup, wanted: bool) -> Monitor | NoMonitor:
    """The monitor of a system that has none of its own."""
    if not wanted:
        return NoMonitor()
    return Monitor(setup.field, camera_errors(setup.camera, setup.height_m), setup.walks)


class _HasSetup(Protocol):
    @property
    def setup(self) -> RobotSetup: ...


def system_text(system: _HasSetup) -> str:
    """What a system is shown as where Python prints it: its class, field and camera."""
    return repr(system.setup).replace("RobotSetup", type(system).__name__)
