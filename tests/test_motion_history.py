"""The motion history against plain NumPy over the whole stream: whatever came in whichever portions, asked whenever."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from touchline.geometry import Pose, wrap_angle
from touchline.motion import GyroSettings, MotionHistory, WheelSettings
from touchline.motion.samples import SampleHistory
from touchline.motion.wheel_pair import WheelPair
from touchline.types import Frame, Samples

MS = 1_000_000
SECOND = 1_000_000_000
COLUMNS = {"odometry": 3, "wheels": 2, "gyro": 3, "compass": 1, "tilt": 2}
DIRECTIONS = (0.3, 1.9)
seeds = given(seed=st.integers(0, 10**6))
often = settings(deadline=None, max_examples=15)


def history() -> MotionHistory:
    return MotionHistory(
        wheels=WheelSettings(a_lever_m=0.1), gyro=GyroSettings(bias_rad_s=0.02), wheel_directions_rad=DIRECTIONS
    )


def samples_of(one: MotionHistory) -> list[SampleHistory]:
    """What is held of each sensor."""
    assert one.wheels is not None
    integrals = [one.wheels.wheels.integral, one.gyro.integral]
    return [one.odometry.samples, one.compass.samples, one.attitude, *(each.samples for each in integrals)]


class Stream:
    """Four seconds of all sensors at uneven times, each on its own, with a robot that drives and turns as it likes."""

    def __init__(self, seed: int) -> None:
        self.rng = rng = np.random.default_rng(seed)
        self.clean = {name: self._sensor(columns) for name, columns in COLUMNS.items()}
        self.clean["odometry"].values[:, 2] = np.angle(np.exp(1j * self.clean["odometry"].values[:, 2]))
        self.clean["compass"].values[:] = np.angle(np.exp(1j * self.clean["compass"].values))
        ends = np.cumsum(rng.integers(20, 250, 60)) * MS
        self.ends_ns = [int(end) for end in ends if end < 4 * SECOND] + [4 * SECOND]

    def _sensor(self, columns: int) -> Samples:
        stamps = np.cumsum(self.rng.integers(3, 38, 400)) * MS
        stamps = stamps[stamps <= 4 * SECOND]
        values = np.cumsum(self.rng.normal(0.0, 0.005, (len(stamps), columns)), axis=0)
        return Samples(stamps, values + self.rng.normal(0.0, 1.0, columns))

    def frames(self, spoilt: bool = False) -> list[Frame]:
        """Frames with the samples since the one before; spoilt: with rows again, out of order and without numbers."""
        edges = itertools.pairwise([-1, *self.ends_ns])
        return [
            Frame(end, **{name: self._portion(samples, start, end, spoilt) for name, samples in self.clean.items()})
            for start, end in edges
        ]

    def _portion(self, samples: Samples, start_ns: int, end_ns: int, spoilt: bool) -> Samples:
        first, last = np.searchsorted(samples.stamp_ns, [start_ns, end_ns], side="right")
        rows = np.arange(first, last)
        stamps, values = samples.stamp_ns[rows], samples.values[rows]
        if spoilt and last > 2:
            again = self.rng.integers(max(0, last - 20), last, 4)  # of this portion and of earlier ones
            where = np.searchsorted(rows, again, side="right") + (again < first) * self.rng.integers(
                0, len(rows) + 1, 4
            )
            stamps = np.insert(stamps, where, samples.stamp_ns[again])
            values = np.insert(values, where, samples.values[again] + 1.0, axis=0)
            stamps = np.append(stamps, end_ns)
            values = np.append(values, np.full((1, values.shape[1]), np.nan), axis=0)
        return Samples(stamps, values)

    def at(self, name: str, stamp_ns: int, angle: int | None = None) -> NDArray[np.float64]:
        """The clean values at a stamp by interpolation."""
        samples = self.clean[name]
        values = samples.values.copy()
        if angle is not None:
            values[:, angle] = np.unwrap(values[:, angle])
        return np.array([np.interp(stamp_ns, samples.stamp_ns, column) for column in values.T])

    def covered_ns(self, *names: str) -> tuple[int, int]:
        """From where to where these sensors all have samples."""
        stamps = [self.clean[name].stamp_ns for name in names]
        return int(max(s[0] for s in stamps)), int(min(s[-1] for s in stamps))

    def interval_ns(self, *names: str) -> tuple[int, int]:
        """Any interval that these sensors cover."""
        first, last = self.covered_ns(*names)
        start, end = sorted(self.rng.integers(first, last + 1, 2).tolist())
        return start, end

    def fed(self, spoilt: bool = False) -> MotionHistory:
        one = history()
        for frame in self.frames(spoilt):
            one.add(frame)
        return one


@often
@seeds
@pytest.mark.parametrize("spoilt", [False, True])
def test_odometry_is_the_difference_of_the_interpolated_poses(spoilt: bool, seed: int) -> None:
    stream = Stream(seed)
    one = MotionHistory()
    for frame in stream.frames(spoilt):
        one.add(frame)
    start, end = stream.interval_ns("odometry")
    before, after = (Pose(*stream.at("odometry", stamp, angle=2)) for stamp in (start, end))
    expected, motion = before.inverse().compose(after), one.between(start, end)
    assert motion.pose.distance_to(expected) < 1e-9
    assert abs(wrap_angle(motion.pose.heading - expected.heading)) < 1e-9
    assert motion.missing_s == 0.0


@often
@seeds
@pytest.mark.parametrize("spoilt", [False, True])
def test_the_gyro_is_the_sum_of_its_trapezoids(spoilt: bool, seed: int) -> None:
    stream = Stream(seed)
    gyro = stream.clean["gyro"]
    rates = gyro.values[:, 2] - 0.02
    steps = 0.5 * (rates[1:] + rates[:-1]) * np.diff(gyro.stamp_ns) / 1e9
    start, end = stream.interval_ns("gyro")
    angles = np.interp([start, end], gyro.stamp_ns, np.r_[0.0, np.cumsum(steps)])
    known = stream.fed(spoilt).gyro.integral.samples
    assert known.at(end)[0] - known.at(start)[0] == pytest.approx(angles[1] - angles[0], abs=1e-9)


@often
@seeds
@pytest.mark.parametrize("spoilt", [False, True])
def test_wheels_and_gyro_are_summed_from_sample_to_sample(spoilt: bool, seed: int) -> None:
    """Equations (1) to (6) in one loop over all stamps of both sensors."""
    stream = Stream(seed)
    start, end = stream.interval_ns("wheels", "gyro")
    gyro = stream.clean["gyro"]
    rates = gyro.values[:, 2] - 0.02
    angle = np.r_[0.0, np.cumsum(0.5 * (rates[1:] + rates[:-1]) * np.diff(gyro.stamp_ns) / 1e9)]
    stamps = np.union1d(stream.clean["wheels"].stamp_ns, gyro.stamp_ns)
    stamps = np.r_[start, stamps[(stamps > start) & (stamps < end)], end]
    rolled = np.array([stream.at("wheels", int(stamp)) for stamp in stamps])
    turned = np.interp(stamps, gyro.stamp_ns, angle)
    pair, x, y = WheelPair(*DIRECTIONS, a_lever_m=0.1), 0.0, 0.0
    for (a, b), turn, heading in zip(np.diff(rolled, axis=0), np.diff(turned), turned - turned[0], strict=False):
        dx, dy = pair.displacement(a, b, turn, heading + 0.5 * turn)
        x, y = x + np.sinc(turn / 2 / np.pi) * dx, y + np.sinc(turn / 2 / np.pi) * dy
    motion = stream.fed(spoilt).between(start, end)
    assert motion.pose.distance_to(Pose(x, y, 0.0)) < 1e-9
    assert abs(wrap_angle(motion.pose.heading - (turned[-1] - turned[0]))) < 1e-9
    assert motion.by_gyro


@often
@seeds
@pytest.mark.parametrize("spoilt", [False, True])
def test_compass_and_attitude_are_interpolated_where_their_lag_is_known(spoilt: bool, seed: int) -> None:
    stream, lag = Stream(seed), 20 * MS
    one = stream.fed(spoilt)
    first, last = stream.covered_ns("compass", "tilt")
    stamp = int(stream.rng.integers(first, last - lag))
    heading, roll, pitch = one.at(stamp)
    assert heading is not None
    assert abs(wrap_angle(heading - stream.at("compass", stamp + lag, angle=0)[0])) < 1e-9
    assert [roll, pitch] == pytest.approx(stream.at("tilt", stamp + lag), abs=1e-9)


@often
@seeds
def test_any_past_interval_gives_the_same_answer_again_and_again(seed: int) -> None:
    """To the last bit, as long as it is held: at least for two seconds, whatever has come since."""
    stream, one = Stream(seed), history()
    asked: list[tuple[int, int]] = []
    answers = []
    for frame in stream.frames(spoilt=True):
        one.add(frame)
        held = samples_of(one)
        if any(len(samples) == 0 for samples in held):
            continue
        last = min(samples.last_ns for samples in held) - 20 * MS  # the lag of compass and attitude
        start = int(stream.rng.integers(0, max(last, 1)))
        if start < last:
            asked.append((start, last))
            answers.append((one.between(start, last), one.odometry.between(start, last), one.at(start), one.at(last)))
    assert len(asked) > 20
    for (start, end), (motion, by_odometry, first, last_) in zip(asked, answers, strict=True):
        for before, again in ((motion, one.between(start, end)), (by_odometry, one.odometry.between(start, end))):
            assert before.pose == again.pose
            assert np.array_equal(before.covariance, again.covariance)
            assert before.missing_s == again.missing_s
        assert (one.at(start), one.at(end)) == (first, last_)


def test_arrays_are_the_samples_and_earlier_ones_stay() -> None:
    held = SampleHistory(columns=2)
    kept: list[int] = []
    seen: list[tuple[NDArray[np.int64], NDArray[np.float64], list[int]]] = []

    def check() -> None:
        seen.append((*held.arrays, list(kept)))
        for stamps, table, wanted in seen:
            assert stamps.tolist() == wanted
            assert table.tolist() == [[float(stamp), -float(stamp)] for stamp in wanted]

    check()
    stamp = 0
    for turn in range(60):  # more samples than there is room for at first
        new = np.arange(stamp + 1, stamp + 4)
        held.add(Samples(new, np.column_stack((new, -new)).astype(np.float64)))
        kept += new.tolist()
        check()
        stamp += 4
        held.append(stamp, [float(stamp), -float(stamp)])
        kept.append(stamp)
        check()
        if turn % 3 == 2:
            held.forget_before(stamp - 9)
            kept = [each for each in kept if each >= stamp - 9]
            check()
        if turn == 40:
            held.clear()
            kept = []
            check()


def test_time_does_not_run_backwards() -> None:
    one = history()
    one.add(Frame(SECOND))
    with pytest.raises(ValueError, match="forward in time"):
        one.between(2, 1)
    with pytest.raises(ValueError, match="forward in time"):
        one.add(Frame(SECOND - 1, odometry=Samples(np.array([0]), np.zeros((1, 3)))))
    assert len(one.odometry.samples) == 0
    one.clear()
    one.add(Frame(0))


@pytest.mark.parametrize("with_frames", [True, False])
def test_memory_is_bounded_and_the_last_seconds_are_held(with_frames: bool) -> None:
    """50 samples a second: 5 s before the last frame, and a minute where no frame comes."""
    one = history()
    for second in range(200):
        stamps = second * SECOND + np.arange(50) * 20 * MS
        samples = {name: Samples(stamps, np.zeros((50, columns))) for name, columns in COLUMNS.items()}
        if with_frames:
            one.add(Frame((second + 1) * SECOND, **samples))
        for name in () if with_frames else COLUMNS:
            one.add_samples(name.replace("tilt", "attitude"), samples[name])
    seconds = 7 if with_frames else 62
    assert all(len(samples) < 50 * seconds for samples in samples_of(one))
    assert one.between(195 * SECOND, 199 * SECOND).missing_s == 0.0
