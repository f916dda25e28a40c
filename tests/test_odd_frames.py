"""What systems make of odd frames and stamps: late, out of order, an hour off, of clocks that are set."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drives import Drive, open_drive
from fakes import STEP_NS, FakeSource, FakeSystem

from touchline.camera import OmniCamera
from touchline.evaluation import read_tum
from touchline.evaluation.estimates import read_estimates
from touchline.evaluation.run_folder import RunFolder
from touchline.evaluation.runner import run_frames
from touchline.geometry import Pose
from touchline.motion import FrameClock, FrameOrder, MotionHistory, WheelSettings
from touchline.motion.clocks import SensorClocks
from touchline.sources import open_source
from touchline.systems import SYSTEMS, RobotSetup, open_system
from touchline.systems.ordered import OrderedSystem
from touchline.types import Estimate, Frame, ImageArray, LinePoints, Observation, Prior, Samples, Status, System

EXAMPLE = Path(__file__).parents[1] / "examples" / "omni_msl_track_short"
BY_POINTS = [name for name, info in SYSTEMS.items() if OmniCamera in info.cameras]
every_system = pytest.mark.parametrize("name", BY_POINTS)


@cache
def drive() -> tuple[Drive, list[Frame], list[Pose]]:
    """8 s on the 9 x 6 m field, the camera seen as line points; its frames and true poses."""
    tour = open_drive("tour")
    return tour, tour.frames, [Pose(*row) for row in tour.truth.tolist()]


def system(name: str) -> System:
    made = open_system(name, replace(drive()[0].setup, camera=None))
    made.reset()
    return made


@pytest.mark.parametrize("range_m", [30.0, 1e300])
@every_system
def test_points_farther_than_the_camera_can_see_are_no_points(name: str, range_m: float) -> None:
    """A fifth of the points: the pose is that of the others, bit for bit."""
    _, frames, poses = drive()
    rng, plain, disturbed = np.random.default_rng(0), system(name), system(name)
    for frame in frames[:45]:
        assert frame.observation is not None
        points = frame.observation.points
        far = rng.random(len(points)) < 0.2
        positions_m = np.where(far[:, np.newaxis], range_m * np.array([0.6, -0.8]), points.positions_m)
        estimate = disturbed.step(replace(frame, observation=Observation(0, replace(points, positions_m=positions_m))))
        near = LinePoints(*(getattr(points, each)[~far] for each in LinePoints.SHAPES))
        assert estimate.pose == plain.step(replace(frame, observation=Observation(0, near))).pose
        assert estimate.points == len(near)
    assert estimate.status is Status.TRACKING
    assert estimate.pose.distance_to(poses[44]) < 0.05


def test_the_camera_can_see_the_field_and_what_is_calibrated() -> None:
    source = open_source(EXAMPLE)
    field = source.field
    diagonal_m = math.hypot(field.length, field.width)
    camera = source.camera
    assert isinstance(camera, OmniCamera)
    nearer = replace(camera, range_m=camera.range_m * 8.0 / camera.range_m.max())
    assert RobotSetup(field).max_range_m == pytest.approx(diagonal_m + 3.0)
    assert RobotSetup(field, nearer).max_range_m == pytest.approx(8.0 + 3.0)


ODD_IMAGES: dict[str, Callable[[ImageArray], Any]] = {
    "half as large": lambda image: image[::2, ::2].copy(),
    "floats": lambda image: image / 255.0,
    "one channel": lambda image: image[..., 1].copy(),
    "no pixels": lambda image: image[:0, :0].copy(),
    "no array": lambda image: image[::100, ::100].tolist(),
}


@pytest.mark.parametrize("system_name", ["nubot-mti", "iris-fusion"])
def test_a_bad_image_is_the_fault_of_its_own_frame(system_name: str) -> None:
    """Among the first, that the colours are learned from: all others see as much as if it had been missing."""
    source = open_source(EXAMPLE)
    frames = list(itertools.islice(source, 8))
    spoils = dict(zip((0, 2, 4, 5, 7), ODD_IMAGES.values(), strict=True))
    setup = RobotSetup(source.field, source.camera, source.wheel_directions_rad)
    made, plain = open_system(system_name, setup), open_system(system_name, setup)
    for k, frame in enumerate(frames):
        odd = replace(frame, image=spoils[k](frame.image)) if k in spoils and frame.image is not None else frame
        estimate = made.step(odd)
        reference = plain.step(replace(frame, image=None) if k in spoils else frame)
        assert (estimate.pose, estimate.points, estimate.status) == (reference.pose, reference.points, reference.status)
        assert estimate.observation is not None
        assert (estimate.observation.problem is not None) == (k in spoils)


SECOND = 1_000_000_000
HOUR = 3600 * SECOND
BAD = 37  # the frame that something is wrong with; the robot has long been found


def one_value(*stamps_ns: int) -> Samples:
    """Samples of a sensor, one column, each with its place as the value."""
    return Samples(np.array(stamps_ns, dtype=np.int64), np.arange(len(stamps_ns), dtype=float)[:, np.newaxis])


# --- samples ----------------------------------------------------------------------------------------------------------


def test_a_sample_far_ahead_is_refused_and_counted() -> None:
    clocks = SensorClocks()
    clocks.frame_ns = 10 * SECOND
    stamps = (9 * SECOND, 11 * SECOND, HOUR, 11 * SECOND + 1)
    believed = clocks.believed("wheels", one_value(*stamps))
    assert believed.samples.stamp_ns.tolist() == [9 * SECOND, 11 * SECOND, 11 * SECOND + 1]
    assert believed.samples.values.ravel().tolist() == [0.0, 1.0, 3.0]
    assert not believed.clock_jumped
    assert clocks.refused == {"wheels": 1}


def test_three_that_agree_far_ahead_are_a_clock_that_jumped() -> None:
    clocks = SensorClocks()
    clocks.frame_ns = 0
    ahead = [HOUR + k * SECOND // 50 for k in range(4)]
    for stamp in ahead[:2]:
        assert len(clocks.believed("wheels", one_value(stamp)).samples) == 0
    third = clocks.believed("wheels", one_value(ahead[2]))
    assert third.clock_jumped
    assert third.samples.stamp_ns.tolist() == ahead[:3]
    assert clocks.believed("gyro", one_value(ahead[2])).samples.stamp_ns.tolist() == ahead[2:3]  # the others follow
    clocks.frame_ns = HOUR
    fourth = clocks.believed("wheels", one_value(ahead[3]))
    assert not fourth.clock_jumped
    assert len(fourth.samples) == 1
    assert clocks.refused["wheels"] == 0


@pytest.mark.parametrize(
    "stamps",
    [
        (HOUR, 2 * HOUR, 3 * HOUR),  # far from each other
        (HOUR, HOUR, HOUR),  # one that is repeated
        (HOUR + 2, HOUR + 1, HOUR),  # backwards
        (HOUR, HOUR + 1, 0, HOUR + 2),  # one at the right time between them
    ],
)
def test_what_does_not_follow_each_other_is_no_clock(stamps: tuple[int, ...]) -> None:
    clocks = SensorClocks()
    clocks.frame_ns = 0
    believed = clocks.believed("wheels", one_value(*stamps))
    assert not believed.clock_jumped
    assert believed.samples.stamp_ns.tolist() == [stamp for stamp in stamps if stamp == 0]
    assert clocks.refused["wheels"] == 3


# --- frames -----------------------------------------------------------------------------------------------------------


NEXT, LATE, UNCONFIRMED, SET_BACK = FrameOrder


@pytest.mark.parametrize(
    ("tenths", "orders"),
    [
        ([0, 1, 1, 2], [NEXT] * 4),
        ([0, 20, 10, 21], [NEXT, NEXT, LATE, NEXT]),
        ([0, 36000, 1, 2], [NEXT, NEXT, UNCONFIRMED, SET_BACK]),  # any distance may be the usual one
        ([0, 1, 36000, 2, 36000, 3], [NEXT, NEXT, UNCONFIRMED, NEXT, UNCONFIRMED, NEXT]),
        ([0, 1, 36000, 36001, 36002], [NEXT, NEXT, UNCONFIRMED, NEXT, NEXT]),  # set forward, or a long silence
        ([50, 51, -36000, 52, 53], [NEXT, NEXT, UNCONFIRMED, NEXT, NEXT]),
        ([50, 51, -36000, -35999, -35998], [NEXT, NEXT, UNCONFIRMED, SET_BACK, NEXT]),
        ([50, 51, -36000, 36000, 52], [NEXT, NEXT, UNCONFIRMED, UNCONFIRMED, NEXT]),  # neither confirms the other
        ([50, 51, 36000, 45, 52], [NEXT, NEXT, UNCONFIRMED, LATE, NEXT]),
        ([0, 300, 600, 1500, 1800], [NEXT] * 5),  # one image in half a minute
        ([0, 1, 100, 101], [NEXT] * 4),  # a camera that was connected anew
    ],
)
def test_the_order_of_frames(tenths: list[int], orders: list[FrameOrder]) -> None:
    clock = FrameClock()
    assert [clock.order(tenth * SECOND // 10) for tenth in tenths] == orders


@every_system
def test_a_late_frame_is_dropped_and_changes_nothing(name: str) -> None:
    _, frames, _ = drive()
    plain, disturbed = system(name), OrderedSystem(system(name))
    poses = [plain.step(frame).pose for frame in frames[:45]]
    for k, frame in enumerate(frames[:45]):
        if k == BAD:
            late = disturbed.step(frames[k - 5])
            assert (late.status, late.pose) == (Status.SEARCHING, poses[k - 1])
        assert disturbed.step(frame).pose == poses[k]
    assert disturbed.counts == {FrameOrder.NEXT: 45, FrameOrder.LATE: 1}


class Recorder:
    """A system whose statuses are given, and that tells what it was reset with."""

    def __init__(self, *statuses: Status) -> None:
        self.statuses = iter(statuses)
        self.priors: list[Prior | None] = []

    def reset(self, prior: Prior | None = None) -> None:
        self.priors.append(prior)

    def step(self, frame: Frame) -> Estimate:
        return Estimate(frame.stamp_ns, Pose(1.0, 2.0, 3.0), np.eye(3), next(self.statuses))


@pytest.mark.parametrize(
    ("statuses", "prior"),
    [
        ([Status.SEARCHING], Prior(own_half=True)),
        ([Status.SEARCHING, Status.TRACKING, Status.LOST], Prior(Pose(1.0, 2.0, 3.0))),
        ([Status.TRACKING, *[Status.SEARCHING] * 11], Prior()),
    ],
)
def test_what_a_new_start_is_told(statuses: list[Status], prior: Prior) -> None:
    """What was told at first while nothing is known, then the pose tracked last, unless that is long ago."""
    recorder = Recorder(*statuses, Status.TRACKING)
    made = OrderedSystem(recorder, Prior(own_half=True))
    for k in range(len(statuses)):
        made.step(Frame(HOUR + k))
    for k in range(2):
        assert made.step(Frame(k)).status is Status.SEARCHING
    assert recorder.priors == [prior]


class Shuffled(FakeSource):
    """Ten frames, then others at given places in time."""

    def __init__(self, *places: int) -> None:
        super().__init__(10)
        self.places = places

    def __iter__(self):  # type: ignore[no-untyped-def]
        frames = list(super().__iter__())
        return iter([*frames, *(replace(frames[0], stamp_ns=place * STEP_NS) for place in self.places)])


def test_files_of_a_run_in_any_order_are_ordered(tmp_path: Path) -> None:
    source = Shuffled(5, 36000, 10, 11, 12, 11, 13, -20, -19, -18)
    made = FakeSystem(np.random.default_rng(0))
    with RunFolder(tmp_path) as folder:
        tally = run_frames(source, made, folder)
    assert (tally.ended, tally.late_frames, tally.unconfirmed_frames, tally.clock_set_back) == ("complete", 2, 2, 1)
    assert read_tum(tmp_path / "trajectory.tum").stamp_ns.tolist() == [-19 * STEP_NS, -18 * STEP_NS]
    assert len(read_estimates(tmp_path / "estimates.csv").trajectory) == 2


# --- random streams ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_any_mix_of_stamps_raises_nothing_and_is_accounted_for(seed: int) -> None:
    """Each sample is held, dropped, refused or forgotten with its clock; the history stays in order and bounded."""
    rng = np.random.default_rng(seed)
    history = MotionHistory(wheels=WheelSettings(), wheel_directions_rad=(0.8, -0.8))
    columns = {"odometry": 3, "wheels": 2, "gyro": 3, "compass": 1, "attitude": 2}
    given: Counter[str] = Counter()
    for k in range(300):
        sensor = str(rng.choice(list(columns)))
        off = int(rng.choice([0, 0, 0, 0, HOUR, -HOUR, SECOND // 2, 3 * SECOND]))
        stamps = k * SECOND // 10 + off + np.sort(rng.integers(0, SECOND // 10, rng.integers(1, 5)))
        values = np.where(rng.random((len(stamps), columns[sensor])) < 0.02, np.nan, 0.1)
        history.add_samples(sensor, Samples(stamps, values))
        given[sensor] += len(stamps)
        if k % 3 == 0:
            history.add(Frame(k * SECOND // 10))
            for start, end in itertools.pairwise(sorted(rng.integers(0, k * SECOND // 10 + 1, 3).tolist())):
                assert np.isfinite(history.between(start, end).covariance).all()
                history.at(start)
    for sensor, count in given.items():
        assert 0 < history.dropped[sensor] + history.refused[sensor] < count
