"""What every system makes of frames that a driver of its own may bring: late, rare, out of order, without numbers."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drives import Drive, open_drive

from touchline.camera import OmniCamera
from touchline.geometry import Pose
from touchline.sources import open_source
from touchline.systems import SYSTEMS, RobotSetup, open_system
from touchline.types import Frame, ImageArray, LinePoints, Observation, Status, System

EXAMPLE = Path(__file__).parents[1] / "examples" / "omni_msl_track_short"
BY_POINTS = [name for name, info in SYSTEMS.items() if OmniCamera in info.cameras]  # others: test_odd_features.py
every_system = pytest.mark.parametrize("name", BY_POINTS)


@cache
def drive() -> tuple[Drive, list[Frame], list[Pose]]:
    """8 s on the 9 x 6 m field, the camera seen as line points; its frames and true poses."""
    tour = open_drive("tour")
    return tour, tour.frames, [Pose(*row) for row in tour.truth.tolist()]


def system(name: str) -> System:
    made = open_system(name, replace(drive()[0].setup, camera=None))
    made.reset()
    return made


@pytest.mark.parametrize("range_m", [30.0, 1e300])
@every_system
def test_points_farther_than_the_camera_can_see_are_no_points(name: str, range_m: float) -> None:
    """A fifth of the points: the pose is that of the others, bit for bit."""
    _, frames, poses = drive()
    rng, plain, disturbed = np.random.default_rng(0), system(name), system(name)
    for frame in frames[:45]:
        assert frame.observation is not None
        points = frame.observation.points
        far = rng.random(len(points)) < 0.2
        positions_m = np.where(far[:, np.newaxis], range_m * np.array([0.6, -0.8]), points.positions_m)
        estimate = disturbed.step(replace(frame, observation=Observation(0, replace(points, positions_m=positions_m))))
        near = LinePoints(*(getattr(points, each)[~far] for each in LinePoints.SHAPES))
        assert estimate.pose == plain.step(replace(frame, observation=Observation(0, near))).pose
        assert estimate.points == len(near)
    assert estimate.status is Status.TRACKING
    assert estimate.pose.distance_to(poses[44]) < 0.05


def test_the_camera_can_see_the_field_and_what_is_calibrated() -> None:
    source = open_source(EXAMPLE)
    field = source.field
    diagonal_m = math.hypot(field.length, field.width)
    camera = source.camera
    assert isinstance(camera, OmniCamera)
    nearer = replace(camera, range_m=camera.range_m * 8.0 / camera.range_m.max())
    assert RobotSetup(field).max_range_m == pytest.approx(diagonal_m + 3.0)
    assert RobotSetup(field, nearer).max_range_m == pytest.approx(8.0 + 3.0)


ODD_IMAGES: dict[str, Callable[[ImageArray], Any]] = {
    "half as large": lambda image: image[::2, ::2].copy(),
    "floats": lambda image: image / 255.0,
    "one channel": lambda image: image[..., 1].copy(),
    "no pixels": lambda image: image[:0, :0].copy(),
    "no array": lambda image: image[::100, ::100].tolist(),
}


@pytest.mark.parametrize("system_name", ["nubot-mti", "iris-fusion"])
def test_a_bad_image_is_the_fault_of_its_own_frame(system_name: str) -> None:
    """Among the first, that the colours are learned from: all others see as much as if it had been missing."""
    source = open_source(EXAMPLE)
    frames = list(itertools.islice(source, 8))
    spoils = dict(zip((0, 2, 4, 5, 7), ODD_IMAGES.values(), strict=True))
    setup = RobotSetup(source.field, source.camera, source.wheel_directions_rad)
    made, plain = open_system(system_name, setup), open_system(system_name, setup)
    for k, frame in enumerate(frames):
        odd = replace(frame, image=spoils[k](frame.image)) if k in spoils and frame.image is not None else frame
        estimate = made.step(odd)
        reference = plain.step(replace(frame, image=None) if k in spoils else frame)
        assert (estimate.pose, estimate.points, estimate.status) == (reference.pose, reference.points, reference.status)
        assert estimate.observation is not None
        assert (estimate.observation.problem is not None) == (k in spoils)


def test_images_of_nothing_are_not_learned_from_with_the_others() -> None:
    """Noise in three of the first five made the detector blind for good."""
    source = open_source(EXAMPLE)
    noise = np.random.default_rng(0).integers(0, 256, (480, 480, 3)).astype(np.uint8)
    made = open_system("nubot-mti", RobotSetup(source.field, source.camera))
    for k, frame in enumerate(itertools.islice(source, 12)):
        estimate = made.step(replace(frame, image=noise) if k in (1, 2, 3) else frame)
        assert k in (1, 2, 3) or estimate.points > 100


@every_system
def test_a_frame_from_the_past_is_refused_and_changes_nothing(name: str) -> None:
    _, frames, _ = drive()
    plain, disturbed = system(name), system(name)
    for k, frame in enumerate(frames[:40]):
        if k == 30:
            with pytest.raises(ValueError, match="forward in time"):
                disturbed.step(frames[20])
        assert disturbed.step(frame).pose == plain.step(frame).pose
