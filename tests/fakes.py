"""A system, a source and a camera small enough to see through, for tests of what surrounds a system."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from touchline.evaluation.tum import tum_line
from touchline.geometry import Pose
from touchline.types import Estimate, Frame, LinePoints, Observation, Prior, Problem, ProblemCode, Samples, Status

RATE_HZ = 10.0
STEP_NS = 100_000_000
CAMERA_YAML = """\
model: omni
width: 96
height: 96
center: [47.5, 47.5]
inner_radius_px: 8
outer_radius_px: 46
handedness: -1
mount_yaw: -1.5707963267948966
range_table: {radius_px: [0, 12, 24, 36, 48], range_m: [0.0, 0.6, 1.6, 3.6, 9.0]}
"""


def true_pose(index: int) -> Pose:
    """Along a gentle curve."""
    return Pose(-2.0 + 0.05 * index, 0.5 + 0.02 * index, 0.03 * index)


def true_samples(count: int) -> Samples:
    """The true pose at every frame."""
    stamps = np.arange(count, dtype=np.int64) * STEP_NS
    return Samples(stamps, np.array([true_pose(index) for index in range(count)]))


class FakeSystem:
    """Knows the truth, and errs by a seeded noise. The frames in `searching` are not located."""

    detector = None

    def __init__(self, rng: np.random.Generator, noise_m: float = 0.01, searching: tuple[int, ...] = (0,)) -> None:
        self.rng = rng
        self.noise_m = noise_m
        self.searching = searching
        self.prior: Prior | None = None
        self.seen: list[Frame] = []

    def reset(self, prior: Prior | None = None) -> None:
        self.prior = prior

    def step(self, frame: Frame) -> Estimate:
        self.seen.append(frame)
        index = round(frame.stamp_ns / STEP_NS)
        x, y, heading = np.array(true_pose(index)) + self.noise_m * self.rng.standard_normal(3)
        found = index not in self.searching
        return Estimate(
            frame.stamp_ns,
            Pose(float(x), float(y), float(heading)),
            np.eye(3) * 1e-4,
            Status.TRACKING if found else Status.SEARCHING,
            residual_m=0.02 + 0.001 * index if found else float("nan"),
            points=2 if found else 0,
            perception_ms=1.0,
            localization_ms=0.5,
            observation=Observation(frame.stamp_ns, two_points()),
        )


class FakeSource:
    """Frames with a green image that a white line crosses; `missing` have none, `black` are black."""

    def __init__(self, count: int, missing: tuple[int, ...] = (), black: tuple[int, ...] = ()) -> None:
        self.count, self.missing, self.black = count, missing, black

    def __len__(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[Frame]:
        for index in range(self.count):
            image = np.full((96, 96, 3), (40, 140, 40), dtype=np.uint8)
            image[28:36] = 240
            if index in self.black:
                image[:] = 5
            if index in self.missing:
                yield Frame(index * STEP_NS, problem=f"images/{index:06d}.png (frame {index}): is broken")
            else:
                yield Frame(index * STEP_NS, image=image)


def two_points() -> LinePoints:
    """Two line points ahead and to the left, with pixels."""
    positions = np.array([[1.0, 0.0], [0.0, 1.5]])
    pixels = np.array([[47.5, 30.0], [24.0, 47.5]])
    return LinePoints(positions, np.tile(np.eye(2) * 1e-4, (2, 1, 1)), np.array([1.0, 0.4]), pixels)


def write_recording(folder: Path, count: int = 12, truth: bool = True) -> Path:
    """A recording in the folder format with tiny images of a green carpet with one white line."""
    (folder / "images").mkdir(parents=True)
    rows = ["t,file,exposure_ms,gain"]
    for index in range(count):
        image = np.full((96, 96, 3), (40, 140, 40), dtype=np.uint8)
        image[28:31] = 240
        cv2.imwrite(str(folder / "images" / f"{index:06d}.png"), image)
        rows.append(f"{index / RATE_HZ:.4f},images/{index:06d}.png,10.0,1.0")
    (folder / "images.csv").write_text("\n".join(rows) + "\n")
    about = "format: 1\nname: tiny\ndescription: a tiny recording\nfield: msl-18x12\ncamera: omni\nrate_hz: 10\n"
    (folder / "sequence.yaml").write_text(about)
    (folder / "camera.yaml").write_text(CAMERA_YAML)
    if truth:
        lines = [tum_line(index * STEP_NS, true_pose(index)) for index in range(count)]
        (folder / "ground_truth.tum").write_text("".join(lines))
    return folder


def codes_of(*estimates: Estimate) -> set[str]:
    """Of all their problems."""
    return {problem.code for estimate in estimates for problem in estimate.problems}


class WatchedSystem(FakeSystem):
    """Gives bounds and statistics. In the frames 10 to 19 a fault is named and no bound is given."""

    def step(self, frame: Frame) -> Estimate:
        estimate, index = super().step(frame), round(frame.stamp_ns / STEP_NS)
        if 10 <= index < 20:
            doubted = estimate.unconfirmed("odometry contradicts the images")
            faulty = (Problem(ProblemCode.ODOMETRY_TURN_SIGN, "odometry turns the wrong way"),)
            return replace(doubted, statistics={"motion": 1.5, "share": 0.2}, problems=faulty)
        bound = {"protection_m": 0.06, "protection_rad": 0.05, "end_probability": 0.99}
        return replace(estimate, statistics={"motion": 0.3, "share": 0.1}, **bound)
