"""Odometry between two stamps, the compass at one: interpolated, a little extrapolated, and honest about gaps."""

from __future__ import annotations

import math

import numpy as np
import pytest

from touchline.geometry import wrap_angle
from touchline.motion import MotionHistory, OdometrySettings
from touchline.motion.odometry import DRIFT_M, DRIFT_RAD, TRAVEL_NOISE_M, TRAVEL_NOISE_RAD, TURN_NOISE_RAD, halt_of
from touchline.motion.samples import SampleHistory
from touchline.types import Samples

MS = 1_000_000


def odometry(times_ms: np.ndarray, speed: float = 1.0, turn_rate: float = 0.5, start: float = 0.0) -> Samples:
    """Driving an arc: forward speed (m/s) and turn rate (rad/s)."""
    t = times_ms / 1000.0
    theta = start + turn_rate * t
    x = speed / turn_rate * (np.sin(theta) - math.sin(start))
    y = speed / turn_rate * (math.cos(start) - np.cos(theta))
    return Samples((times_ms * MS).astype(np.int64), np.column_stack((x, y, np.asarray(wrap(theta)))))


def wrap(angles: np.ndarray) -> list[float]:
    return [wrap_angle(float(angle)) for angle in angles]


def track(*samples: Samples, settings: OdometrySettings | None = None) -> MotionHistory:
    one = MotionHistory(settings)
    for part in samples:
        one.add_samples("odometry", part)
    return one


def test_the_last_motion_goes_on_for_a_short_time() -> None:
    one = track(odometry(np.arange(0, 500, 20.0)))
    motion = one.between(400 * MS, 540 * MS)
    assert motion.pose.x == pytest.approx(0.14, abs=0.002)
    assert motion.pose.heading == pytest.approx(0.07, abs=1e-6)
    assert motion.missing_s == 0.0


def test_an_outage_widens_the_covariance() -> None:
    one = track(odometry(np.arange(0, 500, 20.0)))
    short, long = one.between(400 * MS, 780 * MS), one.between(400 * MS, 1580 * MS)
    assert short.missing_s == pytest.approx(0.2)
    assert long.missing_s == pytest.approx(1.0)
    assert long.covariance[0, 0] > 10 * short.covariance[0, 0]
    assert long.pose == short.pose  # motion is not made up


def test_each_axis_has_its_own_scale_error() -> None:
    scaled = OdometrySettings(forward_scale=0.03, sideways_scale=0.05, turn_scale=0.02)
    unscaled = OdometrySettings(forward_scale=0, sideways_scale=0, turn_scale=0)
    ahead = Samples(np.array([0, 1000 * MS]), np.array([[0, 0, 0], [2.0, 1.0, 0.5]]))
    more, less = (track(ahead, settings=each).between(0, 1000 * MS).covariance for each in (scaled, unscaled))
    np.testing.assert_allclose(np.sqrt(np.diag(more - less)), [0.06, 0.05, 0.01])
    there_and_back = Samples(np.array([0, 500 * MS, 1000 * MS]), np.array([[0, 0, 0], [2.0, 0, 0.5], [0, 0, 0]]))
    way_m, turns_rad, seconds = 4.0, 1.0, 1.0
    variances = np.diag(track(there_and_back, settings=unscaled).between(0, 1000 * MS).covariance)
    np.testing.assert_allclose(variances[:2], TRAVEL_NOISE_M**2 * way_m + DRIFT_M**2 * seconds)
    turned = TRAVEL_NOISE_RAD**2 * way_m + TURN_NOISE_RAD**2 * turns_rad
    np.testing.assert_allclose(variances[2], turned + DRIFT_RAD**2 * seconds)


def yaw(times_ms: np.ndarray, rate: float, lag_ms: float = 20.0, start: float = 0.0) -> Samples:
    """A compass that turns at a rate (rad/s) and reports late."""
    headings = wrap(start + rate * (times_ms - lag_ms) / 1000.0)
    return Samples((times_ms * MS).astype(np.int64), np.array(headings)[:, np.newaxis])


def test_without_a_recent_sample_there_is_no_heading() -> None:
    one = MotionHistory()
    assert one.at(0).heading_rad is None
    one.add_samples("compass", yaw(np.arange(1000, 1500, 20.0), 0.0))
    assert one.at(1700 * MS).heading_rad is not None
    assert one.at(1800 * MS).heading_rad is None
    assert one.at(500 * MS).heading_rad is None
    one.clear()
    assert one.at(1480 * MS).heading_rad is None


@pytest.mark.parametrize(("slows_s", "speed"), [(0.0, 0.4), (0.3, None)])
def test_an_odometry_that_halts_within_a_step_has_failed(slows_s: float, speed: float | None) -> None:
    samples, stamps = SampleHistory(3), np.arange(0, 3000 * MS, 20 * MS)
    seconds = np.minimum(1e-9 * stamps, 2.0)
    left_s = np.clip(2.0 - seconds, 0.0, slows_s)
    way = 0.4 * (seconds + (left_s - 0.5 * left_s**2 / slows_s if slows_s else 0.0))
    samples.add(Samples(stamps, np.column_stack((way, 0.0 * way, 0.1 * way))))
    halt = halt_of(samples)
    assert (halt is None) if speed is None else (halt is not None and halt.speed == pytest.approx(speed))
    assert halt is None or halt.stamp_ns == pytest.approx(2000 * MS, abs=25 * MS)
    samples.forget_before(2500 * MS)  # nothing is left of how it came to stand
    later = halt_of(samples)
    assert later is not None
    assert math.isnan(later.speed)
    assert halt_of(SampleHistory(3)) is None


def test_a_halt_after_a_gap_has_its_speed() -> None:
    samples = SampleHistory(3)
    stamps = np.array([0, 100, 2100, 2200, 2300]) * MS
    samples.add(Samples(stamps, np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], *3 * [[2.1, 0.0, 0.0]]])))
    halt = halt_of(samples)
    assert halt is not None
    assert halt == (2100 * MS, pytest.approx(1.0))
