"""Every noise setting alone, against the moment that it names: one per cent off is not seen, a tenth is."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
from simulated import standing_track
from test_sim_sensors import SILENT_IMU, SILENT_ODOMETRY, SILENT_WHEELS, driving

from touchline.geometry import FloatArray, Pose
from touchline_lab.simulation.robot.noise import drift, random_walk
from touchline_lab.simulation.robot.sensors import (
    SENSOR_PERIOD_S,
    omni_base,
    simulate_imu,
    simulate_odometry,
    simulate_wheels,
)

STANDING = standing_track(Pose(0.0, 0.0, 0.0), 60.0)
ROLL, PITCH, YAW, GX, GY, GZ = range(6)


def has_deviation(samples: npt.ArrayLike, expected: float) -> None:
    """Chi-square: the mean square of N independent normal samples lies within 4.2 deviations of what is expected."""
    values: FloatArray = np.asarray(samples, dtype=np.float64).ravel()
    ratio = float(np.mean(values**2)) / expected**2
    assert abs(ratio - 1.0) < 4.2 * math.sqrt(2.0 / len(values)), f"{len(values)} samples, ratio {ratio:.3f}"


def imu_alone(seed: int = 0, **settings: object) -> FloatArray:
    """(M, 6) in degrees and degrees per second: a standing robot's IMU with a single error."""
    noise = SILENT_IMU.model_copy(update=settings)
    return np.degrees(simulate_imu(STANDING, noise, np.random.default_rng(seed)))


def test_travel_noise_is_white_and_of_its_size_per_root_metre() -> None:
    noise = SILENT_ODOMETRY.model_copy(update={"travel_noise_m": 0.02})
    odometry = simulate_odometry(driving((1.5, 0.0, 0.0), 60.0), noise, np.random.default_rng(1))
    steps = np.diff(odometry[:, :2], axis=0) - [1.5 * SENSOR_PERIOD_S, 0.0]
    has_deviation(steps, 0.02 * math.sqrt(1.5 * SENSOR_PERIOD_S))
    has_deviation(np.add.reduceat(steps, np.arange(0, len(steps), 10)), 0.02 * math.sqrt(15.0 * SENSOR_PERIOD_S))


@pytest.mark.parametrize("wheels", [3, 4])
def test_scale_errors_of_single_wheels_mix_as_the_base_is_built(wheels: int) -> None:
    base = omni_base(wheels)
    noise = SILENT_ODOMETRY.model_copy(
        update={"wheel_scale": 0.002, "base": {3: "three-wheels", 4: "four-wheels"}[wheels]}
    )
    track = driving((1.0, 0.0, 0.0), 0.2)
    ends = [simulate_odometry(track, noise, np.random.default_rng(seed))[-1, 0] for seed in range(1500)]
    share = np.linalg.pinv(base)[0] * base[:, 0]
    has_deviation(np.array(ends) / 0.2 - 1.0, 0.002 * float(np.linalg.norm(share)))


def test_slip_is_white_and_of_its_size_per_root_metre() -> None:
    noise = SILENT_WHEELS.model_copy(update={"slip_m": 0.004})
    wheels = simulate_wheels(driving((2.0, 0.0, 0.0), 60.0), noise, np.random.default_rng(2))
    way = 2.0 * SENSOR_PERIOD_S * math.cos(math.pi / 4)
    has_deviation(np.diff(wheels, axis=0) - way, 0.004 * math.sqrt(way))


def test_the_gyros_bias_walks_as_the_root_of_time() -> None:
    """As an Allan plot would show it: the difference over a time grows with its root."""
    rates = np.stack([imu_alone(seed, gyro_bias_walk_deg_s=0.05)[:, GZ] for seed in range(8)])
    for lag in (1, 10, 100):
        apart = np.diff(rates[:, 1::lag], axis=1)
        has_deviation(apart, 0.05 * math.sqrt(lag * SENSOR_PERIOD_S))
    assert not np.any(imu_alone(0, gyro_bias_walk_deg_s=0.05)[:, [GX, GY]])


@pytest.mark.parametrize(
    ("setting", "size", "columns"),
    [
        ("gyro_noise_deg_s", 0.15, [GX, GY, GZ]),
        ("compass_noise_deg", 0.5, [YAW]),
        ("tilt_noise_deg", 0.3, [ROLL, PITCH]),
    ],
)
def test_white_noise_has_its_size_and_is_in_its_own_columns(setting: str, size: float, columns: list[int]) -> None:
    samples = np.concatenate([imu_alone(seed, **{setting: size}) for seed in range(4)])
    has_deviation(samples[:, columns], size)
    has_deviation((samples[1:] - samples[:-1])[::2, columns], math.sqrt(2.0) * size)
    assert not np.any(samples[:, [column for column in range(6) if column not in columns]])


def test_rates_of_roll_and_pitch_have_a_constant_bias_of_either_sign() -> None:
    biases = np.array([imu_alone(seed, tilt_rate_bias_deg_s=0.12)[:, [GX, GY]] for seed in range(40)])
    np.testing.assert_allclose(np.abs(biases), 0.12, rtol=1e-9)
    assert 0.2 < np.mean(biases[:, 0] > 0.0) < 0.8


def test_the_compass_drifts_with_its_size_and_its_time_constant() -> None:
    noise = SILENT_IMU.model_copy(update={"compass_drift_deg": 3.5, "compass_drift_time_s": 15.0})
    track = standing_track(Pose(0.0, 0.0, 0.0), 15.1)
    runs = [np.degrees(simulate_imu(track, noise, np.random.default_rng(seed))[:, YAW]) for seed in range(800)]
    has_deviation([run[0] for run in runs], 3.5)
    keep = math.exp(-SENSOR_PERIOD_S / 15.0)
    has_deviation([run[1:] - keep * run[:-1] for run in runs[:40]], 3.5 * math.sqrt(1.0 - keep * keep))
    later = round(15.0 / SENSOR_PERIOD_S)
    has_deviation([run[later] - math.exp(-1.0) * run[0] for run in runs], 3.5 * math.sqrt(1.0 - math.exp(-2.0)))


def test_the_place_turns_the_compass_by_its_size_over_all_halls() -> None:
    noise = SILENT_IMU.model_copy(update={"compass_place_deg": 3.0})
    track = standing_track(Pose(2.0, -1.0, 0.0), 0.1)
    turned = [np.degrees(simulate_imu(track, noise, np.random.default_rng(seed))[0, YAW]) for seed in range(1500)]
    has_deviation(turned, 3.0)


def test_the_processes_start_where_they_should() -> None:
    assert random_walk(5, 0.02, 1.0, np.random.default_rng(0))[0] == 0.0
    has_deviation([drift(1, 0.02, 2.0, 5.0, np.random.default_rng(seed))[0] for seed in range(2000)], 2.0)
