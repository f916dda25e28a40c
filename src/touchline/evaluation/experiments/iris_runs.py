"""What the experiments of iris-fusion share: one drive through its three systems, and what may disturb it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from touchline.camera import OmniCamera
from touchline.config import load_settings
from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose, wrap_angles
from touchline.motion import WheelOdometry
from touchline.systems import open_system
from touchline.systems.iris_fusion import IrisFusionSettings
from touchline.types import Estimate, Frame, Mode, Samples, Status, empty_points

SYSTEMS = ("odometry", "particle filter", "sensor fusion")
# The particle filter alone: its own mean is the pose, but for images that the fusion refuses, and nothing is learned of
# the gyro.
PARTICLES_ALONE = ("fusion.beta=0", "fusion.bias_gain_per_s=0")

Disturb = Callable[[Frame], Frame]


@dataclass(frozen=True, eq=False, slots=True)
class IrisDrive:
    """One drive from the first located image on, N images.

    stamp_ns (N,); truth (N, 3) and tracks, by the names of SYSTEMS: x, y (m), heading (rad), field frame. seen (N,):
    whether the image showed anything. modes, statuses: of the fusion. found_after: images before the first.
    """

    field: FieldModel
    stamp_ns: npt.NDArray[np.int64]
    truth: FloatArray
    tracks: dict[str, FloatArray]
    seen: npt.NDArray[np.bool_]
    modes: tuple[Mode | None, ...]
    statuses: tuple[Status, ...]
    found_after: int

    @property
    def times_s(self) -> FloatArray:
        """Time since the first located image (N,)."""
        seconds: FloatArray = (self.stamp_ns - self.stamp_ns[0]) / 1e9
        return seconds

    def errors(self, system: str) -> FloatArray:
        """Track minus truth (N, 3) in m, m, rad."""
        errors: FloatArray = self.tracks[system] - self.truth
        errors[:, 2] = wrap_angles(errors[:, 2])
        return errors

    def distances_m(self, system: str) -> FloatArray:
        """Distance from the truth (N,)."""
        errors = self.errors(system)
        return np.hypot(errors[:, 0], errors[:, 1])

    def jitter(self, system: str) -> tuple[float, float]:
        """How much the error changes from image to image, root mean square: position (m), heading (rad)."""
        steps = np.diff(self.errors(system), axis=0)
        return math.sqrt(float(np.mean(steps[:, 0] ** 2 + steps[:, 1] ** 2))), math.sqrt(
            float(np.mean(wrap_angles(steps[:, 2]) ** 2))
        )


def drive(
    frames: Iterable[Frame],
    truth: Samples,
    field: FieldModel,
    camera: OmniCamera | None,
    wheel_directions_rad: tuple[float, float] | None,
    seed: int,
) -> IrisDrive:
    """Take every frame through the fusion, the particle filter alone and the odometry alone.

    truth: values (N, 3), one for each frame. The odometry starts where the particle filter first found the robot
    (figure 4) and is left alone from then on; the particle filter alone is the system with PARTICLES_ALONE.
    """
    fusion, particles = (
        open_system(
            "iris-fusion", field, camera, load_settings(IrisFusionSettings, None, sets), np.random.default_rng(seed),
            wheel_directions_rad,
        )
        for sets in ((), PARTICLES_ALONE)
    )  # fmt: skip
    odometry = WheelOdometry(None, *(wheel_directions_rad or (None, None)))
    estimates: list[Estimate] = []
    others: list[tuple[Pose, Pose]] = []
    first = None
    for index, frame in enumerate(frames):
        odometry.update(frame)
        estimates.append(fusion.step(frame))
        alone = particles.step(frame).pose
        if first is None and estimates[-1].status is Status.TRACKING:
            first = index
            odometry.set_pose(estimates[-1].pose)
        others.append((odometry.pose, alone))
    first = len(estimates) - 1 if first is None else first
    told = estimates[first:]
    fused = np.array([e.pose for e in told])
    dead, alone_poses = (np.array([pair[k] for pair in others[first:]]) for k in (0, 1))
    return IrisDrive(
        field,
        np.array([e.stamp_ns for e in told], dtype=np.int64),
        np.asarray(truth.values[first:], dtype=np.float64),
        dict(zip(SYSTEMS, (dead, alone_poses, fused), strict=True)),
        np.array([e.points > 0 for e in told]),
        tuple(e.mode for e in told),
        tuple(e.status for e in told),
        first,
    )


def covered(start_s: float, seconds: float) -> Disturb:
    """The camera shows nothing for some time."""

    def disturb(frame: Frame) -> Frame:
        if not start_s <= frame.stamp_ns / 1e9 < start_s + seconds:
            return frame
        image = None if frame.image is None else np.zeros_like(frame.image)
        return replace(frame, image=image, points=None if frame.points is None else empty_points())

    return disturb


def slipped(start_s: float, metres: float, direction_rad: float, wheels_rad: tuple[float, float]) -> Disturb:
    """Within 0.15 s the measuring wheels roll some way in a direction of the robot frame that the robot doesn't go."""

    def disturb(frame: Frame) -> Frame:
        if frame.wheels is None:
            return frame
        share = np.clip((frame.wheels.stamp_ns / 1e9 - start_s) / 0.15, 0.0, 1.0)
        rolled = metres * np.cos(np.array(wheels_rad) - direction_rad)
        return replace(frame, wheels=Samples(frame.wheels.stamp_ns, frame.wheels.values + np.outer(share, rolled)))

    return disturb


def drifting(start_s: float, rad_s: float) -> Disturb:
    """From some time on the gyro shows so much more than the true rate."""

    def disturb(frame: Frame) -> Frame:
        if frame.gyro is None:
            return frame
        values = frame.gyro.values.copy()
        values[:, 2] += np.where(frame.gyro.stamp_ns / 1e9 >= start_s, rad_s, 0.0)
        return replace(frame, gyro=Samples(frame.gyro.stamp_ns, values))

    return disturb
