"""What every system makes of frames that a driver of its own may bring: late, rare, out of order, without numbers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from touchline.geometry import Pose
from touchline.simulation.run import Simulation
from touchline.simulation.scenario import open_scenario
from touchline.systems import SYSTEMS, RobotSetup, open_system
from touchline.types import Estimate, Frame, LinePoints, Observation, Samples, Status, System

every_system = pytest.mark.parametrize("name", SYSTEMS)


@cache
def drive() -> tuple[Simulation, list[Frame], list[Pose]]:
    """12 s on the 9 x 6 m field, the camera seen as line points; its frames and true poses."""
    chosen = open_scenario("tour-20", 1, 12.0).model_copy(update={"field": "indoor-9x6"})
    run = Simulation(chosen, level="points")
    return run, list(run), [Pose(*(float(value) for value in row)) for row in run.truth.poses]


def system(name: str) -> System:
    run = drive()[0]
    made = open_system(name, RobotSetup(run.field, wheel_directions_rad=run.wheel_directions_rad))
    made.reset()
    return made


def nan(samples: Samples | None) -> Samples | None:
    return None if samples is None else Samples(samples.stamp_ns, np.full_like(samples.values, np.nan))


def without_numbers(frame: Frame) -> Frame:
    assert frame.observation is not None
    p = frame.observation.points
    points = LinePoints(np.full_like(p.positions_m, np.nan), p.covariances_m2, p.confidences, p.pixels)
    sensors = {key: nan(getattr(frame, key)) for key in ("odometry", "wheels", "gyro", "compass", "tilt")}
    return replace(frame, observation=Observation(frame.stamp_ns, points), **sensors)


ODD: dict[str, Callable[[Frame], Frame]] = {
    "no points": lambda frame: replace(frame, observation=None),
    "an empty image": lambda frame: replace(frame, observation=Observation(frame.stamp_ns)),
    "no numbers": without_numbers,
    "nothing": lambda frame: Frame(frame.stamp_ns),
}


@every_system
@pytest.mark.parametrize("what", ODD)
def test_every_second_frame_may_show_nothing_at_the_start(name: str, what: str) -> None:
    _, frames, poses = drive()
    made = system(name)
    for k, frame in enumerate(frames[:40]):
        estimate = made.step(ODD[what](frame) if k % 2 == 0 else frame)
        assert np.isfinite([*estimate.pose, *estimate.covariance.ravel()]).all()
        assert estimate.status is not Status.TRACKING or estimate.pose.distance_to(poses[k]) < 0.2
    assert estimate.status is Status.TRACKING


@every_system
def test_wheels_and_odometry_may_miss_frames(name: str) -> None:
    _, frames, poses = drive()
    made = system(name)
    for k, frame in enumerate(frames):
        estimate = made.step(replace(frame, wheels=None, odometry=None) if k % 3 else frame)
        assert estimate.status is not Status.TRACKING or estimate.pose.distance_to(poses[k]) < 0.2
        assert estimate.status is Status.TRACKING or k < 20


@every_system
def test_a_frame_from_the_past_is_refused_and_changes_nothing(name: str) -> None:
    _, frames, _ = drive()
    plain, disturbed = system(name), system(name)
    for k, frame in enumerate(frames[:40]):
        if k == 30:
            with pytest.raises(ValueError, match="forward in time"):
                disturbed.step(frames[20])
        assert disturbed.step(frame).pose == plain.step(frame).pose


@every_system
@pytest.mark.parametrize("left", [20, 30])
def test_a_robot_that_has_driven_on_while_all_was_silent_is_found_again_and_not_taken_to_be_where_it_was(
    name: str, left: int
) -> None:
    _, frames, poses = drive()
    made = system(name)
    for frame in frames[:left]:
        made.step(frame)
    silent = 60  # frames, 6 s
    assert poses[left + silent].distance_to(poses[left - 1]) > 1.0
    for k in range(left + silent, left + silent + 15):
        estimate = made.step(frames[k])
        assert is_honest(estimate, poses[k])
    assert estimate.status is Status.TRACKING


def is_honest(estimate: Estimate, pose: Pose) -> bool:
    deviation_m = math.sqrt(estimate.covariance[0, 0] + estimate.covariance[1, 1])
    return estimate.pose.distance_to(pose) < (0.1 if estimate.status is Status.TRACKING else 3.0 * deviation_m)
