"""What the robot's own sensors make of a track: odometry, measuring wheels, gyro, compass, roll and pitch.

The columns, units and signs are those of docs/how-to-recording.md. All errors are settings; set to zero, the sensors
tell the truth.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import AfterValidator, Field, model_validator
from typing_extensions import Self

from touchline.config import Settings
from touchline.errors import InputError
from touchline.geometry import FloatArray, IntArray, wrap_angles
from touchline.messages import did_you_mean
from touchline.types import Samples
from touchline_lab.simulation.robot.noise import PlaceDisturbance, drift, random_walk
from touchline_lab.simulation.robot.track import STEP_S, Track, poses_from_twists

SENSOR_PERIOD_S = 0.02
BASES = ("three-wheels", "four-wheels", "legs")
_STRIDE = round(SENSOR_PERIOD_S / STEP_S)
_DIGITS = 6  # the recordings' tables hold micrometres and microradians; live samples are the same numbers


def _grows(low_and_high: tuple[float, float]) -> tuple[float, float]:
    low, high = low_and_high
    if not 0.0 <= low <= high:
        raise ValueError(f"is a range from low to high, both zero or more; [{low:g}, {high:g}] is none")
    return low_and_high


Range = Annotated[tuple[float, float], AfterValidator(_grows)]


class OdometryNoise(Settings):
    """Dead reckoning from the driven wheels or the steps of a walking robot."""

    base: str = Field("three-wheels", description="three-wheels, four-wheels or legs")
    scale_error: float = Field(0.025, ge=0, lt=1, description="mean size of each scale's relative error")
    scale_spread: float = Field(0.005, ge=0, lt=1, description="half width of the even distribution of that size")
    wheel_scale: float = Field(0.002, ge=0, description="standard deviation of each wheel's own relative error")
    travel_noise_m: float = Field(0.015, ge=0, description="position error after one metre, per axis (m, root of way)")
    travel_noise_rad: float = Field(0.004, ge=0, description="heading error after one metre (rad, root of way)")
    turn_noise_rad: float = Field(0.01, ge=0, description="heading error after one radian (rad, root of turn)")


class WheelNoise(Settings):
    """Two free-running measuring wheels, each on the line through the base origin along its rolling direction."""

    a_dir_rad: float = Field(math.pi / 4, description="rolling direction of wheel a in the base frame (rad)")
    b_dir_rad: float = Field(-math.pi / 4, description="rolling direction of wheel b in the base frame (rad)")
    scale_error: float = Field(0.01, ge=0, lt=1, description="largest relative error of a wheel's circumference")
    slip_m: float = Field(0.002, ge=0, description="error of a wheel after one metre of its way (m, root of way)")

    @model_validator(mode="after")
    def _tell_a_plane(self) -> Self:
        if abs(math.sin(self.a_dir_rad - self.b_dir_rad)) < 1e-3:
            raise ValueError("both wheels roll along the same line; a_dir_rad and b_dir_rad have to differ")
        return self


class ImuNoise(Settings):
    """Gyro, compass (or AHRS heading) and lean."""

    gyro_bias_deg_s: Range = Field((0.2, 0.5), description="range of the yaw rate's first bias; its sign is random")
    tilt_rate_bias_deg_s: float = Field(0.12, ge=0, description="size of the constant bias of roll's and pitch's rates")
    gyro_bias_walk_deg_s: float = Field(0.05, ge=0, description="random walk of it after one second (root of time)")
    gyro_noise_deg_s: float = Field(0.15, ge=0, description="standard deviation of one sample")
    compass_drift_deg: float = Field(3.5, ge=0, description="root mean square of the slow drift")
    compass_drift_time_s: float = Field(15.0, gt=0, description="time constant of the drift's exponential correlation")
    compass_place_deg: float = Field(3.0, ge=0, description="root mean square of the disturbance over the places")
    compass_noise_deg: float = Field(0.5, ge=0, description="standard deviation of one sample")
    tilt_noise_deg: float = Field(0.3, ge=0, description="standard deviation of one sample of roll or pitch")
    tilt_bias_deg: float = Field(0.5, ge=0, description="largest constant error of roll and of pitch")
    tilt_and_yaw_lag_s: float = Field(0.02, ge=0, le=1, description="how late roll, pitch and yaw are; rates are not")


class SensorSettings(Settings):
    """All sensors beside the camera."""

    odometry: OdometryNoise = OdometryNoise()
    wheels: WheelNoise = WheelNoise()
    imu: ImuNoise = ImuNoise()


class SensorLog(NamedTuple):
    """All samples of a run. odometry: x, y, theta; wheels: a, b; imu: roll, pitch, yaw, gx, gy, gz."""

    odometry: Samples
    wheels: Samples
    imu: Samples


def simulate_sensors(track: Track, settings: SensorSettings, rng: np.random.Generator) -> SensorLog:
    """The samples of a whole track, every SENSOR_PERIOD_S from t = 0 on.

    Each sensor draws from a generator of its own, so that another setting of one leaves the others as they were.
    """
    odometry_rng, wheel_rng, imu_rng = rng.spawn(3)
    return SensorLog(
        _stamped(simulate_odometry(track, settings.odometry, odometry_rng)),
        _stamped(simulate_wheels(track, settings.wheels, wheel_rng)),
        _stamped(simulate_imu(track, settings.imu, imu_rng)),
    )


def simulate_odometry(track: Track, noise: OdometryNoise, rng: np.random.Generator) -> FloatArray:
    """(M, 3) x, y (m), theta (rad, wrapped) in the odometry frame: the base frame at t = 0."""
    driven = _per_sample(track.driven)
    size = noise.scale_error + noise.scale_spread * rng.uniform(-1.0, 1.0, 3)
    scale = 1.0 + size * rng.choice((-1.0, 1.0), 3)
    base = named_base(noise.base)
    measured = driven.copy()
    if base is not None:
        travels = driven @ base.T * (1.0 + noise.wheel_scale * rng.standard_normal(len(base)))
        measured = travels @ np.linalg.pinv(base).T
    measured *= scale
    way, turn = np.hypot(driven[:, 0], driven[:, 1]), np.abs(driven[:, 2])
    measured[:, :2] += noise.travel_noise_m * np.sqrt(way)[:, np.newaxis] * rng.standard_normal((len(way), 2))
    heading_sd = np.sqrt(noise.travel_noise_rad**2 * way + noise.turn_noise_rad**2 * turn)
    measured[:, 2] += heading_sd * rng.standard_normal(len(way))
    poses = poses_from_twists(np.zeros(3), measured)
    poses[:, 2] = wrap_angles(poses[:, 2])
    return np.concatenate((np.zeros((1, 3)), poses))


def wheels_from_body(directions_rad: FloatArray, levers_m: FloatArray) -> FloatArray:
    """(K, 3) wheel travels of a base motion (forward, left, rotation); its pseudo-inverse is the least-squares motion.

    Each omni wheel rolls along its own direction (K,), base frame, and is free across it. levers_m: (K,) arm of a
    rotation of the base about its origin. Raises InputError unless they tell forward, sideways and rotation apart.
    """
    matrix = np.column_stack((np.cos(directions_rad), np.sin(directions_rad), levers_m))
    if np.linalg.matrix_rank(matrix, tol=1e-6) < 3:
        raise InputError("wheels: these directions and levers can't tell forward, sideways and rotation apart")
    return matrix


def omni_base(wheels: int, radius_m: float = 0.2) -> FloatArray:
    """`wheels_from_body` of the usual base of three (at 60°, 180°, 300°) or four wheels (45°, 135°, ...), tangential.

    Raises InputError for another number.
    """
    if wheels not in (3, 4):
        raise InputError(f"wheels: there are bases with 3 and 4 omni wheels, not {wheels}")
    first = math.pi / 3.0 if wheels == 3 else math.pi / 4.0
    places = first + 2.0 * math.pi / wheels * np.arange(wheels)
    return wheels_from_body(places + 0.5 * math.pi, np.full(wheels, radius_m))


def named_base(name: str) -> FloatArray | None:
    """The base of a scenario's robot; None for legs, which have no wheels. Raises InputError for another name."""
    if name not in BASES:
        raise InputError(f"base '{name}' is unknown; {did_you_mean(name, BASES)}")
    return None if name == "legs" else omni_base(3 if name == "three-wheels" else 4)


def simulate_wheels(track: Track, noise: WheelNoise, rng: np.random.Generator) -> FloatArray:
    """(M, 2) cumulative travel a, b (m) of the measuring wheels; a rotation about the origin does not turn them."""
    driven = _per_sample(track.driven)
    directions = np.array([noise.a_dir_rad, noise.b_dir_rad])
    travels = driven[:, :2] @ np.stack((np.cos(directions), np.sin(directions)))
    measured = travels * (1.0 + noise.scale_error * rng.uniform(-1.0, 1.0, 2))
    measured += noise.slip_m * np.sqrt(np.abs(travels)) * rng.standard_normal(travels.shape)
    return np.concatenate((np.zeros((1, 2)), np.cumsum(measured, axis=0)))


def simulate_imu(track: Track, noise: ImuNoise, rng: np.random.Generator) -> FloatArray:
    """(M, 6) roll, pitch, yaw (rad; late by the lag), gx, gy, gz (rad/s; means over the 20 ms around the stamp)."""
    deg = math.pi / 180.0
    times = track.times_s[::_STRIDE]
    lagged = np.maximum(times - noise.tilt_and_yaw_lag_s, 0.0)
    rows = np.rint(lagged / STEP_S).astype(np.int64)
    n = len(times)
    tilt = np.stack([np.interp(lagged, track.times_s, lean) for lean in track.attitude.T], axis=1)
    tilt += rng.uniform(-1.0, 1.0, 2) * noise.tilt_bias_deg * deg
    tilt += noise.tilt_noise_deg * deg * rng.standard_normal((n, 2))
    heading = _late_heading(track, lagged)
    place = PlaceDisturbance(noise.compass_place_deg * deg, rng)
    heading += place.at(track.poses[rows, :2])
    heading += drift(n, SENSOR_PERIOD_S, noise.compass_drift_deg * deg, noise.compass_drift_time_s, rng)
    heading += noise.compass_noise_deg * deg * rng.standard_normal(n)
    rates = _middle_rates(np.column_stack((track.attitude, np.cumsum(track.turned_rad))))
    low, high = noise.gyro_bias_deg_s
    bias = np.array([noise.tilt_rate_bias_deg_s, noise.tilt_rate_bias_deg_s, rng.uniform(low, high)])
    rates += bias * rng.choice((-1.0, 1.0), 3) * deg
    rates[:, 2] += random_walk(n, SENSOR_PERIOD_S, noise.gyro_bias_walk_deg_s * deg, rng)
    rates += noise.gyro_noise_deg_s * deg * rng.standard_normal((n, 3))
    return np.column_stack((tilt, wrap_angles(heading), rates))


def arrived_by(samples: Samples, stamps_ns: IntArray) -> list[int]:
    """How many of the samples have arrived by each of the stamps (N,), with 0 for the time before all in front."""
    return [0, *np.searchsorted(samples.stamp_ns, stamps_ns, side="right").tolist()]


def _late_heading(track: Track, times_s: FloatArray) -> FloatArray:
    """Continuous heading at times, which jumps rather than turns where the robot was carried."""
    carried = np.cumsum(track.carried[:, 2])
    rows = np.minimum(np.floor(times_s / STEP_S + 1e-9).astype(np.int64), len(carried) - 1)
    return np.interp(times_s, track.times_s, track.poses[:, 2] - carried) + carried[rows]


def _middle_rates(angles: FloatArray) -> FloatArray:
    """(M, k) rates at the sensors' stamps of angles (N, k) at the track's rows: over half a period before and after."""
    middle = np.arange(0, len(angles), _STRIDE)
    before, after = np.maximum(middle - _STRIDE // 2, 0), np.minimum(middle + _STRIDE // 2, len(angles) - 1)
    return (angles[after] - angles[before]) / (STEP_S * (after - before))[:, np.newaxis]


def _per_sample(steps: FloatArray) -> FloatArray:
    """Motions (M - 1, k) between the sensors' samples from those (N, k) of the track's steps (row 0 is before them)."""
    n = (len(steps) - 1) // _STRIDE
    return steps[1 : 1 + n * _STRIDE].reshape(n, _STRIDE, -1).sum(axis=1)


def _stamped(values: FloatArray) -> Samples:
    stamps: IntArray = np.arange(len(values), dtype=np.int64) * round(SENSOR_PERIOD_S * 1e9)
    return Samples(stamps, np.round(values, _DIGITS))
