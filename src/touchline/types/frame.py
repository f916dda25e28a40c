"""What comes in: one image, or what was seen in it, and all that was measured and said since the frame before.

Time stamps are integer nanoseconds of one clock. Arrays are not copied: treat them as read-only.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from touchline.errors import InputError
from touchline.geometry import ByteArray, FloatArray, IntArray, Pose, Pose3
from touchline.given import given_numbers, refused
from touchline.types.game import GameState
from touchline.types.seen import Observation

ImageArray = ByteArray

MAX_VALUE = 1.0e9  # no metre, radian or rad/s of a robot gets there


@dataclass(frozen=True, eq=False, slots=True)
class Samples:
    """Stamped measurements of one sensor, in the order of time.

    stamp_ns: int64 (N,), strictly increasing. values: float64 (N, k), one column per quantity.
    """

    stamp_ns: IntArray
    values: FloatArray

    def __post_init__(self) -> None:
        if self.values.ndim != 2 or len(self.stamp_ns) != len(self.values):
            raise ValueError(
                f"samples need stamps (N,) and values (N, k), got {self.stamp_ns.shape}, {self.values.shape}"
            )

    def __len__(self) -> int:
        return len(self.stamp_ns)

    @classmethod
    def joined(cls, parts: Iterable[Samples | None]) -> Samples | None:
        """One after the other, those that there are; None without any."""
        known = [part for part in parts if part is not None]
        if len(known) <= 1:
            return known[0] if known else None
        return cls(np.concatenate([part.stamp_ns for part in known]), np.concatenate([part.values for part in known]))


_PLACE = "x, y in m"


@dataclass(frozen=True, slots=True)
class Evidence:
    """What somebody else says of where the robot stands: a team mate, the ball, a colour.

    source: who says it, which the estimate names if it turns the pose. probability: that it is true. Either the half:
    own_half; or a place: what the robot sees at seen_m (x, y, robot frame; itself by default) is at place_m (x, y,
    field frame), give or take spread_m, a standard deviation. known: whether it is known who says it; all others count
    together no more than one who may lie. message: its number; a source that repeats one counts once.
    Raises InputError for neither or both, and for what is no probability or no place.
    """

    source: str
    probability: float = 0.9
    own_half: bool | None = None
    place_m: tuple[float, float] | None = None
    seen_m: tuple[float, float] = (0.0, 0.0)
    spread_m: float = 0.5
    known: bool = True
    message: int | None = None

    def __post_init__(self) -> None:
        (probability,) = given_numbers("evidence: probability", "a number between 0 and 1", [self.probability], 1)
        if not 0.0 < probability < 1.0:
            raise InputError(f"evidence: probability: {probability:g} is not between 0 and 1")
        if (self.own_half is None) == (self.place_m is None):
            raise InputError("evidence says the half (own_half) or a place (place_m), one of them")
        for name in ("place_m", "seen_m"):
            given = getattr(self, name)
            if given is not None and not all(map(math.isfinite, given_numbers(f"evidence: {name}", _PLACE, given, 2))):
                raise refused(f"evidence: {name}", _PLACE, given)
        (spread,) = given_numbers("evidence: spread_m", "a length in m above 0", [self.spread_m], 1)
        if not 0.0 < spread < math.inf:
            raise InputError(f"evidence: spread_m: {spread:g} is no length above 0 m")

    def log_likelihood(self, pose: Pose) -> float:
        """Logarithm of the probability of its being said at a pose."""
        if self.place_m is None:
            fits = 1.0 if (pose.x < 0.0) == self.own_half else 0.0
        else:
            (x, y) = pose.transform(np.array([self.seen_m], dtype=np.float64))[0]
            away2 = (x - self.place_m[0]) ** 2 + (y - self.place_m[1]) ** 2
            fits = math.exp(-0.5 * min(away2 / self.spread_m**2, 100.0))
        return math.log(self.probability * fits + (1.0 - self.probability) * (1.0 - fits))


@dataclass(frozen=True, eq=False, slots=True)
class Frame:
    """One image (or what was seen in it) and all that was measured since the frame before.

    image: uint8 (H, W, 3), BGR. observation: what a detector of the robot's own found, which takes the place of the
    image. base_from_camera: pose of the camera body in the base frame at this stamp, lean of the body included; it
    takes the place of the camera's mount and of `tilt`. odometry: x, y, theta in the odometry frame.
    wheels: a, b travelled (m). gyro: gx, gy, gz (rad/s). compass: yaw in the field frame (rad).
    tilt: roll, pitch (rad). evidence: what others say of the pose. game: what the referee says. measurements: of
    further sensors, arrays by their names. `problem` says why an expected image is missing.
    Anything but the stamp may be missing (None).
    """

    stamp_ns: int
    image: ImageArray | None = None
    observation: Observation | None = None
    base_from_camera: Pose3 | None = None
    odometry: Samples | None = None
    wheels: Samples | None = None
    gyro: Samples | None = None
    compass: Samples | None = None
    tilt: Samples | None = None
    exposure_ms: float | None = None
    gain: float | None = None
    name: str = ""
    problem: str | None = None
    evidence: tuple[Evidence, ...] = ()
    game: tuple[GameState, ...] = ()
    measurements: Mapping[str, FloatArray] = field(default_factory=dict)

    def __repr__(self) -> str:
        image = "no image" if self.image is None else f"image {self.image.shape[1]}×{self.image.shape[0]}"
        seen = "" if self.observation is None else ", own observation"
        sensors = [(name, getattr(self, name)) for name in ("odometry", "wheels", "gyro", "compass", "tilt")]
        samples_text = "".join(f", {len(samples)} × {name}" for name, samples in sensors if samples is not None)
        return f"Frame({self.stamp_ns / 1e9:.3f} s: {image}{seen}{samples_text})"
