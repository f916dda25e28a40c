"""iris-fusion on recorded drives with what goes wrong laid into them; what it does with sound ones its replays tell."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from drives import Drive, open_drive

from touchline.config import load_settings
from touchline.field import open_field
from touchline.geometry import Pose, wrap_angle
from touchline.motion import DeadReckoning, MotionHistory
from touchline.motion.compass import COMPASS_FALSE
from touchline.published.iris_fusion.system import IrisFusion, IrisFusionSettings
from touchline.systems import RobotSetup, open_system
from touchline.types import Estimate, Frame, LinePoints, Mode, Observation, Prior, Status, points_at


@cache
def tour() -> Drive:
    """Its first eight seconds."""
    drive = open_drive("tour")
    return replace(drive, frames=drive.frames[:80], truth=drive.truth[:80])


def true_pose(index: int) -> Pose:
    return Pose(*tour().truth[index].tolist())


def system(*changes: str, prior: Prior | None = None, seed: int = 0) -> IrisFusion:
    settings = load_settings(IrisFusionSettings, None, changes)
    made = open_system("iris-fusion", tour().setup, settings, np.random.default_rng(seed))
    assert isinstance(made, IrisFusion)
    made.reset(prior)
    return made


def seen(frame: Frame, points: LinePoints | None) -> Frame:
    return replace(frame, observation=Observation(frame.stamp_ns, *([] if points is None else [points])))


def off_m(estimate: Estimate, index: int) -> float:
    return estimate.pose.distance_to(true_pose(index))


def strewn(points: LinePoints, rng: np.random.Generator) -> LinePoints:
    return replace(points, positions_m=rng.uniform(-5.0, 5.0, points.positions_m.shape))


def moved(points: LinePoints, pose: Pose) -> LinePoints:
    return replace(points, positions_m=pose.transform(points.positions_m))


def test_without_measured_motion_omnivision_goes_on_alone() -> None:
    made = system()
    estimates = [made.step(replace(frame, wheels=None, odometry=None, gyro=None)) for frame in tour()]
    assert {e.mode for e in estimates[20:]} == {Mode.OMNIVISION}
    assert max(off_m(e, k) for k, e in enumerate(estimates) if k >= 20) < 0.2


def test_a_compass_heard_late_tells_the_end() -> None:
    made = system()
    estimates = [made.step(replace(frame, compass=None) if k < 40 else frame) for k, frame in enumerate(tour())]
    assert all(len(e.hypotheses) == 1 for e in estimates[15:40])
    (twin,) = estimates[60].hypotheses
    assert twin.probability == COMPASS_FALSE
    assert twin.pose == estimates[60].pose.mirrored()
    assert off_m(estimates[60], 60) < 0.1


def test_only_a_compass_denies_a_told_pose() -> None:
    made = system(prior=Prior(true_pose(0)))
    assert all(made.step(frame).hypotheses == () for frame in tour())
    for changes, right in (((), True), (("paper.restart.heading_rad=null",), False)):
        made = system(*changes, prior=Prior(true_pose(0).mirrored()))
        last = [made.step(frame) for frame in tour()][-1]
        assert (off_m(last, 78) < 0.3) is right


@pytest.mark.parametrize("stand_in", ["odometry", None])
def test_the_gyros_bias_is_taken_off_its_own_turns_alone(stand_in: str | None) -> None:
    """While the gyro is silent the odometry takes its place, or nothing does."""
    made = system(prior=Prior(true_pose(0)))
    made.fusion.bias_rad_s = math.radians(2.0)
    s = made.settings
    history = MotionHistory(s.odometry, s.compass_track, s.gyro, s.wheels, tour().setup.wheel_directions_rad)
    plain, turns = DeadReckoning(history), {"felt": 0.0, "silent": 0.0}
    frames = tour().frames
    for k, frame in enumerate(frames):
        frame = replace(frame, observation=None, gyro=None if k >= 40 else frame.gyro)
        frame = frame if stand_in else replace(frame, odometry=None)
        before, reckoned = made.odometry.pose, plain.pose
        made.step(frame)
        history.add(frame)
        plain.advance(frame.stamp_ns)
        ours, theirs = (b.inverse().compose(o.pose) for b, o in ((before, made.odometry), (reckoned, plain)))
        if 0 < k < 40 or k > 45:
            turns["silent" if k >= 40 else "felt"] += wrap_angle(theirs.heading - ours.heading)
    felt_s = 1e-9 * (frames[39].stamp_ns - frames[0].stamp_ns)
    assert math.degrees(turns["felt"]) == pytest.approx(2.0 * felt_s, abs=0.01)
    assert turns["silent"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("what", ["shifted", "turned", "strewn", "clutter"])
def test_a_bad_image_never_pulls_the_pose(what: str) -> None:
    made, other, rng = system("paper.monitor=false"), system("paper.monitor=false"), np.random.default_rng(0)
    for k, frame in enumerate(tour()):
        assert frame.observation is not None
        points = frame.observation.points
        if k > 20 and k % 10 == 0:
            wrong = rng.random(len(points)) < 0.5
            points = {
                "shifted": moved(points, Pose(0.4, 0.3, 0.0)),
                "turned": moved(points, Pose(0.0, 0.0, math.radians(12.0))),
                "strewn": strewn(points, rng),
                "clutter": replace(
                    points,
                    positions_m=np.where(wrong[:, np.newaxis], strewn(points, rng).positions_m, points.positions_m),
                ),
            }[what]
        estimate, undisturbed = made.step(seen(frame, points)), other.step(frame)
        if k > 20:
            assert estimate.status is Status.TRACKING
            assert estimate.pose.distance_to(undisturbed.pose) < 0.06


def followed_along_a_false_line(*changes: str) -> Iterable[Estimate]:
    """A robot that sees nothing but a straight line of 6 m, which is none of the field's."""
    made, rng = system(*changes), np.random.default_rng(0)
    at = np.column_stack((np.linspace(-3.0, 3.0, 60), np.full(60, 1.5)))
    for frame in tour().frames:
        yield made.step(seen(frame, points_at(at + 0.01 * rng.standard_normal((60, 2)))))


def test_a_lone_line_finds_nobody_who_is_searched_for() -> None:
    assert not any(one.status is Status.TRACKING for one in followed_along_a_false_line())
    assert any(one.status is Status.TRACKING for one in followed_along_a_false_line("paper.restart.lone_line=true"))


def test_frames_without_anything_break_nothing() -> None:
    made = open_system("iris-fusion", RobotSetup(open_field("indoor-9x6")))
    assert {made.step(Frame(k * 100_000_000)).status for k in range(30)} == {Status.SEARCHING}
