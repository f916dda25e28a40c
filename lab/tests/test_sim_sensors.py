"""The simulated sensors: the truth with the noise off, the documented moments with it on."""

from __future__ import annotations

import math

import numpy as np
import pytest
from simulated import standing_track

from touchline.errors import InputError
from touchline.geometry import FloatArray, Pose
from touchline_lab.simulation.robot.noise import PlaceDisturbance
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


def wandering(seconds: float, seed: int = 3) -> Track:
    """A robot whose velocity changes smoothly all the time."""
    rng = np.random.default_rng(seed)
    n = round(seconds / STEP_S)
    t = STEP_S * np.arange(n)
    twists = np.stack([s * np.sin(rng.uniform(0.5, 2.0) * t + rng.uniform(0, 6)) for s in (1.5, 1.0, 2.0)], axis=1)
    poses = np.concatenate((np.zeros((1, 3)), poses_from_twists(np.zeros(3), twists * STEP_S)))
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


class TestMeasuringWheels:
    @pytest.mark.parametrize("directions", [(math.pi / 4, -math.pi / 4), (0.0, math.pi / 2), (0.3, 2.5)])
    @pytest.mark.parametrize("twist", [(1.0, 0.0, 0.0), (0.0, 0.7, 0.0), (0.8, -0.4, 1.3)])
    def test_travel_is_the_integral_of_the_velocity_along_the_rolling_direction(
        self, directions: tuple[float, float], twist: tuple[float, float, float]
    ) -> None:
        noise = SILENT_WHEELS.model_copy(update={"a_dir_rad": directions[0], "b_dir_rad": directions[1]})
        wheels = simulate_wheels(driving(twist, 4.0), noise, np.random.default_rng(0))
        expected = [4.0 * (math.cos(d) * twist[0] + math.sin(d) * twist[1]) for d in directions]
        np.testing.assert_allclose(wheels[-1], expected, atol=1e-9)
        np.testing.assert_allclose(wheels[0], 0.0)

    def test_a_rotation_on_the_spot_turns_no_wheel(self) -> None:
        wheels = simulate_wheels(driving((0.0, 0.0, 2.0), 3.0), SILENT_WHEELS, np.random.default_rng(0))
        np.testing.assert_allclose(wheels, 0.0, atol=1e-9)

    def test_two_wheels_give_back_the_velocity_of_a_wandering_robot(self) -> None:
        track = wandering(5.0)
        wheels = simulate_wheels(track, SILENT_WHEELS, np.random.default_rng(0))
        steps = np.diff(wheels, axis=0)
        forward, left = (steps[:, 0] + steps[:, 1]) / math.sqrt(2), (steps[:, 0] - steps[:, 1]) / math.sqrt(2)
        driven = track.driven[1:].reshape(-1, 2, 3).sum(axis=1)
        np.testing.assert_allclose(np.column_stack((forward, left)), driven[:, :2], atol=1e-12)

    def test_the_scale_error_stays_below_its_bound_and_fills_it(self) -> None:
        track = driving((1.0, 0.0, 0.0), 1.0)
        noise = WheelNoise(scale_error=0.01, slip_m=0.0)
        expected = math.cos(math.pi / 4)
        errors = np.array(
            [simulate_wheels(track, noise, np.random.default_rng(s))[-1] / expected - 1.0 for s in range(300)]
        )
        assert np.abs(errors).max() < 0.01
        assert errors.std() == pytest.approx(0.01 / math.sqrt(3), rel=0.08)

    def test_slip_grows_with_the_root_of_the_way(self) -> None:
        noise = WheelNoise(a_dir_rad=0.0, b_dir_rad=0.01, scale_error=0.0, slip_m=0.004)
        for seconds in (1.0, 9.0):
            track = driving((1.0, 0.0, 0.0), seconds)
            ends = np.array([simulate_wheels(track, noise, np.random.default_rng(s))[-1] for s in range(300)])
            assert (ends - seconds).std() == pytest.approx(0.004 * math.sqrt(seconds), rel=0.09)


class TestOmniBases:
    @pytest.mark.parametrize("wheels", [3, 4])
    def test_wheel_speeds_are_those_of_the_points_where_the_wheels_stand(self, wheels: int) -> None:
        base = omni_base(wheels, radius_m=0.25)
        body = np.array([[0.7, -0.3, 1.1]])
        first = math.radians(60 if wheels == 3 else 45)
        for k, speed in enumerate((body @ base.T)[0]):
            place = first + 2 * math.pi / wheels * k
            vx = body[0, 0] - body[0, 2] * 0.25 * math.sin(place)
            vy = body[0, 1] + body[0, 2] * 0.25 * math.cos(place)
            assert speed == pytest.approx(-math.sin(place) * vx + math.cos(place) * vy)

    @pytest.mark.parametrize("wheels", [3, 4])
    def test_the_body_velocity_comes_back_from_the_wheels(self, wheels: int) -> None:
        base, body = omni_base(wheels), np.random.default_rng(2).normal(size=(20, 3))
        np.testing.assert_allclose(body @ base.T @ np.linalg.pinv(base).T, body, atol=1e-12)

    def test_four_wheels_average_an_error_that_three_cannot(self) -> None:
        errors = np.random.default_rng(5).normal(size=(4000, 4))
        four, three = (np.linalg.pinv(omni_base(wheels)) for wheels in (4, 3))
        assert (errors @ four.T)[:, 0].std() < (errors[:, :3] @ three.T)[:, 0].std()

    def test_other_numbers_and_useless_directions_are_refused(self) -> None:
        with pytest.raises(InputError, match="3 and 4 omni wheels, not 5"):
            omni_base(5)
        with pytest.raises(InputError, match="tell forward, sideways and rotation apart"):
            wheels_from_body(np.zeros(3), np.full(3, 0.2))
        with pytest.raises(InputError, match="did you mean 'three-wheels'"):
            named_base("three-wheel")


class TestOdometry:
    @pytest.mark.parametrize("base", ["three-wheels", "four-wheels", "legs"])
    def test_without_noise_it_is_the_way_from_the_start(self, base: str) -> None:
        track = driving((0.9, 0.3, -0.8), 6.0)
        noise = SILENT_ODOMETRY.model_copy(update={"base": base})
        odometry = simulate_odometry(track, noise, np.random.default_rng(0))
        expected = track.pose_at(0.0).inverse().compose(track.pose_at(6.0))
        np.testing.assert_allclose(odometry[-1], expected, atol=1e-9)

    def test_without_noise_it_follows_a_wandering_robot_within_a_millimetre(self) -> None:
        track = wandering(20.0)
        odometry = simulate_odometry(track, SILENT_ODOMETRY, np.random.default_rng(0))
        np.testing.assert_allclose(odometry[:, :2], track.poses[::2, :2], atol=1e-3)

    def test_scale_errors_have_the_documented_size_and_both_signs(self) -> None:
        noise = SILENT_ODOMETRY.model_copy(update={"scale_error": 0.025, "scale_spread": 0.005})
        track = driving((1.0, 0.0, 0.0), 1.0)
        errors = np.array([simulate_odometry(track, noise, np.random.default_rng(s))[-1, 0] - 1.0 for s in range(200)])
        assert np.abs(errors).min() >= 0.02
        assert np.abs(errors).max() <= 0.03
        assert 0.4 < np.mean(errors > 0) < 0.6

    def test_position_noise_grows_with_the_root_of_the_travel(self) -> None:
        noise = SILENT_ODOMETRY.model_copy(update={"travel_noise_m": 0.02})
        for seconds in (1.0, 8.0):
            track = driving((1.0, 0.0, 0.0), seconds)
            ends = np.array([simulate_odometry(track, noise, np.random.default_rng(s))[-1] for s in range(300)])
            deviations = (ends - ends.mean(axis=0)).std(axis=0)
            np.testing.assert_allclose(deviations[:2], 0.02 * math.sqrt(seconds), rtol=0.12)

    def test_heading_noise_grows_with_the_root_of_travel_and_turn(self) -> None:
        noise = SILENT_ODOMETRY.model_copy(update={"travel_noise_rad": 0.01, "turn_noise_rad": 0.02})
        for twist, expected in (((2.0, 0.0, 0.0), 0.01 * math.sqrt(8.0)), ((0.0, 0.0, 0.5), 0.02 * math.sqrt(2.0))):
            track = driving(twist, 4.0)
            turns = np.array([simulate_odometry(track, noise, np.random.default_rng(s))[-1, 2] for s in range(300)])
            assert (turns - turns.mean()).std() == pytest.approx(expected, rel=0.1)

    def test_a_standing_robot_measures_no_motion_at_all(self) -> None:
        odometry = simulate_odometry(standing_track(Pose(0, 0, 1), 5.0), OdometryNoise(), np.random.default_rng(0))
        np.testing.assert_array_equal(odometry, 0.0)


class TestGyroAndCompass:
    def test_the_integrated_gyro_is_the_turn(self) -> None:
        track = wandering(10.0)
        imu = simulate_imu(track, SILENT_IMU, np.random.default_rng(0))
        turned = np.cumsum(imu[1:-1, 5]) * SENSOR_PERIOD_S
        headings = track.poses[1::2, 2]  # half a sample after each stamp
        np.testing.assert_allclose(turned, headings[1:] - headings[0], atol=1e-9)

    def test_the_gyro_is_not_late(self) -> None:
        track = wandering(10.0)
        imu = simulate_imu(track, SILENT_IMU, np.random.default_rng(0))
        rates = np.gradient(track.poses[:, 2], STEP_S)[::2]
        np.testing.assert_allclose(imu[1:-1, 5], rates[1:-1], atol=1e-9)

    def test_yaw_roll_and_pitch_are_twenty_milliseconds_old(self) -> None:
        track = driving((0.0, 0.0, 1.0), 2.0)
        leaning = np.stack((0.1 * track.times_s, -0.05 * track.times_s), axis=1)
        track = Track(track.poses, track.shoved, track.carried, leaning, track.covered)
        imu = simulate_imu(track, SILENT_IMU, np.random.default_rng(0))
        times = SENSOR_PERIOD_S * np.arange(len(imu))[1:]
        np.testing.assert_allclose(imu[1:, 2], 0.4 + times - 0.02, atol=1e-9)
        np.testing.assert_allclose(imu[1:, 0], 0.1 * (times - 0.02), atol=1e-9)
        np.testing.assert_allclose(imu[1:, 1], -0.05 * (times - 0.02), atol=1e-9)
        np.testing.assert_allclose(imu[1:, 3:5], [[0.1, -0.05]] * len(times), atol=1e-9)

    def test_bias_noise_and_walk_have_their_documented_moments(self) -> None:
        track = standing_track(Pose(0, 0, 0), 60.0)
        noise = ImuNoise()
        runs = np.degrees([simulate_imu(track, noise, np.random.default_rng(s))[1:, 5] for s in range(60)])
        assert np.diff(runs, axis=1).std() / math.sqrt(2) == pytest.approx(noise.gyro_noise_deg_s, rel=0.02)
        first = runs[:, :100].mean(axis=1)
        assert 0.3 < np.mean(first > 0) < 0.7
        assert np.abs(first).min() > 0.18
        assert np.abs(first).max() < 0.52 + 0.1
        grown = runs[:, -100:].mean(axis=1) - first
        assert grown.std() == pytest.approx(noise.gyro_bias_walk_deg_s * math.sqrt(58.0), rel=0.3)

    def test_the_compass_drifts_slowly_by_the_documented_amount(self) -> None:
        track = standing_track(Pose(0, 0, 0), 300.0)
        noise = SILENT_IMU.model_copy(update={"compass_drift_deg": 3.5})
        runs = [np.degrees(simulate_imu(track, noise, np.random.default_rng(s))[:, 2]) for s in range(20)]
        assert np.sqrt(np.mean(np.square(runs))) == pytest.approx(3.5, rel=0.15)
        assert np.abs(np.diff(runs, axis=1)).max() < 1.0
        lag = round(noise.compass_drift_time_s / SENSOR_PERIOD_S)
        alike = np.mean([np.mean(run[lag:] * run[:-lag]) / np.mean(run**2) for run in runs])
        assert alike == pytest.approx(math.exp(-1.0), abs=0.15)

    def test_the_place_turns_the_compass_smoothly_and_always_alike(self) -> None:
        places = np.random.default_rng(0).uniform(-8, 8, (400, 2))
        values = [PlaceDisturbance(3.0, np.random.default_rng(s)).at(places) for s in range(30)]
        assert np.sqrt(np.mean(np.square(values))) == pytest.approx(3.0, rel=0.1)
        disturbance = PlaceDisturbance(3.0, np.random.default_rng(1))
        np.testing.assert_array_equal(disturbance.at(places), disturbance.at(places))
        assert np.abs(disturbance.at(places) - disturbance.at(places + 0.01)).max() < 0.2

    def test_lean_has_a_constant_bias_below_its_bound_and_white_noise(self) -> None:
        noise = ImuNoise()
        track = standing_track(Pose(0, 0, 0), 20.0)
        runs = np.degrees([simulate_imu(track, noise, np.random.default_rng(s))[:, :2] for s in range(40)])
        means = runs.mean(axis=1)
        assert np.abs(means).max() < noise.tilt_bias_deg + 0.05
        assert means.std() == pytest.approx(noise.tilt_bias_deg / math.sqrt(3), rel=0.2)
        assert (runs - means[:, np.newaxis]).std() == pytest.approx(noise.tilt_noise_deg, rel=0.03)


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

    def test_another_setting_of_one_sensor_leaves_the_others_as_they_were(self) -> None:
        track = wandering(2.0)
        one = simulate_sensors(track, SensorSettings(), np.random.default_rng(3))
        other = simulate_sensors(track, SensorSettings(wheels=WheelNoise(slip_m=0.1)), np.random.default_rng(3))
        np.testing.assert_array_equal(one.imu.values, other.imu.values)
        np.testing.assert_array_equal(one.odometry.values, other.odometry.values)
        assert not np.array_equal(one.wheels.values, other.wheels.values)

    def test_a_sample_has_arrived_with_the_image_of_the_same_stamp(self) -> None:
        log = simulate_sensors(driving((1.0, 0.0, 0.0), 1.0), SensorSettings(), np.random.default_rng(0))
        stamps = np.array([100_000_000, 100_000_001, 102_000_000, 200_000_000])
        assert arrived_by(log.wheels, stamps) == [0, 6, 6, 6, 11]

    def test_arrays_of_another_shape_are_no_track(self) -> None:
        none: FloatArray = np.zeros((5, 3))
        with pytest.raises(ValueError, match=r"a track needs \(N, 3\)"):
            Track(none, none, none, np.zeros((5, 3)), np.zeros(5, dtype=np.bool_))
