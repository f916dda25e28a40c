"""`touchline check` names a constant delay of the images' stamps."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from touchline.checks.delay import find_delay
from touchline.geometry import FloatArray, Pose
from touchline.types import Estimate, Samples, Status


def where(times_s: FloatArray) -> FloatArray:
    """(N, 3) a robot that drives to and fro, and turns."""
    return np.column_stack((2.0 * np.sin(0.7 * times_s), 0.5 * times_s, 0.8 * np.sin(times_s)))


def estimates(delay_s: float, noise_m: float = 0.005) -> list[Estimate]:
    stamps_s, rng = np.arange(1.0, 11.0, 0.1), np.random.default_rng(4)
    seen = where(stamps_s - delay_s) + noise_m * rng.standard_normal((len(stamps_s), 3))
    return [
        Estimate(round(1e9 * t), Pose(*pose), np.eye(3), Status.TRACKING)
        for t, pose in zip(stamps_s, seen.tolist(), strict=True)
    ]


def odometry(scale: float = 1.02) -> Samples:
    """In a frame of its own, with a scale error."""
    times_s = np.arange(0.0, 11.0, 0.02)
    poses = where(times_s)
    c, s = math.cos(1.0), math.sin(1.0)
    turned = scale * poses[:, :2] @ np.array([[c, s], [-s, c]])
    return Samples(np.rint(1e9 * times_s).astype(np.int64), np.column_stack((turned, poses[:, 2] + 1.0)))


@pytest.mark.parametrize("delay_s", [0.0, 0.06, 0.1, 0.25, -0.05])
def test_the_delay_is_found_beside_a_scale_error(delay_s: float) -> None:
    found = find_delay(estimates(delay_s), odometry())
    assert found is not None
    assert found.late_s == pytest.approx(delay_s, abs=max(0.006, 4.0 * found.deviation_s))
    assert found.deviation_s < 0.01


def test_a_delay_is_found_across_gaps() -> None:
    """The robot is carried between the blocks, where odometry sees nothing of it."""
    found = []
    for estimate in estimates(0.1):
        block, place = divmod(round(1e-9 * estimate.stamp_ns * 10.0) - 10, 65)
        if place < 35:
            found.append(replace(estimate, pose=replaced(estimate.pose, 3.0 * block)))
    late = find_delay(found, odometry())
    assert late is not None
    assert late.late_s == pytest.approx(0.1, abs=0.01)


def replaced(pose: Pose, shift_m: float) -> Pose:
    return Pose(pose.x + shift_m, pose.y, pose.heading)


def test_dense_images_of_standing_name_no_delay() -> None:
    """A false alarm of 168 ms: the few steps from stand to stand tell the delay, the many on the spot none."""
    found = []
    for place in range(8):
        stamps_s = 1.0 + 1.2 * place + np.arange(6) * 0.02
        noise = 0.005 * np.random.default_rng(place).standard_normal((6, 3))
        poses = (where(np.full(6, 1.2 * place)) + noise).tolist()
        found += [
            Estimate(round(1e9 * t), Pose(*p), np.eye(3), Status.TRACKING) for t, p in zip(stamps_s, poses, strict=True)
        ]
    times_s = np.arange(0.0, 11.0, 0.02)
    driven = where(
        1.2 * np.clip(np.floor((times_s - 1.0) / 1.2) + np.clip((times_s - 1.0) % 1.2 / 0.3 - 3.0, 0, 1), 0, 7)
    )
    late = find_delay(found, Samples(np.rint(1e9 * times_s).astype(np.int64), driven))
    assert late is None or abs(late.late_s) < 0.04 + 3.0 * late.deviation_s


def test_too_little_to_compare_tells_nothing() -> None:
    assert find_delay(estimates(0.1)[:15], odometry()) is None
    assert find_delay(estimates(0.1), replace(odometry(), stamp_ns=odometry().stamp_ns + 10**13)) is None
