"""What is known of a system before it is opened."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from touchline.camera import OmniCamera
from touchline.config import Settings
from touchline.motion import MotionHistory
from touchline.perception import Detector
from touchline.types import System


class LocalizationSystem(System, Protocol):
    """A system that can be looked into: what it sees with, and what it remembers of the motion."""

    @property
    def detector(self) -> Detector | None:
        """Image -> observation; None without a camera."""
        ...

    @property
    def history(self) -> MotionHistory:
        """What it remembers of the robot's motion."""
        ...


@dataclass(frozen=True, slots=True)
class Needs:
    """The sensors that a system measures with beside camera and compass, by their names in `Frame`.

    purpose: what they are for, as in "NAME measures its way". stand_in: the sensor that takes their place where one of
    them is missing; without: what happens if that is missing, too.
    """

    purpose: str
    sensors: tuple[str, ...]
    stand_in: str
    without: str


@dataclass(frozen=True, slots=True)
class SystemInfo:
    """One system: its name, one line about it, its settings, and how it is made from setup, settings and rng.

    needs: sensors whose absence is reported to the user. cameras: classes of those in whose images it can see.
    """

    name: str
    description: str
    settings: type[Settings]
    factory: Callable[..., LocalizationSystem]
    needs: Needs | None = None
    cameras: tuple[type, ...] = (OmniCamera,)
