"""A camera that is turned or displaced on the robot, and late images, as the motion alone tells them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

from touchline.geometry import FloatArray, Pose
from touchline.localization.estimator.constant_offsets import (
    RISK,
    ConstantOffsets,
    exceeded_by,
)
from touchline.localization.estimator.stamp_delay import Arrivals
from touchline.localization.estimator.step_noise import StepNoise
from touchline.localization.estimator.visual_motion import Sighting
from touchline.motion import MotionHistory
from touchline.motion.samples import SampleHistory
from touchline.types import Frame, Samples

RATE_HZ, SECONDS = 10.0, 8.0


def driven(
    offset: Pose,
    late_s: float = 0.0,
    turns: bool = True,
    speed_m_s: float = 1.0,
    corrected_s: float = 0.0,
    outliers: Sequence[int] = (),
    blurred: bool = False,
    since: int = 0,
    gyro: float | None = None,
    along_m: float = 0.01,
    found_anew: int = 0,
    until: int = 1_000,
    learned: bool = False,
) -> ConstantOffsets:
    """Drive with changing speed and turns; each image shows the robot's pose composed with an offset; outliers: images
    that show it elsewhere. blurred: whether they may. since: the first image with the offset. gyro: its share of the
    turns that the odometry tells; None: there is none. along_m: standard deviation along x of images with an offset.
    found_anew: the image from which the robot was found anew. until: the first image without the offset again; learned:
    whether it teaches that those before were seen by another camera.
    """
    rng, history, offsets = np.random.default_rng(3), MotionHistory(), ConstantOffsets()
    offsets.reset()

    def pose_at(seconds: float) -> Pose:
        way = speed_m_s * (seconds + 0.4 * math.sin(2.0 * seconds))
        heading = 0.8 * math.sin(1.3 * seconds) if turns else 0.0
        return Pose(way * 0.9, 0.6 * math.sin(way), heading)

    for k in range(int(SECONDS * RATE_HZ)):
        seconds = k / RATE_HZ
        fine = seconds - np.arange(4, -1, -1) / (5.0 * RATE_HZ) + 1.0
        samples = Samples((1e9 * fine).astype(np.int64), np.array([tuple(pose_at(one)) for one in fine]))
        rates = None
        if gyro is not None:
            turning = [
                gyro * (pose_at(one + 0.01).heading - pose_at(one - 0.01).heading) / 0.02 for one in fine.tolist()
            ]
            rates = Samples(samples.stamp_ns, np.outer(turning, [0.0, 0.0, 1.0]))
        history.add(Frame(round(1e9 * (seconds + 1.0)), odometry=samples, gyro=rates))
        seen: FloatArray = pose_at(seconds + 1.0 - late_s).compose(
            offset if since <= k < until else Pose(0.0, 0.0, 0.0)
        ).as_array() + rng.normal(0, 0.005, 3)
        covariance = np.diag(np.square([along_m if k >= since else 0.01, 0.01, 0.005]))
        if k in outliers:
            seen += np.array([0.3, -0.4, 0.3])
        begun, taught = k in (0, found_anew), learned and k == until
        sighting = Sighting(round(1e9 * (seconds + 1.0)), seen, covariance, 1.0, 0.0, begun, blurred, taught)
        offsets.update(sighting, history, StepNoise(walks=False), corrected_s)
    return offsets


@pytest.mark.parametrize("turn_deg", [-5.0, 2.0])
def test_the_bound_of_a_turned_camera_is_tight(turn_deg: float) -> None:
    turn = driven(Pose(0.0, 0.0, math.radians(turn_deg))).bound[1]
    assert math.radians(abs(turn_deg)) < turn < math.radians(abs(turn_deg) + 3.0)


@pytest.mark.parametrize("late_s", [0.0, 0.1])
def test_a_camera_displaced_suddenly_is_within_the_bound(late_s: float) -> None:
    """Late images, which are certain by then, say nothing against it; a shove, which turns the robot, is none."""
    displaced = driven(Pose(0.3, 0.0, 0.0), late_s, turns=False, speed_m_s=2.0, since=40)
    shoved = driven(Pose(0.3, 0.0, 0.15), turns=False, since=40)
    assert 0.4 < displaced.bound[0] < 0.9
    assert shoved.bound[0] < 0.3


@pytest.mark.parametrize(("gyro", "least", "most"), [(1.0, 0.105, 0.3), (None, 0.0, 0.1), (-1.0, 0.0, 0.1)])
def test_images_that_turn_unfelt_are_a_turned_camera(gyro: float | None, least: float, most: float) -> None:
    """6 degrees and 0.1 m, in the last two images; without a gyro that agrees a shove may have turned the robot."""
    turned = driven(Pose(0.1, 0.0, 0.105), since=78, gyro=gyro)
    assert least < turned.bound[1] < most


def test_a_lone_line_shows_that_a_camera_has_turned() -> None:
    """What lies along it is unknown; that it has turned, and the robot has not, is seen all the same."""
    lone, kept = (driven(Pose(0.1, 0.0, turn), since=78, gyro=1.0, along_m=3.0) for turn in (0.2, 0.0))
    assert lone.bound[1] > 0.2
    assert "turned" in lone.doubt
    assert kept.bound[1] < 0.02


def test_errors_widen_the_bound_as_they_are_likely() -> None:
    assert exceeded_by(np.array([[RISK, 0.1, 0.2]])) == 0.0
    sure, likely = (exceeded_by(np.array([[probability, 0.1, 0.2]])) for probability in (1.0, 0.01))
    assert sure == pytest.approx(0.1 + 3.29 * 0.2, rel=0.01)
    assert likely == pytest.approx(0.1 + 1.645 * 0.2, rel=0.01)
    both = exceeded_by(np.array([[0.01, 0.1, 0.2], [0.01, 0.0, 0.3]]))
    assert likely < both < 1.3 * likely


def test_beginning_again_forgets_no_clock_that_was_set() -> None:
    arrivals, odometry, offsets = Arrivals(), SampleHistory(columns=3), driven(Pose(0.0, 0.0, 0.0), speed_m_s=2.0)
    known = offsets.bound
    offsets.begin_again()
    assert offsets.bound == known  # of all that is known well nothing is forgotten
    for k in range(6):
        odometry.append(10**8 * (k + 1), [0.2 * k, 0.0, 0.0])
        arrivals.update(10**8 * (k + 1) + (300_000_000 if k > 1 else 0), odometry)
        offsets.arrive(arrivals, odometry)
    late = offsets._late
    offsets.begin_again()
    assert offsets._late == pytest.approx(late, rel=0.2)
    assert offsets._clock_set


def test_a_camera_whose_clock_is_set_is_in_doubt() -> None:
    arrivals, odometry = Arrivals(), SampleHistory(columns=3)
    offsets = driven(Pose(0.0, 0.0, 0.0), speed_m_s=2.0)
    for k in range(6):
        odometry.append(10**8 * (k + 1), [0.2 * k, 0.0, 0.0])
        arrivals.update(10**8 * (k + 1) + (300_000_000 if k > 1 else 0), odometry)
        offsets.arrive(arrivals, odometry)
        assert ("stamped" in offsets.doubt) == (k > 1), k
