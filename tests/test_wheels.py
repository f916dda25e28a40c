"""Odometry from two measuring wheels and a gyro: exact on exact kinematics, honest about gaps, restarts and noise."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from fakes import write_recording
from small_recordings import write_sensors

from touchline.api import prepare
from touchline.cli import main
from touchline.errors import InputError
from touchline.geometry import Pose, wrap_angle
from touchline.motion import DeadReckoning, GyroSettings, Motion, MotionHistory, WheelSettings, wheel_odometry
from touchline.motion import gyro as gyro_module
from touchline.motion.wheel_pair import WheelPair
from touchline.published.iris_fusion.system import IrisFusion
from touchline.types import Frame, Samples

MS = 1_000_000
QUARTER = math.pi / 4
MOUNTS = [(QUARTER, -QUARTER, 0.0, 0.0), (0.3, 1.9, 0.0, 0.0), (2.0, -0.4, 0.21, -0.13), (0.0, math.pi / 2, 0.1, 0.1)]


class Drive:
    """Constant velocity: forward and left speed (m/s, robot frame) and turn rate (rad/s), in closed form."""

    def __init__(self, forward: float, left: float, rate: float) -> None:
        self.forward, self.left, self.rate = forward, left, rate

    def pose(self, t: float) -> Pose:
        """start_from_robot after t seconds: p(t) = ∫ R(rate·τ) v dτ."""
        if self.rate == 0.0:
            return Pose(self.forward * t, self.left * t, 0.0)
        s, c = math.sin(self.rate * t) / self.rate, (1.0 - math.cos(self.rate * t)) / self.rate
        return Pose(self.forward * s - self.left * c, self.forward * c + self.left * s, wrap_angle(self.rate * t))

    def wheels(self, times_ms: np.ndarray, mount: tuple[float, float, float, float]) -> Samples:
        a_dir, b_dir, a_lever, b_lever = mount
        a = self.forward * math.cos(a_dir) + self.left * math.sin(a_dir) + a_lever * self.rate
        b = self.forward * math.cos(b_dir) + self.left * math.sin(b_dir) + b_lever * self.rate
        return Samples(stamps(times_ms), np.outer(times_ms / 1000.0, [a, b]))

    def gyro(self, times_ms: np.ndarray) -> Samples:
        return Samples(stamps(times_ms), np.tile([0.3, -0.2, self.rate], (len(times_ms), 1)))

    def odometry(self, times_ms: np.ndarray) -> Samples:
        return Samples(stamps(times_ms), np.array([self.pose(t / 1000.0) for t in times_ms]))


def stamps(times_ms: np.ndarray) -> np.ndarray:
    return np.rint(times_ms * MS).astype(np.int64)


def part(samples: Samples | None, after_ns: int, until_ns: int) -> Samples | None:
    if samples is None:
        return None
    kept = (samples.stamp_ns > after_ns) & (samples.stamp_ns <= until_ns)
    return Samples(samples.stamp_ns[kept], samples.values[kept]) if kept.any() else None


def frames(
    times_ms: list[float], wheels: Samples | None, gyro: Samples | None, odometry: Samples | None = None
) -> list[Frame]:
    """Frames as a recording gives them: each with the samples since the one before."""
    ends = [-1, *(round(t * MS) for t in times_ms)]
    return [
        Frame(end, wheels=part(wheels, start, end), gyro=part(gyro, start, end), odometry=part(odometry, start, end))
        for start, end in itertools.pairwise(ends)
    ]


def reckoning(
    directions_rad: tuple[float, ...] | None, wheels: WheelSettings | None = None, gyro: GyroSettings | None = None
) -> DeadReckoning:
    """Dead reckoning by a motion history with wheels that roll in the first two of these directions."""
    directions = None if directions_rad is None else (directions_rad[0], directions_rad[1])
    return DeadReckoning(MotionHistory(None, None, gyro, wheels or WheelSettings(), directions))


def take(odometry: DeadReckoning, frame: Frame) -> Motion:
    """The motion since the frame before."""
    odometry.history.add(frame)
    return odometry.advance(frame.stamp_ns)


def reckon(
    mount: tuple[float, float, float, float],
    given: list[Frame],
    start: Pose | None = None,
    gyro: GyroSettings | None = None,
    **options: float,
) -> DeadReckoning:
    odometry = reckoning(mount, WheelSettings(a_lever_m=mount[2], b_lever_m=mount[3], **options), gyro)
    odometry.reset(start)
    for frame in given:
        take(odometry, frame)
    return odometry


def assert_same(pose: Pose, expected: Pose, abs_m: float = 1e-9) -> None:
    assert pose.distance_to(expected) < abs_m
    assert abs(wrap_angle(pose.heading - expected.heading)) < abs_m


@pytest.mark.parametrize("mount", MOUNTS)
@pytest.mark.parametrize(
    "drive", [Drive(2.0, 0.0, 0.0), Drive(1.0, 0.0, 2.0), Drive(0.7, -1.3, -4.0), Drive(0.0, 0.0, 9.0)]
)
def test_arcs_are_reckoned_exactly_at_any_mounting_angle_and_lever(
    mount: tuple[float, float, float, float], drive: Drive
) -> None:
    """Translation while rotating, too: coarse samples make no error, because the velocity was constant."""
    times = np.arange(0, 2001, 50.0)
    start = Pose(1.0, -2.0, 2.5)
    odometry = reckon(mount, frames([0.0, 130.0, 707.0, 2000.0], drive.wheels(times, mount), drive.gyro(times)), start)
    assert_same(odometry.pose, start.compose(drive.pose(2.0)))


@pytest.mark.parametrize("b_dir", [QUARTER, QUARTER + math.pi, QUARTER - 0.1, QUARTER + math.pi + 0.1])
def test_parallel_wheels_are_refused_in_words(b_dir: float) -> None:
    with pytest.raises(InputError, match=r"45\.0° \(a\).*parallel.*can't tell forward from sideways"):
        reckoning((QUARTER, b_dir))


def test_scales_and_bias_correct_the_readings() -> None:
    drive, mount = Drive(0.9, -0.3, 1.1), MOUNTS[2]
    times = np.arange(0, 1001, 20.0)
    wheels, gyro = drive.wheels(times, mount), drive.gyro(times)
    wrong = Samples(wheels.stamp_ns, wheels.values / [1.02, 0.97])
    biased = Samples(gyro.stamp_ns, gyro.values / 1.01 + 0.05)
    given = frames([0.0, 1000.0], wrong, biased)
    right = reckon(mount, given, gyro=GyroSettings(scale=1.01, bias_rad_s=0.05), a_scale=1.02, b_scale=0.97)
    assert_same(right.pose, drive.pose(1.0))
    assert reckon(mount, given).pose.distance_to(drive.pose(1.0)) > 0.01


@pytest.mark.parametrize("both", [True, False])
def test_a_counter_at_zero_again_moves_nothing(both: bool) -> None:
    drive, mount = Drive(1.0, 0.4, 0.5), MOUNTS[0]
    times = np.arange(0, 3001, 20.0)
    wheels = drive.wheels(times, mount)
    values = wheels.values.copy()
    again = times >= 2000.0
    columns = [0, 1] if both else [0]
    values[np.ix_(again, columns)] -= values[times == 2000.0][:, columns]
    given = frames([0.0, 1900.0, 2050.0, 3000.0], Samples(wheels.stamp_ns, values), drive.gyro(times))
    odometry = reckon(mount, given[:2])
    motion = take(odometry, given[2])
    assert motion.missing_s == pytest.approx(0.02)
    assert np.sqrt(motion.covariance[0, 0]) > 0.02
    take(odometry, given[3])
    assert odometry.wheels.wheels.restarts == 1
    assert_same(odometry.pose, drive.pose(3.0), 1e-6)


@pytest.mark.parametrize(
    ("no_wheels_s", "no_gyro_s", "missing_s"),
    [((0.3, 0.6), (1.2, 1.7), 0.8), ((0.3, 0.8), (0.5, 1.0), 0.7), ((0.2, 1.4), (0.5, 1.0), 1.2)],
)
def test_gaps_of_wheels_and_gyro_count_once(
    no_wheels_s: tuple[float, float], no_gyro_s: tuple[float, float], missing_s: float
) -> None:
    """Apart, overlapping, and one within the other. Counters say nothing of a gap after which they go on elsewhere."""
    drive, mount = Drive(1.0, 0.0, 0.0), MOUNTS[0]
    times = np.arange(0, 2001, 20.0)
    known, felt = (times[(times <= 1000 * first) | (times >= 1000 * last)] for first, last in (no_wheels_s, no_gyro_s))
    wheels = drive.wheels(known, mount)
    wheels.values[known >= 1000 * no_wheels_s[1]] += 20.0
    odometry = reckoning(mount)
    motion = [take(odometry, frame) for frame in frames([0.0, 2000.0], wheels, drive.gyro(felt))][-1]
    assert motion.missing_s == pytest.approx(missing_s)


def test_broken_and_repeated_samples_are_left_out_and_counted() -> None:
    drive, mount = Drive(1.0, 0.3, 0.8), MOUNTS[0]
    times = np.arange(0, 1001, 20.0)
    wheels, gyro = drive.wheels(times, mount), drive.gyro(times)
    wheels.values[5, 1] = np.nan
    gyro.values[7] = [0.0, 0.0, np.inf]
    gyro.values[8] = [np.nan, np.nan, drive.rate]  # rates of roll and pitch don't matter
    wheels.stamp_ns[10] = wheels.stamp_ns[2]
    odometry = reckon(mount, frames([0.0, 1000.0], wheels, gyro))
    take(odometry, Frame(1000 * MS, wheels=wheels, gyro=gyro))
    assert_same(odometry.pose, drive.pose(1.0), 1e-6)
    assert odometry.history.dropped == {"odometry": 0, "compass": 0, "attitude": 0} | {
        "wheels": 2 + len(times),
        "gyro": 1 + len(times),
    }


def test_an_error_of_turning_is_travel_over_levers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wheels along x and y with levers l: to a robot that turns by t on the spot a scale error e is a travel -l e t."""
    turn_rad, levers, error = 0.3, (0.2, -0.1), 0.05
    mount = (0.0, math.pi / 2, *levers)
    drive, times = Drive(0.0, 0.0, 1.0), np.arange(0, 301, 20.0)
    monkeypatch.setattr(wheel_odometry, "DRIFT_M", 0.0)
    monkeypatch.setattr(gyro_module, "NOISE_RAD", 0.0)
    wheels = WheelSettings(a_lever_m=levers[0], b_lever_m=levers[1], scale_error=0, slip_m=0)
    odometry = reckoning(mount, wheels, GyroSettings(scale_error=error, bias_error_rad_s=0))
    motion = [take(odometry, f) for f in frames([0.0, 300.0], drive.wheels(times, mount), drive.gyro(times))][-1]
    half = turn_rad / 2  # the step's displacement points along the heading in its middle
    x_m = -(levers[0] * math.cos(half) - levers[1] * math.sin(half))
    y_m = -(levers[0] * math.sin(half) + levers[1] * math.cos(half))
    derivatives = np.array([x_m, y_m, 1.0])
    np.testing.assert_allclose(motion.covariance, (error * turn_rad) ** 2 * np.outer(derivatives, derivatives))


# --- from the recording to the system ---------------------------------------------------------------------------------


def with_sensors(folder: Path, directions: str) -> Path:
    """A tiny recording with all sensors, whose sequence.yaml ends with a line about the wheels."""
    write_recording(folder)
    write_sensors(folder, 60)
    with (folder / "sequence.yaml").open("a") as file:
        file.write(directions)
    return folder


def test_a_system_gets_the_directions_of_the_recording(tmp_path: Path) -> None:
    folder = with_sensors(tmp_path / "one", "wheels: {a_dir_rad: 0.2, b_dir_rad: 1.7}\n")
    prepared = prepare(folder, "iris-fusion")
    assert isinstance(prepared.system, IrisFusion)
    assert prepared.system.odometry.wheels.pair == WheelPair(0.2, 1.7)
    assert prepared.notices == ()
    assert prepare(folder, "nubot-mti").notices == ()


@pytest.mark.parametrize("gone", ["wheels.csv", "imu.csv"])
def test_what_stands_in_for_wheels_is_told(tmp_path: Path, gone: str) -> None:
    folder = with_sensors(tmp_path / "one", "wheels: {a_dir_rad: 0.2, b_dir_rad: 1.7}\n")
    (folder / gone).unlink()
    (notice,) = prepare(folder, "iris-fusion").notices
    assert f"the recording lacks {gone}: odometry.csv is used instead" in notice
    (folder / "odometry.csv").unlink()
    (notice,) = prepare(folder, "iris-fusion").notices
    assert f"the recording lacks {gone}, and odometry.csv, which would stand in: no motion is measured" in notice


def test_unknown_directions_are_told_and_parallel_ones_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = with_sensors(tmp_path / "one", "")
    (notice,) = prepare(folder, "iris-fusion").notices
    assert "rolling directions (wheels: {a_dir_rad: …, b_dir_rad: …} in sequence.yaml)" in notice
    main(["run", str(folder), "--system", "iris-fusion", "--output", str(tmp_path / "run")])
    assert "warning: iris-fusion measures its way with two wheels and a gyro" in capsys.readouterr().err
    with pytest.raises(InputError, match=r"unknown setting 'wheels.a_dir_rad'"):
        prepare(folder, "iris-fusion", overrides=["wheels.a_dir_rad=0.2"])
    parallel = with_sensors(tmp_path / "two", "wheels: {a_dir_rad: 0.2, b_dir_rad: 0.2}\n")
    with pytest.raises(InputError, match="parallel"):
        prepare(parallel, "iris-fusion")


def test_a_wheel_errs_by_its_size_and_by_slip() -> None:
    wheel = WheelSettings(scale_error=0.01, slip_m=0.004)
    assert wheel.variance(2.0, 3.0) == pytest.approx(0.02**2 + 3.0 * 0.004**2)
    assert wheel.variance(-2.0, 3.0) == wheel.variance(2.0, 3.0)
