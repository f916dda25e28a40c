"""touchline.Localizer: the live loop, whatever a robot's sensors and threads do."""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drives import Drive, open_drive
from fakes import codes_of

from touchline.errors import InputError
from touchline.geometry import Pose, Pose3
from touchline.localizer import Localizer
from touchline.systems import SYSTEMS, open_system
from touchline.types import Estimate, Frame, Hypothesis, LinePoints, Prior, Status

ROOT = Path(__file__).parents[1]
EXAMPLE = ROOT / "examples" / "omni_msl_track_short"
every_system = pytest.mark.parametrize("system", SYSTEMS)


@cache
def drive() -> tuple[Drive, list[Frame]]:
    """8 s on the 9 x 6 m field, seen as line points."""
    tour = open_drive("tour")
    return tour, tour.frames


def made(system: str = "nubot-mti", **more: Any) -> Localizer:
    setup = drive()[0].setup
    return Localizer(setup.field, system=system, wheels=setup.wheel_directions_rad, **more)


def feed(localizer: Localizer, frame: Frame) -> None:
    """All samples of a frame, one by one."""
    for samples, add in (
        (frame.odometry, localizer.add_odometry),
        (frame.wheels, localizer.add_wheels),
        (frame.gyro, localizer.add_gyro),
        (frame.compass, localizer.add_compass),
        (frame.tilt, localizer.add_attitude),
    ):
        for stamp_ns, row in [] if samples is None else zip(samples.stamp_ns, samples.values, strict=True):
            add(int(stamp_ns), *row.tolist())


def play(localizer: Localizer, frames: list[Frame]) -> list[Estimate]:
    estimates = []
    for frame in frames:
        feed(localizer, frame)
        estimates.append(localizer.localize(frame.stamp_ns, observation=frame.observation))
    return estimates


def off_m(estimate: Estimate, index: int) -> float:
    return estimate.pose.distance_to(Pose(*drive()[0].truth[index].tolist()))


@every_system
def test_estimates_are_those_of_the_system_fed_the_same_frames(system: str) -> None:
    run, frames = drive()
    plain = open_system(system, replace(run.setup, camera=None))
    plain.reset()
    localizer = made(system)
    for frame, estimate in zip(frames, play(localizer, frames), strict=True):
        expected = plain.step(frame)
        assert (estimate.stamp_ns, estimate.pose, estimate.status) == (
            frame.stamp_ns,
            expected.pose,
            expected.status,
        )
        np.testing.assert_array_equal(estimate.covariance, expected.covariance)
        assert estimate.problems == ()
        localizer.pose(frame.stamp_ns + 30_000_000)  # leaves the system alone
    assert localizer.problems == {}


# --- bad data ---------------------------------------------------------------------------------------------------------

NAN, INF = float("nan"), float("inf")
BAD_SAMPLES: dict[str, tuple[Callable[[Localizer, int], None], str, str]] = {
    "NaN": (lambda robot, t: robot.add_odometry(t, NAN, 0.0, 0.0), "odometry", "sample-unusable"),
    "infinite": (lambda robot, t: robot.add_wheels(t, 0.0, INF), "wheels", "sample-unusable"),
    "huge": (lambda robot, t: robot.add_gyro(t, 0.0, 0.0, 1e30), "gyro", "sample-unusable"),
    "None": (lambda robot, t: robot.add_compass(t, None), "compass", "sample-unusable"),  # type: ignore[arg-type]
    "text": (lambda robot, t: robot.add_attitude(t, "a", 0.0), "attitude", "sample-unusable"),  # type: ignore[arg-type]
    "array": (lambda robot, t: robot.add_compass(t, np.zeros(3)), "compass", "sample-unusable"),  # type: ignore[arg-type]
    "stamp NaN": (lambda robot, t: robot.add_compass(NAN, 0.0), "compass", "stamp-unusable"),  # type: ignore[arg-type]
    "stamp None": (lambda robot, t: robot.add_compass(None, 0.0), "compass", "stamp-unusable"),  # type: ignore[arg-type]
    "stamp huge": (lambda robot, t: robot.add_odometry(10**30, 0.0, 0.0, 0.0), "odometry", "stamp-unusable"),
    "ahead": (lambda robot, t: robot.add_wheels(t + 3_600_000_000_000, 0.0, 0.0), "wheels", "sample-ahead"),
    "old": (
        lambda robot, t: robot.add_odometry(t - 60_000_000, 0.0, 0.0, 0.0),
        "odometry",
        "sample-old",
    ),
    "twice": (lambda robot, t: robot.add_gyro(t, 0.0, 0.0, 0.0), "gyro", "sample-old"),
}


@pytest.mark.parametrize("name", BAD_SAMPLES)
def test_a_bad_sample_is_counted_told_and_does_no_harm(name: str) -> None:
    localizer, frames = made("iris-fusion"), drive()[1]
    spoil, sensor, code = BAD_SAMPLES[name]
    play(localizer, frames[:40])
    feed(localizer, frames[40])
    spoil(localizer, frames[40].stamp_ns)
    estimate = localizer.localize(frames[40].stamp_ns, observation=frames[40].observation)
    (problem,) = estimate.problems
    assert (problem.code, problem.sentence.partition(":")[0]) == (code, sensor)
    assert localizer.problems == {problem: 1}
    later = play(localizer, frames[41:60])
    assert all(e.problems == () and e.status is Status.TRACKING for e in later)
    assert off_m(later[-1], 59) < 0.1


BAD_SIGHTS: dict[str, dict[str, Any]] = {
    "nothing": {},
    "image without camera": {"image": np.zeros((480, 480, 3), dtype=np.uint8)},
    "one column": {"points": np.zeros((5, 1))},
    "words": {"points": [["a", "b"]]},
    "a number": {"points": 3.0},
    "ragged": {"points": [[1.0, 2.0], [1.0]]},
    "NaN points": {"points": np.full((20, 2), NAN)},
    "far points": {"points": np.full((20, 2), 1e30)},
    "no points": {"points": []},
    "observation of something": {"observation": "a goal"},
    "points of text": {
        "points": LinePoints(np.full((3, 2), "x"), np.zeros((3, 2, 2)), np.ones(3), np.zeros((3, 2)))  # type: ignore[arg-type]
    },
}


@pytest.mark.parametrize("name", BAD_SIGHTS)
def test_in_a_bad_sight_nothing_is_seen(name: str) -> None:
    localizer, frames = made(), drive()[1]
    play(localizer, frames[:20])
    feed(localizer, frames[20])
    estimate = localizer.localize(frames[20].stamp_ns, **BAD_SIGHTS[name])
    assert (estimate.stamp_ns, estimate.points, estimate.status) == (frames[20].stamp_ns, 0, Status.TRACKING)
    assert off_m(estimate, 20) < 0.1
    assert (len(estimate.problems), sum(localizer.problems.values()) > 0) == (
        (0, False) if name == "no points" else (1, True)
    )
    assert all(e.status is Status.TRACKING for e in play(localizer, frames[21:25]))


def test_single_bad_points_are_left_out() -> None:
    localizer, frames = made(), drive()[1]
    play(localizer, frames[:10])
    frame = frames[10]
    assert frame.observation is not None
    spoiled = np.vstack((frame.observation.points.positions_m, [[NAN, 0.0], [0.0, INF], [1e9, 0.0]]))
    estimate = localizer.localize(frame.stamp_ns, points=spoiled)
    assert [each.code for each in estimate.problems] == ["observation-unusable"]
    assert str(estimate.problems[0]).endswith("left out (3 times)")
    assert off_m(estimate, 10) < 0.1


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((100, 480, 3), dtype=np.uint8),
        np.zeros((480, 480), dtype=np.uint8),
        np.zeros((480, 480, 3), dtype=np.float32),
        "image.jpg",
        [[1, 2], [3, 4]],
    ],
    ids=["size", "grey", "float", "text", "list"],
)
def test_an_image_of_another_kind_is_told(image: Any) -> None:
    localizer = Localizer("msl-18x12", EXAMPLE / "camera.yaml")
    estimate = localizer.localize(0, image)
    assert codes_of(estimate) == {"image-shape"}
    assert estimate.status is Status.SEARCHING
    assert "camera-pose-unusable" in codes_of(localizer.localize(1, base_from_camera=np.eye(4)))  # type: ignore[arg-type]


def test_an_old_image_gives_the_last_estimate_searching() -> None:
    localizer, frames = made(), drive()[1]
    estimates = play(localizer, frames[:20])
    feed(localizer, frames[20])
    late = localizer.localize(frames[15].stamp_ns, observation=frames[15].observation)
    assert (late.pose, late.stamp_ns, late.status) == (estimates[-1].pose, estimates[-1].stamp_ns, Status.SEARCHING)
    assert codes_of(late) == {"image-old"}
    next_one = localizer.localize(frames[20].stamp_ns, observation=frames[20].observation)  # its samples are not lost
    reference = play(made(), frames[:21])[-1]
    assert (next_one.pose, next_one.status) == (reference.pose, Status.TRACKING)
    for stamp in (None, NAN, "now", 10**40):
        odd = localizer.localize(stamp, observation=frames[20].observation)  # type: ignore[arg-type]
        assert (odd.pose, odd.status) == (next_one.pose, Status.SEARCHING)


def test_garbage_of_any_kind_never_raises() -> None:
    rng, localizer = np.random.default_rng(0), made("iris-fusion")
    junk = [None, NAN, INF, -1, 1e308, "x", [], {}, np.zeros(3), np.float32(2.0), True, object(), 2**63, 1j]

    def some(good: Any) -> Any:
        return junk[int(rng.integers(len(junk)))] if rng.random() < 0.3 else good

    adders = (
        (localizer.add_odometry, 3),
        (localizer.add_wheels, 2),
        (localizer.add_gyro, 3),
        (localizer.add_compass, 1),
    )
    for k in range(400):
        stamp = k * 10_000_000 + int(rng.integers(-(10**9), 10**9))
        for add, count in adders:
            add(some(stamp), *(some(float(value)) for value in rng.uniform(-5.0, 5.0, count)))
        if k % 10 == 0:
            points = rng.uniform(-5.0, 5.0, (50, 2))
            estimate = localizer.localize(some(stamp), some(None), some(points), some(None), some(None))
            assert np.isfinite(estimate.pose).all()
            assert np.isfinite(localizer.pose(some(stamp)).pose).all()
    assert "localization-failed" not in {each.code for each in localizer.problems}


def test_what_nobody_has_foreseen_starts_anew_and_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    localizer, frames = made(), drive()[1]
    play(localizer, frames[:20])
    with monkeypatch.context() as patched:
        patched.setattr(localizer._system.system, "step", lambda frame: 1 / 0)
        estimate = localizer.localize(frames[20].stamp_ns, observation=frames[20].observation)
    assert estimate.status is Status.SEARCHING
    assert codes_of(estimate) == {"localization-failed"}
    assert "ZeroDivisionError" in str(estimate.problems[0])
    assert play(localizer, frames[21:30])[-1].status is Status.TRACKING


# --- threads ----------------------------------------------------------------------------------------------------------


def test_adding_never_waits_for_localize(monkeypatch: pytest.MonkeyPatch) -> None:
    localizer, frames = made(), drive()[1]
    play(localizer, frames[:5])
    step, entered, go_on = localizer._system.step, threading.Event(), threading.Event()

    def slow(frame: Frame) -> Estimate:
        entered.set()
        assert go_on.wait(30.0)
        return step(frame)

    monkeypatch.setattr(localizer._system, "step", slow)
    camera = threading.Thread(target=lambda: localizer.localize(frames[5].stamp_ns, observation=frames[5].observation))
    camera.start()
    assert entered.wait(30.0)
    feed(localizer, frames[6])  # returns while localize is at work
    assert localizer.pose(frames[5].stamp_ns).stamp_ns == frames[5].stamp_ns
    go_on.set()
    camera.join()
    monkeypatch.undo()
    assert localizer.localize(frames[6].stamp_ns, observation=frames[6].observation).status is Status.TRACKING


# --- pose and reset ---------------------------------------------------------------------------------------------------


def test_between_images_the_pose_is_carried_on() -> None:
    localizer, frames = made(), drive()[1]
    estimates = play(localizer, frames[:40])
    for frame in frames[40:45]:
        feed(localizer, frame)
    ahead = localizer.pose(frames[44].stamp_ns)
    assert off_m(ahead, 44) < 0.1 < off_m(estimates[-1], 44)
    assert (ahead.stamp_ns, ahead.status) == (frames[44].stamp_ns, Status.TRACKING)
    assert np.linalg.det(ahead.covariance) > np.linalg.det(estimates[-1].covariance)
    back = localizer.pose(frames[35].stamp_ns)
    assert off_m(back, 35) < 0.1
    assert localizer.pose(estimates[-1].stamp_ns).pose == pytest.approx(estimates[-1].pose, abs=1e-12)
    assert localizer.pose(frames[39].stamp_ns + 5_000_000_000).status is Status.SEARCHING
    assert play(localizer, frames[45:50])[-1].pose == pytest.approx(play(made(), frames[:50])[-1].pose, abs=0.02)


def test_a_bound_grows_as_the_pose_is_carried_on(monkeypatch: pytest.MonkeyPatch) -> None:
    localizer, frames = made(), drive()[1]
    system = localizer._system.system
    bound = {"protection_m": 0.06, "protection_rad": 0.02, "end_probability": 0.9, "statistics": {"motion": 0.1}}
    step = system.step
    monkeypatch.setattr(system, "step", lambda frame: replace(step(frame), **bound))
    last = play(localizer, frames[:40])[-1]
    for frame in frames[40:45]:
        feed(localizer, frame)
    here, ahead = (localizer.pose(stamp) for stamp in (last.stamp_ns, frames[44].stamp_ns))
    assert (here.protection_m, here.protection_rad) == pytest.approx((0.06, 0.02))
    assert ahead.protection_m is not None
    assert ahead.protection_rad is not None
    way = last.pose.distance_to(ahead.pose)
    assert 0.06 + 0.02 * way < ahead.protection_m < 0.06 + 0.02 * way + 0.5
    assert 0.02 < ahead.protection_rad < 0.2
    assert (ahead.end_probability, ahead.statistics, ahead.reason) == (0.9, {"motion": 0.1}, "")
    far = localizer.pose(frames[39].stamp_ns + 5_000_000_000)
    assert (far.protection_m, far.protection_rad) == (None, None)
    assert far.reason == "the last image is more than 1 s away"
    late = localizer.localize(frames[15].stamp_ns, observation=frames[15].observation)
    assert (late.protection_m, late.status) == (None, Status.SEARCHING)
    assert "older" in late.reason


def test_before_the_first_image_the_pose_is_what_was_told() -> None:
    localizer = made()
    assert (localizer.pose(5).status, localizer.pose(5).pose) == (Status.SEARCHING, Pose(0.0, 0.0, 0.0))
    localizer.reset((1.0, 2.0, 2.0 * math.pi), covariance=np.diag([0.01, 0.04, 0.09]))
    told = localizer.pose(5)
    assert told.pose == pytest.approx((1.0, 2.0, 0.0))
    np.testing.assert_array_equal(told.covariance, np.diag([0.01, 0.04, 0.09]))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"pose": (1.0, 2.0)}, r"pose: expected \(x, y, theta\)"),
        ({"pose": (1.0, NAN, 0.0)}, "three finite numbers"),
        ({"pose": (1.0, 2.0, 0.0), "own_half": True}, "not both"),
        ({"pose": (1.0, 2.0, 0.0), "covariance": np.eye(2)}, r"must be \(3, 3\)"),
        ({"pose": (1.0, 2.0, 0.0), "covariance": -np.eye(3)}, "positive variances"),
        ({"covariance": np.eye(3)}, "needs the start pose"),
    ],
)
def test_a_wrong_reset_is_told(arguments: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        made().reset(**arguments)


# --- values -----------------------------------------------------------------------------------------------------------


def test_an_estimate_becomes_json_matrix_and_ros_message() -> None:
    covariance = np.array([[0.04, 0.001, 0.002], [0.001, 0.09, 0.003], [0.002, 0.003, 0.01]])
    other = Hypothesis(Pose(-1.0, -2.0, 3.0), float("nan"), 0.25, covariance)
    estimate = Estimate(7, Pose(1.0, 2.0, 0.5), covariance, Status.TRACKING, hypotheses=(other,), probability=0.75)
    tree = json.loads(json.dumps(estimate.to_dict()))
    assert tree["pose"] == {"x_m": 1.0, "y_m": 2.0, "heading_rad": 0.5}
    assert (tree["stamp_ns"], tree["status"], tree["residual_m"], tree["probability"]) == (7, "tracking", None, 0.75)
    assert tree["hypotheses"][0]["probability"] == 0.25
    assert tree["covariance"] == covariance.tolist()
    points = np.array([[1.0, 0.0], [0.3, -2.0]])
    placed = estimate.matrix() @ np.column_stack((points, np.zeros(2), np.ones(2))).T
    np.testing.assert_allclose(placed[:2].T, estimate.pose.transform(points))
    full = estimate.ros_covariance()
    assert full.shape == (36,)
    assert (full[0], full[1], full[5], full[7], full[11], full[35]) == (0.04, 0.001, 0.002, 0.09, 0.003, 0.01)
    assert np.count_nonzero(full) == 9


def test_all_that_is_given_reaches_the_system(monkeypatch: pytest.MonkeyPatch) -> None:
    localizer, frame = made(), drive()[1][0]
    seen: list[Frame] = []
    step = localizer._system.step
    monkeypatch.setattr(localizer._system, "step", lambda given: (seen.append(given), step(given))[1])
    features = open_drive("walk-indoor").frames[0].observation
    assert features is not None
    pose = Pose3.from_roll_pitch_yaw(0.0, 0.5)
    localizer.localize(frame.stamp_ns, observation=features, base_from_camera=pose)
    assert seen[0].base_from_camera is pose
    assert seen[0].observation is not None
    assert len(seen[0].observation.crossings) == len(features.crossings)


# --- the README's program ---------------------------------------------------------------------------------------------


def test_what_others_say_reaches_the_system_with_the_next_image(monkeypatch: pytest.MonkeyPatch) -> None:
    localizer, frames = Localizer("msl-18x12", system="touchline"), []
    step = localizer._system.step
    monkeypatch.setattr(localizer._system, "step", lambda frame: frames.append(frame) or step(frame))
    localizer.add_evidence("the keeper", 0.8, own_half=True)
    localizer.add_evidence("the keeper", 0.8, place_m="over there")
    localizer.add_evidence("the keeper", 2.0, own_half=True)
    localizer.add_evidence("the keeper", 0.8, somewhere=True)
    estimate = localizer.localize(0, points=np.zeros((0, 2)))
    assert [one.source for one in frames[0].evidence] == ["the keeper"]
    assert [str(each) for each in estimate.problems] == ["evidence: is none, left out (3 times)"]
    localizer.localize(100_000_000, points=np.zeros((0, 2)))
    assert frames[1].evidence == ()


def test_a_reset_takes_the_state_of_the_game(monkeypatch: pytest.MonkeyPatch) -> None:
    localizer, priors = Localizer("msl-18x12", system="touchline"), []
    monkeypatch.setattr(localizer._system, "reset", priors.append)
    localizer.reset(state="kick-off")
    localizer.reset(state="picked up")
    assert priors == [Prior(own_half=True), Prior()]
    for more in ({"pose": (1.0, 0.0, 0.0)}, {"own_half": True}):
        with pytest.raises(InputError, match="one of them"):
            localizer.reset(state="fallen", **more)
    with pytest.raises(InputError, match="known: "):
        localizer.reset(state="?")


def test_odometry_that_floods_the_robot_is_thinned() -> None:
    """A hundred thousand samples a second cost no image a second: states between two of them tell nothing more."""
    robot = made("touchline")
    for k in range(50_000):
        robot.add_odometry(10_000 * k, 1e-5 * k, 0.0, 0.0)
    robot.localize(500_000_000, points=np.zeros((0, 2)))
    taken = robot.frame.odometry if robot.frame is not None else None
    assert taken is not None
    assert len(taken) < 1_100
    assert taken.stamp_ns[-1] == 10_000 * 49_999
    assert np.diff(taken.stamp_ns).max() <= 500_000
