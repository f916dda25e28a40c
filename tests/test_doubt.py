"""Honest doubt: what is no view of the field is not called tracking, and a compass is a witness among others."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from fakes import codes_of

from touchline.geometry import Pose, wrap_angle
from touchline.motion.compass import COMPASS_FALSE
from touchline.published.nubot.compass_correction import CompassCorrection
from touchline.published.nubot.pose_filter import Fusion, PoseFilter
from touchline.published.nubot_mti.system import NubotMti, NubotMtiSettings
from touchline.systems import RobotSetup, open_system
from touchline.types import Estimate, Status
from touchline_lab.experiments.clutter import Points, anew, blob, false_line, one_line, riding, ring, shown, uniform
from touchline_lab.experiments.drives import Drive, drive_of
from touchline_lab.experiments.injections import Fault, ahead, both, stuck_compass, turned_compass, unfelt
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

UNIFORM, FAR, RING = (shown(anew(shape), besides=False) for shape in (uniform, ring(1e6), ring(1.0)))
BLOB = shown(riding(blob(20.0, 20.0)), besides=False)
BOTH = pytest.mark.parametrize("name", ["nubot-mti", "nubot-mcl"])


@cache
def driven(seed: int) -> Drive:
    """Four seconds of a match."""
    run = Simulation(open_scenario("match", seed, 4.0, ["ideal=true"]), level="points")
    return drive_of(run)


def spliced(first: Drive, second: Drive, at_s: float) -> Drive:
    """The robot of the first drive is carried, at this time, to where that of the second is, and drives on as it."""
    cut, end = int(np.searchsorted(first.times_s, at_s)), len(first.frames)
    frames, truth = [*first.frames[:cut], *second.frames[cut:end]], (first.truth[:cut], second.truth[cut:end])
    return unfelt(replace(first, frames=frames, truth=np.concatenate(truth)), cut)


def localized(name: str, drive: Drive, *settings: str) -> list[Estimate]:
    changes = dict(setting.split("=") for setting in settings)
    made = open_system(name, RobotSetup(drive.field), changes or None, np.random.default_rng(1))
    return [made.step(frame) for frame in drive.frames]


def wrong(drive: Drive, estimates: list[Estimate]) -> int:
    """Frames called tracking while more than half a metre off, or turned."""
    found = 0
    for estimate, (x, y, heading) in zip(estimates, drive.truth.tolist(), strict=True):
        off = estimate.pose.distance_to(Pose(x, y, heading)) > 0.5
        off |= abs(wrap_angle(estimate.pose.heading - heading)) > 0.5
        found += off and estimate.status is Status.TRACKING
    return found


@BOTH
@pytest.mark.parametrize("start_s", [0.0, 1.5])
@pytest.mark.parametrize("garbage", [UNIFORM, FAR, BLOB, RING])
def test_garbage_is_not_tracked(name: str, start_s: float, garbage: object) -> None:
    drive = Fault("garbage", start_s, 9.0, garbage).laid_into(driven(1), np.random.default_rng(0))  # type: ignore[arg-type]
    estimates = localized(name, drive)
    assert wrong(drive, estimates) <= 1
    assert estimates[-1].status is not Status.TRACKING


def test_the_paper_believes_garbage() -> None:
    drive = Fault("ring", 0.0, 9.0, RING).laid_into(driven(1), np.random.default_rng(0))
    assert wrong(drive, localized("nubot-mti", drive, "paper.failure.doubt=false", "paper.failure.monitor=false")) > 20


@BOTH
def test_a_false_line_moves_nothing_and_is_told(name: str) -> None:
    drive = Fault("false line", 1.5, 3.0, shown(false_line, besides=False)).laid_into(
        driven(1), np.random.default_rng(0)
    )
    estimates = localized(name, drive)
    assert wrong(drive, estimates) == 0
    assert "images-against-odometry" in codes_of(*estimates[15:29])
    assert all(estimate.status is Status.TRACKING for estimate in estimates[35:])


@BOTH
def test_one_line_leaves_a_long_ellipse_or_no_pose(name: str) -> None:
    drive = Fault("one line", 0.0, 9.0, one_line).laid_into(driven(2), np.random.default_rng(0))
    assert wrong(drive, localized(name, drive)) == 0


@BOTH
@pytest.mark.parametrize("fault", [turned_compass, stuck_compass])
def test_a_compass_that_fails_moves_nothing(name: str, fault: object) -> None:
    drive = Fault("compass", 1.5, 3.0, fault).laid_into(driven(1), np.random.default_rng(0))  # type: ignore[arg-type]
    estimates = localized(name, drive)
    assert wrong(drive, estimates) == 0
    assert all(estimate.status is Status.TRACKING for estimate in estimates[2:])
    if fault is turned_compass:
        assert "compass-wrong" in codes_of(estimates[25])
        assert not estimates[-1].problems
        assert wrong(drive, localized(name, drive, "paper.compass.may_fail=false")) > 5


@pytest.mark.parametrize("name", ["nubot-mti", "nubot-mcl", "iris-fusion"])
@pytest.mark.parametrize("seed", [2, 3, 4])
def test_a_robot_carried_away_in_full_view_is_found_within_ten_frames(name: str, seed: int) -> None:
    drive = spliced(driven(1), driven(seed), 2.0)
    estimates = localized(name, drive)
    assert wrong(drive, estimates) <= 5
    assert all(estimate.status is Status.TRACKING for estimate in estimates[30:])


SHOVE_M = 0.2
ALL = pytest.mark.parametrize("name", ["nubot-mti", "nubot-mcl", "iris-fusion"])


MOVED_AS_THE_COMPASS_TURNS = both(turned_compass, ahead(SHOVE_M))
"""The compass shows the opposite, and the robot stands farther back than the odometry has it."""


def poses_of_moved(truth: np.ndarray, to_twin: bool) -> np.ndarray:
    """Its true poses (N, 3): it was shoved as the compass failed, or carried to the other end with a right compass."""
    back = [Pose(*pose).compose(Pose(-SHOVE_M, 0.0, 0.0)) for pose in truth.tolist()]
    return np.array([pose.mirrored() if to_twin else pose for pose in back])


@ALL
def test_a_robot_carried_to_its_twin_is_at_either_end_and_found_by_the_compass_when_carried_again(name: str) -> None:
    drive = Fault("carried", 1.5, 9.0, MOVED_AS_THE_COMPASS_TURNS).laid_into(driven(1), np.random.default_rng(0))
    drive = replace(drive, truth=np.concatenate((drive.truth[:15], poses_of_moved(drive.truth[15:], to_twin=True))))
    drive = spliced(drive, driven(3), 2.5)
    estimates = localized(name, drive)
    assert wrong(drive, estimates) <= 5
    assert estimates[23].status is Status.SEARCHING
    assert all(estimate.status is Status.TRACKING for estimate in estimates[35:])


@ALL
def test_a_compass_that_fails_in_the_frame_of_a_shove_moves_nothing(name: str) -> None:
    fault = Fault("shoved", 1.5, 2.5, MOVED_AS_THE_COMPASS_TURNS)
    drive = fault.laid_into(driven(1), np.random.default_rng(0))
    moved = poses_of_moved(drive.truth[15:25], to_twin=False)
    drive = replace(drive, truth=np.concatenate((drive.truth[:15], moved, drive.truth[25:])))
    estimates = localized(name, drive)
    for estimate, truth in zip(estimates[5:], drive.truth[5:].tolist(), strict=True):
        assert estimate.pose.distance_to(Pose(*truth)) < 0.5
    assert estimates[23].status is Status.SEARCHING
    assert estimates[-1].status is Status.TRACKING


@pytest.mark.parametrize(("name", "seed"), [("nubot-mti", 6), ("nubot-mcl", 6), ("iris-fusion", 3)])
def test_a_robot_carried_away_while_its_compass_shows_the_opposite_is_found_at_the_right_end(
    name: str, seed: int
) -> None:
    drive = spliced(driven(1), driven(seed), 3.3)
    drive = Fault("compass", 1.2, 9.0, turned_compass).laid_into(drive, np.random.default_rng(0))
    estimates = localized(name, drive)
    assert wrong(drive, estimates) <= 1
    assert estimates[-1].status is Status.TRACKING


def test_a_compass_that_turned_round_as_the_robot_was_moved_is_believed_once_the_robot_is_lost() -> None:
    for moved in (False, True):
        one = CompassCorrection()
        for _ in range(12):
            one.update(0.02, 0.3, 0.3)
        for k in range(3):
            one.update(0.02, 0.3, 0.3 + math.pi, moved=moved and k == 0)
        assert one.doubted
        assert bool(one.either_end) is moved
        one.lose()
        assert one.doubted is not moved


def test_a_compass_that_turned_round_as_the_robot_was_moved_is_believed_after_twenty_seconds() -> None:
    one = CompassCorrection()
    for _ in range(12):
        one.update(0.02, 0.3, 0.3)
    doubted = []
    for k in range(210):
        one.update(0.02, 0.3, 0.3 + math.pi, moved=k == 0)
        doubted.append(one.doubted)
    assert all(doubted[2:200])
    assert not doubted[-1]
    assert not one.trusted


def judged(compass: CompassCorrection, off_rad: float, frames: int, moved: bool = False) -> None:
    """So many good matches with such a compass; moved: the robot was, in the first."""
    for k in range(frames):
        compass.update(0.02, 0.3, 0.3 - off_rad, moved=moved and k == 0)


@pytest.mark.parametrize("moved", [False, True])
def test_a_compass_that_had_failed_as_the_robot_was_lost_tells_no_end(moved: bool) -> None:
    """Half of all places agree with it; the others show that it is right again."""
    one = CompassCorrection()
    judged(one, 0.0, 12)
    judged(one, math.pi, 20, moved)
    one.lose()
    one.start_anew()
    judged(one, 0.0, 20)  # a false one again, at the other end
    assert [each.code for each in one.doubts] == ["compass-wrong"]
    assert not one.doubted
    judged(one, math.pi, 20)
    assert not one.doubted  # nor is it doubted in favour of the end that it had told
    one.lose()
    one.start_anew()
    judged(one, 0.0, 20)
    assert not one.doubts


def test_a_compass_that_fails_and_is_right_again_tells_the_end_again() -> None:
    one = CompassCorrection()
    judged(one, 0.0, 12)
    judged(one, math.pi, 20)
    one.start_anew()
    judged(one, math.pi, 20)
    judged(one, 0.0, 10)
    assert not one.doubts


def test_the_learned_offset_is_bounded_in_total() -> None:
    one = CompassCorrection()
    for k in range(400):
        one.update(0.02, 0.01 * k, 0.0)  # it sticks while the robot turns slowly
    assert abs(one.offset_rad) <= 0.6 + 1e-9
    assert one.doubted
    assert math.isfinite(one.offset_rad)


def cables(drive: Drive, first: int, rng: np.random.Generator) -> Points:
    """Cables two metres long, which lie where they lie, the three nearest."""
    places = np.random.default_rng(7).uniform((-9.0, -6.0), (9.0, 6.0), (14, 2))

    def points(pose: Pose) -> np.ndarray:
        near = places[np.argsort(np.hypot(*(places - [pose.x, pose.y]).T))[:3]]
        on_them = near[rng.integers(0, 3, 200)] + rng.uniform(-1.0, 1.0, (200, 1)) * [0.5, 0.87]
        return pose.inverse().transform(on_them)

    return points


@BOTH
def test_three_points_in_ten_on_no_line_raise_no_alarm(name: str) -> None:
    drive = Fault("cables", 0.5, 9.0, shown(cables, ratio=(0.3, 0.3))).laid_into(driven(2), np.random.default_rng(0))
    estimates = localized(name, drive)
    assert all(estimate.status is Status.TRACKING for estimate in estimates[5:])
    assert wrong(drive, estimates) == 0


def test_clutter_beside_the_lines_does_not_hide_that_the_compass_has_failed() -> None:
    """Lines of the next field leave a large mean distance; the compass was asked, as if nothing had agreed with it."""
    one = CompassCorrection()
    for _ in range(12):
        one.update(0.2, 0.3, 0.3, error=0.08)
    for _ in range(3):
        one.update(0.2, 0.3, 0.3 + math.pi, error=0.08)
    assert one.doubted


@pytest.mark.parametrize("name", ["nubot-mti", "nubot-mcl", "iris-fusion"])
def test_a_compass_false_from_the_first_frame_leaves_both_ends_named(name: str) -> None:
    drive = Fault("compass", 0.0, 9.0, turned_compass).laid_into(driven(1), np.random.default_rng(0))
    estimates = localized(name, drive)
    tracked = [
        (e, Pose(*t)) for e, t in zip(estimates, drive.truth.tolist(), strict=True) if e.status is Status.TRACKING
    ]
    assert len(tracked) > 30
    for estimate, truth in tracked:
        twin = estimate.hypotheses[-1]
        assert min(estimate.pose.distance_to(truth), twin.pose.distance_to(truth)) < 0.3
        assert twin.probability == COMPASS_FALSE


@pytest.mark.parametrize(("held_error", "doubted"), [(0.2, True), (0.05, False)])
def test_a_pose_that_only_held_against_the_search_is_looked_at_again_before_it_is_believed(
    held_error: float, doubted: bool
) -> None:
    drive = Fault("ring", 0.0, 9.0, RING).laid_into(driven(1), np.random.default_rng(0))
    made = NubotMti(RobotSetup(drive.field), NubotMtiSettings(), np.random.default_rng(0))
    frame = drive.frames[0]
    made.history.add(frame)
    assert frame.observation is not None
    view = made.following.inputs.of(frame.observation)
    fix = made.following.failure.search.locate(view.positions_m, view.weights, 0.3)
    assert fix is not None
    assert fix.match.error > 0.1
    made.following.doubt.reset(held_error)
    made.following.doubt.refutes(view, fix.match, PoseFilter(fix.match.pose, fix.match.covariance), Fusion.SUPPORTS)
    assert ("pose-ambiguous" in [each.code for each in made.following.doubt.reasons]) == doubted
