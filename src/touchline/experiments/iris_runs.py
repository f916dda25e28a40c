"""What the experiments of iris-fusion share: one drive by odometry, particles and fusion, and its disturbances."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose, wrap_angles
from touchline.localization.published.iris.modes import MIN_POINTS
from touchline.localization.published.iris.particles import IrisParticles
from touchline.motion import DeadReckoning, MotionHistory
from touchline.systems import RobotSetup, open_system, paper_settings
from touchline.systems.iris_fusion import IrisFusionSettings, evenly_chosen
from touchline.types import Estimate, Frame, Mode, Observation, Samples, Status, empty_points

IDEAL = ("ideal=true",)
SYSTEMS = ("odometry", "particle filter", "sensor fusion")

Disturb = Callable[[Frame], Frame]


@dataclass(frozen=True, eq=False, slots=True)
class IrisDrive:
    """One drive from the first located image on, N images; none if the robot was never found.

    stamp_ns (N,); truth (N, 3) and tracks, by the names of SYSTEMS: x, y (m), heading (rad), field frame. seen (N,):
    whether the image showed anything. modes, statuses: of the fusion. before_ns (B,): stamps of the images before the
    first.
    """

    field: FieldModel
    stamp_ns: npt.NDArray[np.int64]
    truth: FloatArray
    tracks: dict[str, FloatArray]
    seen: npt.NDArray[np.bool_]
    modes: tuple[Mode | None, ...]
    statuses: tuple[Status, ...]
    before_ns: npt.NDArray[np.int64]

    @property
    def found_after(self) -> int:
        """Images before the first."""
        return len(self.before_ns)

    def tracked_ratio(self, start_s: float) -> float:
        """Share of all images from some time on in which the robot is tracked; of none before it is found."""
        tracking = np.array([status is Status.TRACKING for status in self.statuses], dtype=np.bool_)
        start_ns = int(1e9 * start_s)
        late = int(np.count_nonzero(self.stamp_ns >= start_ns) + np.count_nonzero(self.before_ns >= start_ns))
        return float(np.count_nonzero(tracking[self.stamp_ns >= start_ns])) / max(late, 1)

    @property
    def found(self) -> bool:
        """Whether the robot was found, and followed for two images at least."""
        return len(self.stamp_ns) > 1

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
    setup: RobotSetup,
    seed: int,
    paper: bool = False,
) -> IrisDrive:
    """Take every frame through the fusion, the particle filter alone and the odometry alone.

    truth: values (N, 3), one for each frame. Odometry and particles start where the fusion first found the robot and
    are left alone from then on: the odometry's pose is what wheels and gyro say (figure 4), the particles' is their own
    mean (figure 8), moved by the same wheels and gyro. Nothing comes to them from the fusion. paper: all three with the
    system's preset.
    """
    settings = paper_settings("iris-fusion") if paper else IrisFusionSettings()
    assert isinstance(settings, IrisFusionSettings)
    system = open_system("iris-fusion", setup, settings, np.random.default_rng(seed))
    s = settings
    history = MotionHistory(s.odometry, s.compass_track, s.gyro, s.wheels, setup.wheel_directions_rad)
    odometry = DeadReckoning(history)
    particles = IrisParticles(setup.field, np.random.default_rng(seed), settings.particles)
    told: list[Estimate] = []
    poses: dict[str, list[Pose]] = {name: [] for name in SYSTEMS}
    before: list[int] = []
    for frame in frames:
        history.add(frame)
        motion = odometry.advance(frame.stamp_ns)
        estimate = system.step(frame)
        points = empty_points() if estimate.observation is None else estimate.observation.points
        if told:
            particles.predict(motion)
            if len(points) >= MIN_POINTS:
                most = len(points) if settings.paper.all_points else settings.max_points
                particles.update(evenly_chosen(points.positions_m, most))
        elif estimate.status is Status.TRACKING:
            odometry.set_pose(estimate.pose)
            particles.start_at(estimate.pose, estimate.covariance)
        else:
            before.append(frame.stamp_ns)
            continue
        told.append(estimate)
        for name, pose in zip(SYSTEMS, (odometry.pose, particles.estimate().pose, estimate.pose), strict=True):
            poses[name].append(pose)
    return IrisDrive(
        setup.field,
        np.array([e.stamp_ns for e in told], dtype=np.int64),
        np.asarray(truth.values[len(before) :], dtype=np.float64),
        {name: np.array(track, dtype=np.float64).reshape(-1, 3) for name, track in poses.items()},
        np.array([e.points > 0 for e in told], dtype=np.bool_),
        tuple(e.mode for e in told),
        tuple(e.status for e in told),
        np.array(before, dtype=np.int64),
    )


Runs = dict[str, list[IrisDrive]]
"""Drives by form: the names of FORMS, and the same on images."""
FORMS = ("as built", "its form here", "ideal")
IMAGE_ROBOTS = 1  # robots whose images are rendered, which takes a hundred times as long as their points


def by_form(seeds: Sequence[int], one: Callable[[int, tuple[str, ...], bool], IrisDrive]) -> Runs:
    """The drives of each form: one(seed, changes to the robot as built, whether by the paper's own form)."""
    runs: Runs = {form: [] for form in FORMS}
    for seed in seeds:
        runs["as built"].append(one(seed, (), False))
        runs["its form here"].append(one(seed, (), True))
        runs["ideal"].append(one(seed, IDEAL, False))
    return runs


def missed_note(drives: Sequence[IrisDrive]) -> tuple[str, ...]:
    """A note on drives in which the robot was not found, if there are any."""
    missed = sum(not driven.found for driven in drives)
    return (f"The robot was not found in {missed} of {len(drives)} drives; they are left out.",) if missed else ()


def covered(start_s: float, seconds: float) -> Disturb:
    """The camera shows nothing for some time."""

    def disturb(frame: Frame) -> Frame:
        if not start_s <= frame.stamp_ns / 1e9 < start_s + seconds:
            return frame
        image = None if frame.image is None else np.zeros_like(frame.image)
        seen = None if frame.observation is None else Observation(frame.stamp_ns)
        return replace(frame, image=image, observation=seen)

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
