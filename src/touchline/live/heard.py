"""What a link brings from a robot and what it takes back, whatever the link is."""

from collections import Counter
from dataclasses import dataclass
from typing import NamedTuple, Protocol, TypeAlias

from touchline.camera import Camera
from touchline.geometry import FloatArray, Pose, Pose3
from touchline.types import Estimate, Evidence, Frame, GameState, ImageArray, Observation

SENSORS = {"odometry": 3, "wheels": 2, "gyro": 3, "compass": 1, "attitude": 2}  # and how many numbers each gives


_MAX_KINDS = 20  # of refused messages that are told apart


class Reading(NamedTuple):
    """One sample of a sensor, in the order and units of `Localizer.add_odometry` and its like."""

    sensor: str
    stamp_ns: int
    values: tuple[float, ...]


@dataclass(frozen=True, eq=False, slots=True)
class Sight:
    """One image, or what a detector of the robot's own found in it.

    image: the content of an image file (JPEG, PNG, …), or pixels (H, W, 3) BGR, or None. arrived_s: on the
    clock of time.monotonic. base_from_camera: pose of the camera body in the base frame, of a head that moves.
    """

    stamp_ns: int
    arrived_s: float
    image: bytes | ImageArray | None = None
    observation: Observation | None = None
    base_from_camera: Pose3 | None = None


@dataclass(frozen=True, eq=False, slots=True)
class Start:
    """Where somebody says that the robot stands; pose None: nobody knows. covariance: (3, 3), None if unknown."""

    pose: Pose | None = None
    covariance: FloatArray | None = None
    own_half: bool = False


@dataclass(frozen=True, eq=False, slots=True)
class Described:
    """The camera, as the robot itself describes it."""

    camera: Camera


Heard: TypeAlias = Reading | Sight | Start | Evidence | Described | GameState


@dataclass(frozen=True, eq=False, slots=True)
class Published:
    """What goes out to the robot: an image's estimate, or one carried on to a sample of the odometry.

    map_from_odom: the odometry frame in the field's, None where it is not known. image: whether it comes
    from an image. dropped: images so far that came while the program was busy. after_s: from the image's arrival on.
    frame: what the image's estimate is of.
    """

    estimate: Estimate
    map_from_odom: Pose | None = None
    image: bool = False
    dropped: int = 0
    after_s: float = 0.0
    frame: Frame | None = None


def count_refused(counts: Counter[str], what: str) -> None:
    """Count what was left out; of what senders make up no more than some kinds are kept."""
    counts[what if what in counts or len(counts) < _MAX_KINDS else "other messages that can't be used"] += 1


class Link(Protocol):
    """Carries messages between the robot and the loop."""

    def hear(self, timeout_s: float) -> list[Heard]:
        """What has come, after waiting for it as long as that. What is no message is left out and counted."""

    def publish(self, published: Published) -> None:
        """Send an estimate. Nobody has to listen."""

    @property
    def refused(self) -> dict[str, int]:
        """What was left out so far, and how often."""

    def around(self) -> str:
        """What was found to be received, or where it is listened, in words: where no image comes."""

    def close(self) -> None:
        """Let go of the link."""


class Picture(NamedTuple):
    """An image of a recording as it is stored, or what a detector found in it."""

    stamp_ns: int
    data: bytes | None
    observation: Observation | None
    base_from_camera: Pose3 | None
