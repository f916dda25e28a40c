"""The simulated sensors: the truth with the noise off, the documented moments with it on."""

from __future__ import annotations

import math

import numpy as np
import pytest
from simulated import standing_track

from touchline.errors import InputError
from touchline.geometry import Pose
from touchline_lab.simulation.robot.sensors import (
    SENSOR_PERIOD_S,
    ImuNoise,
    OdometryNoise,
    SensorSettings,
    WheelNoise,
    arrived_by,
    named_base,
    omni_base,
    simulate_imu,
    simulate_odometry,
    simulate_sensors,
    simulate_wheels,
    wheels_from_body,
)
from touchline_lab.simulation.robot.track import STEP_S, Track, poses_from_twists, twists_between

SILENT_ODOMETRY = OdometryNoise(
    scale_error=0.0, scale_spread=0.0, wheel_scale=0.0, travel_noise_m=0.0, travel_noise_rad=0.0, turn_noise_rad=0.0
)
START = Pose(1.0, -2.0, 0.4)
SILENT_WHEELS = WheelNoise(scale_error=0.0, slip_m=0.0)
SILENT_IMU = ImuNoise(
    gyro_bias_deg_s=(0.0, 0.0), tilt_rate_bias_deg_s=0.0, gyro_bias_walk_deg_s=0.0, gyro_noise_deg_s=0.0,
    compass_drift_deg=0.0, compass_place_deg=0.0, compass_noise_deg=0.0, tilt_noise_deg=0.0, tilt_bias_deg=0.0,
)  # fmt: skip


def driving(twist: tuple[float, float, float], seconds: float, start: Pose = START) -> Track:
    """A robot that moves with a constant velocity vx, vy, turning rate of its base."""
    steps = round(seconds / STEP_S)
    poses = poses_from_twists(start.as_array(), np.tile(np.array(twist) * STEP_S, (steps, 1)))
    poses = np.concatenate((start.as_array()[np.newaxis], poses))
    none = np.zeros_like(poses)
    return Track(poses, none, none.copy(), np.zeros((len(poses), 2)), np.zeros(len(poses), dtype=np.bool_))


def with_jump(kind: str, jump: tuple[float, float, float]) -> Track:
    """A standing robot that is carried or shoved by `jump` after one second."""
    track = standing_track(Pose(1.0, 2.0, 0.5), 3.0)
    row = round(1.0 / STEP_S)
    poses = track.poses.copy()
    poses[row:] += jump
    steps = np.zeros_like(poses)
    steps[row] = jump
    none = np.zeros_like(poses)
    shoved, carried = (steps, none) if kind == "shoved" else (none, steps)
    return Track(poses, shoved, carried, track.attitude, track.covered)


class TestTwists:
    def test_a_quarter_of_a_circle_is_its_arc_length_and_angle(self) -> None:
        radius = 2.0
        twist = twists_between(np.zeros((1, 3)), np.array([[radius, radius, math.pi / 2]]))
        np.testing.assert_allclose(twist, [[radius * math.pi / 2, 0.0, math.pi / 2]], atol=1e-12)

    def test_poses_and_twists_are_each_others_inverse(self) -> None:
        rng = np.random.default_rng(1)
        twists = rng.normal(size=(50, 3))
        twists[::7, 2] = 0.0
        poses = np.concatenate((np.zeros((1, 3)), poses_from_twists(np.zeros(3), twists)))
        np.testing.assert_allclose(twists_between(poses[:-1], poses[1:]), twists, atol=1e-9)


class TestOmniBases:
    def test_other_numbers_and_useless_directions_are_refused(self) -> None:
        with pytest.raises(InputError, match="3 and 4 omni wheels, not 5"):
            omni_base(5)
        with pytest.raises(InputError, match="tell forward, sideways and rotation apart"):
            wheels_from_body(np.zeros(3), np.full(3, 0.2))
        with pytest.raises(InputError, match="did you mean 'three-wheels'"):
            named_base("three-wheel")


class TestWhatIsFelt:
    def test_being_carried_shows_in_the_compass_alone(self) -> None:
        track = with_jump("carried", (3.0, -1.0, 1.2))
        assert np.all(simulate_odometry(track, SILENT_ODOMETRY, np.random.default_rng(0)) == 0.0)
        assert np.all(simulate_wheels(track, SILENT_WHEELS, np.random.default_rng(0)) == 0.0)
        imu = simulate_imu(track, SILENT_IMU, np.random.default_rng(0))
        assert np.all(imu[:, 5] == 0.0)
        np.testing.assert_allclose(imu[:51, 2], 0.5, atol=1e-12)
        np.testing.assert_allclose(imu[51:, 2], 1.7, atol=1e-12)

    def test_a_shove_turns_gyro_and_compass_but_no_wheel(self) -> None:
        track = with_jump("shoved", (0.2, 0.1, 0.17))
        assert np.all(simulate_odometry(track, SILENT_ODOMETRY, np.random.default_rng(0)) == 0.0)
        assert np.all(simulate_wheels(track, SILENT_WHEELS, np.random.default_rng(0)) == 0.0)
        imu = simulate_imu(track, SILENT_IMU, np.random.default_rng(0))
        assert imu[:, 5].sum() * SENSOR_PERIOD_S == pytest.approx(0.17)
        assert imu[-1, 2] == pytest.approx(0.67)


class TestSampleLogs:
    def test_samples_come_every_twenty_milliseconds_from_zero(self) -> None:
        log = simulate_sensors(driving((1.0, 0.0, 0.0), 1.0), SensorSettings(), np.random.default_rng(0))
        for samples in (log.odometry, log.wheels, log.imu):
            np.testing.assert_array_equal(samples.stamp_ns, np.arange(51) * 20_000_000)

    def test_a_sample_has_arrived_with_the_image_of_the_same_stamp(self) -> None:
        log = simulate_sensors(driving((1.0, 0.0, 0.0), 1.0), SensorSettings(), np.random.default_rng(0))
        stamps = np.array([100_000_000, 100_000_001, 102_000_000, 200_000_000])
        assert arrived_by(log.wheels, stamps) == [0, 6, 6, 6, 11]
