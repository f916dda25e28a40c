"""The monitor of consistency: silent while all is well, it names the sensor that contradicts and holds the pose."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fakes import codes_of

from touchline.geometry import FloatArray, Pose
from touchline.localization.estimator import visual_motion
from touchline.localization.estimator.bank import Image, Member
from touchline.localization.estimator.field_proof import FieldProof
from touchline.localization.estimator.filter import Filter
from touchline.localization.estimator.integrity import GYRO_RATIO, Jump, Verdict, _unseen_rad
from touchline.localization.estimator.line_coverage import LineCoverage
from touchline.localization.estimator.motion_relation import (
    AGREEING,
    MAX_COST,
    WINDOW,
    MotionRelation,
)
from touchline.localization.estimator.step_noise import StepNoise
from touchline.localization.estimator.visual_motion import (
    MAX_SIGMA_M,
    UNKNOWN_M,
    Sighting,
    VisualMotion,
    _told_alone,
    difference,
)
from touchline.localization.registration.joint import StateFit
from touchline.localization.registration.registration import FOLLOWING
from touchline.motion import MotionHistory
from touchline.motion.delayed import Delayed, with_signs
from touchline.motion.odometry import Motion
from touchline.systems import open_system
from touchline.systems.touchline import Touchline
from touchline.types import Estimate, Frame, LinePoints, Observation, Prior, Problem, ProblemCode, Samples, Status
from touchline_lab.experiments import drives
from touchline_lab.experiments.catalogue import CATALOGUE, FEATURES, MIRROR, driven_by, laid
from touchline_lab.experiments.clutter import all_of, bars, nets, robots, shown, standing
from touchline_lab.experiments.drives import Drive, driven, track_of
from touchline_lab.experiments.faults import frames_of
from touchline_lab.experiments.injections import Fault, stepped

FROM_S = 6.0
Change = Callable[[Frame, Frame], Frame]  # of a frame and the one at which the fault begins


def match() -> Drive:
    return driven("match", 1, 14.0)


def estimates_of(drive: Drive, change: Change | None = None, name: str = "touchline", **sets: bool) -> list[Estimate]:
    """Of a system on a drive whose frames are changed from FROM_S on."""
    system = open_system(name, drive.setup, {key.replace("__", "."): value for key, value in sets.items()})
    first = next(frame for frame in drive.frames if frame.stamp_ns >= 1e9 * FROM_S)
    frames = [f if change is None or f.stamp_ns < first.stamp_ns else change(f, first) for f in drive.frames]
    return [system.step(frame) for frame in frames]


def placed(frame: Frame, by: FloatArray) -> Frame:
    """A frame whose points are multiplied by a matrix (2, 2)."""
    assert frame.observation is not None
    p = frame.observation.points
    points = LinePoints(p.positions_m @ by.T, by @ p.covariances_m2 @ by.T, p.confidences, p.pixels)
    return replace(frame, observation=Observation(frame.stamp_ns, points))


def mirrored(frame: Frame, first: Frame) -> Frame:
    return placed(frame, np.diag([1.0, -1.0]))


def longer(frame: Frame, first: Frame) -> Frame:
    return placed(frame, 1.1 * np.eye(2))


def repeated(frame: Frame, first: Frame) -> Frame:
    assert first.observation is not None
    return replace(frame, observation=Observation(frame.stamp_ns, first.observation.points))


def turned_wrongly(drive: Drive) -> Drive:
    """Odometry whose turns have the wrong sign from FROM_S on, and whose steps ahead and aside are right."""
    last = told = Pose(0.0, 0.0, 0.0)
    frames = []
    for frame in drive.frames:
        assert frame.odometry is not None
        rows = []
        for stamp_ns, row in zip(frame.odometry.stamp_ns, frame.odometry.values.tolist(), strict=True):
            x, y, turn = last.inverse().compose(Pose(*row))
            told = told.compose(Pose(x, y, -turn if stamp_ns > 1e9 * FROM_S else turn))
            last = Pose(*row)
            rows.append(told)
        frames.append(replace(frame, odometry=Samples(frame.odometry.stamp_ns, np.array(rows))))
    return replace(drive, frames=frames)


def test_nothing_is_said_while_all_is_well() -> None:
    drive = match()
    estimates = estimates_of(drive)
    assert not any(estimate.problems for estimate in estimates[10:])
    assert all(max(estimate.statistics.values()) < 1.0 for estimate in estimates)
    track = track_of(drive, estimates)
    bounds = np.array([math.inf if one.protection_m is None else one.protection_m for one in estimates])
    tracked = np.isfinite(bounds)
    assert tracked[10:].mean() > 0.95
    assert (track.distances_m <= bounds)[tracked].all()
    assert np.median(bounds[tracked]) < 0.1


def test_a_mirror_that_seems_to_differ_as_an_exact_one_does_is_that_of_its_camera_yaml() -> None:
    """Its centre seems to lie four of the stated standard deviations aside: a fifth of a pixel."""
    estimates = estimates_of(driven_by(MIRROR, 5, 5205, 30.0))
    assert 0.3 < max(estimate.statistics["camera"] for estimate in estimates) < 1.0
    assert "camera-differs" not in codes_of(*estimates)


def test_bars_of_nets_in_the_place_of_lines_are_not_tracked_where_the_pose_jumps_to_them() -> None:
    """They move as a field would, and some pose explains them; neither gyro nor odometry felt how it came there."""
    bars = next(kind for kind in CATALOGUE if kind.title == f"{FEATURES}: four bars of nets instead")
    drive = laid((bars,), 5, 5115).faulty
    found = frames_of(drive, drives.estimates_of("touchline", drive, 5115))
    assert found.wrong.sum() < 3
    assert found.tracking.sum() > 120


def test_a_pose_may_jump_at_a_stamp_before_zero() -> None:
    """Late images of a clock that has just begun to count."""
    late = next(kind for kind in CATALOGUE if kind.title == f"{FEATURES}: camera's clock 300 ms slow")
    drive = laid((late,), 0, 5102).faulty.until(0.5)
    assert drive.frames[0].stamp_ns < 0
    assert len(drives.estimates_of("touchline", drive, 5102)) == len(drive.frames)


def test_two_slips_within_a_second_are_no_alarm() -> None:
    drive = driven("match", 8000, 60.0).until(30.0)
    slips_s = [time_s for time_s in drive.times_of("slip") if 26.0 < time_s < 28.0]
    assert len(slips_s) == 2
    estimates = [one for one, time_s in zip(estimates_of(drive), drive.times_s, strict=True) if time_s > slips_s[0]]
    assert not any("odometry" in code for code in codes_of(*estimates))


@pytest.mark.parametrize(
    ("change", "code"), [(mirrored, "images-mirrored"), (repeated, "images-repeat"), (longer, "field-off-lines")]
)
def test_a_fault_of_the_images_is_named_and_the_pose_is_held(change: Change, code: str) -> None:
    drive = match()
    estimates = estimates_of(drive, change)
    track = track_of(drive, estimates)
    assert track.wrong.sum() <= 5  # of 80 frames with the fault
    assert code in codes_of(*estimates)
    late = [one for one, time_s in zip(estimates, drive.times_s, strict=True) if time_s > FROM_S + 2.0]
    assert all(one.protection_m is None for one in late if one.status is not Status.TRACKING)
    assert np.mean([one.status is Status.SEARCHING for one in late]) > 0.9


def test_odometry_that_turns_the_wrong_way_is_named_and_no_longer_counts() -> None:
    drive = turned_wrongly(match())
    estimates = estimates_of(drive)
    track = track_of(drive, estimates)
    assert track.wrong.sum() <= 1
    assert track.tracking[drive.times_s > FROM_S].mean() > 0.95  # by vision alone
    assert "odometry-turn-sign" in codes_of(*estimates)
    assert np.median(track.distances_m[drive.times_s > FROM_S + 2.0]) < 0.03


def test_a_pose_that_was_not_given_is_confirmed_by_motion() -> None:
    drive = match()
    still = replace(drive.frames[0], odometry=drive.frames[0].odometry)
    system = open_system("touchline", drive.setup)
    assert system.step(still).reason == "not yet confirmed by motion"
    system.reset(Pose(*drive.truth[0].tolist()))
    assert system.step(still).status is Status.TRACKING


def test_a_pose_found_in_the_own_half_counts_once_two_images_agree_and_one_that_was_left_is_no_contradiction() -> None:
    integrity, here = open_system("touchline", match().setup).safeguard.integrity, Pose(1.0, 0.0, 0.0)  # type: ignore[attr-defined]
    integrity.reset(confirmed=True, own_half=True)
    found, follows, elsewhere = Jump(None, True), Jump(here, False), Jump(here, True)
    confirmed = []
    for jump, share in ((found, 1.0), (follows, 0.9), (follows, 0.7), (follows, 0.9), (follows, 0.9), (follows, 0.7)):
        integrity._confirm(jump, True, False, explaining(here, share))
        confirmed.append(integrity.confirmed)
    assert confirmed == [False, False, False, False, True, True]
    for jump in (elsewhere, follows, follows):
        integrity._confirm(jump, True, False, explaining(here, 1.0))
    assert integrity.confirmed


def explaining(pose: Pose, share: float) -> Member:
    """A hypothesis that explains so much of its image."""
    nothing, initial = np.zeros((3, 3)), open_system("touchline", match().setup).initial  # type: ignore[attr-defined]
    fit = StateFit(pose.as_array(), nothing, np.zeros(3), share, 1.0, 1.0, 0.0, 0.0, 0.0)
    return Member(Filter(pose, np.eye(3), initial), 0.0, fit=fit)


@pytest.mark.parametrize(("found", "by_turns"), [(Pose(0.4, -0.5, 0.2), False), (Pose(0.0, 3.0, 0.0), True)])
def test_a_given_pose_that_is_half_a_metre_off_needs_no_turns_to_be_confirmed(found: Pose, by_turns: bool) -> None:
    """Mirrored images would show it elsewhere: only where these may be is a robot that drives ahead not enough."""
    integrity = open_system("touchline", match().setup).safeguard.integrity  # type: ignore[attr-defined]
    integrity.reset(confirmed=True, given=True)
    integrity._confirm(Jump(Pose(0.0, 0.0, 0.0), True), True, False, explaining(found, 1.0))
    assert not integrity.confirmed
    assert integrity._contradicted is by_turns


def test_a_start_that_was_given_is_contradicted_by_later_jumps_too() -> None:
    """The first image, which is mirrored, lies near it for want of anything better, the next ones where they belong."""
    integrity = open_system("touchline", match().setup).safeguard.integrity  # type: ignore[attr-defined]
    for given in (True, False):
        integrity.reset(confirmed=given, given=given)
        for start, found in ((Pose(0.0, 0.0, 0.0), Pose(0.4, -0.5, 0.2)), (Pose(0.4, -0.5, 0.2), Pose(0.0, 3.0, 3.1))):
            integrity._confirm(Jump(start, True), True, False, explaining(found, 1.0))
        assert not integrity.confirmed
        assert integrity._contradicted is given


def related(
    change: Callable[[Pose], Pose],
    steps: int = WINDOW,
    all_round: bool = True,
    outliers: Sequence[int] = (),
    blurred: bool = False,
    ahead: float = 1.0,
    gyro: Callable[[float], float] | None = None,
) -> MotionRelation:
    """The relation of a robot that drives in curves, whose odometry tells its steps otherwise; outliers: images that
    show it elsewhere. blurred: whether they may. ahead: of its way, 0 where it turns in place; gyro: what one tells, if
    there is one, of a rate (rad/s).
    """
    history, relation = MotionHistory(), MotionRelation()
    relation.all_round = all_round
    pose, told = Pose(0.0, 0.0, 0.0), Pose(0.0, 0.0, 0.0)
    for k in range(steps):
        stamp_ns = 100_000_000 * (k + 1)
        rate = 2.0 * math.sin(0.2 * (k - 1))
        felt = None if gyro is None else Samples(np.array([stamp_ns]), np.array([[0.0, 0.0, gyro(rate)]]))
        history.add(Frame(stamp_ns, odometry=Samples(np.array([stamp_ns]), np.array([told])), gyro=felt))
        shown = pose.as_array() + (np.array([0.3, -0.4, 0.3]) if k in outliers else 0.0)
        sighting = Sighting(stamp_ns, shown, 1e-6 * np.eye(3), 1.0, 0.0, begun=k == 0, blurred=blurred)
        relation.update(sighting, history, 0.0, jumped=False)
        step = Pose(0.2 * ahead, 0.1 * ahead * math.sin(0.3 * k), 0.2 * math.sin(0.2 * k))
        pose, told = pose.compose(step), told.compose(change(step))
    return relation


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (lambda step: Pose(step.x, step.y, -step.heading), "odometry-turn-sign"),
        (lambda step: Pose(-step.x, step.y, step.heading), "odometry-x-sign"),
        (lambda step: Pose(step.x, -step.y, -step.heading), "images-mirrored"),
        (lambda step: Pose(1.4 * step.x, 1.4 * step.y, step.heading), "odometry-scale"),
        (lambda step: Pose(0.0, 0.0, 0.0), "odometry-frozen"),
        (
            lambda step: Pose(0.94 * step.x + 0.34 * step.y, 0.94 * step.y - 0.34 * step.x, step.heading),
            "images-turned",
        ),
    ],
)
def test_what_contradicts_is_named(change: Callable[[Pose], Pose], code: str) -> None:
    relation = related(change)
    assert max(relation.statistics.values()) >= 1.0
    assert relation.blame().code == code


@pytest.mark.parametrize(
    ("gyro", "code"),
    [(1.0, "odometry-frozen"), (0.0, "images-spin")],
)
def test_the_gyro_tells_an_odometry_that_stands_still_from_a_head_that_turns_untold(gyro: float, code: str) -> None:
    relation = related(lambda step: Pose(0.0, 0.0, 0.0), all_round=False, ahead=0.0, gyro=lambda rate: gyro * rate)
    assert max(relation.statistics.values()) >= 1.0
    assert relation.blame().code == code


def test_an_odometry_whose_signs_are_known_to_be_wrong_is_put_right() -> None:
    backwards = related(lambda step: Pose(-step.x, -step.y, step.heading), all_round=False)
    assert backwards.signs == (-1, -1, 1)
    assert related(lambda step: Pose(step.x, -step.y, -step.heading)).signs is None  # mirrored images
    assert related(lambda step: step).signs is None
    motion = Motion(Pose(-0.4, 0.1, 0.2), 1e-6 * np.eye(3), 0.0)
    moved = with_signs(Delayed(motion, 0.1, np.ones(3), np.ones(3)), (-1, -1, 1), 0.5)
    assert moved.motion.pose == Pose(0.4, -0.1, 0.2)
    assert moved.late_s == 0.1
    sigmas = np.sqrt(np.diag(moved.motion.covariance))
    assert sigmas[2] > 0.2 > sigmas[0] > sigmas[1]  # that the turn's is right has not been shown


def test_after_a_fault_the_newest_steps_alone_count() -> None:
    relation = related(lambda step: Pose(-step.x, step.y, step.heading))
    relation.forget_fault()
    assert relation.gain == relation.sum == 0.0
    assert relation.mean == pytest.approx(AGREEING * MAX_COST / (WINDOW // 2), rel=0.2)
    assert len(relation._steps.costs) == AGREEING


def holding(found: Pose, verdict: Verdict, same_end: bool) -> Touchline:
    """A system whose images show a pose while another one, at (1, 1, 0), is held."""
    system = open_system("touchline", match().setup)
    assert isinstance(system, Touchline)
    system.reset(Prior(Pose(1.0, 1.0, 0.0)))
    guard, bank = system.safeguard, system.bank
    guard.held = bank.members[0].filter.placed(Pose(1.0, 1.0, 0.0), 1e-3 * np.eye(3))
    guard._same_end, guard.integrity.verdict = same_end, verdict
    bank.reset(guard.held.placed(found, 1e-4 * np.eye(3)))
    return system


@pytest.mark.parametrize(
    ("found", "seconds", "by_odometry", "same_end", "shown"),
    [
        (Pose(2.0, 1.0, 0.6), 5.0, False, False, "as found"),  # off by a metre and 35°: its twin is far
        (Pose(-2.0, -1.0, 3.1), 5.0, False, False, "its twin"),
        (Pose(-2.0, -1.0, 3.1), 5.0, False, True, "open"),  # images and odometry have gone on to either end
        (Pose(2.0, 1.0, 0.1), 100.0, False, False, "as found"),
        (Pose(2.0, 1.0, 0.1), 900.0, False, False, "open"),  # carried for too long
        (Pose(2.0, 1.0, 1.6), 5.0, False, False, "open"),  # turned by as much from either
        (Pose(-6.0, 1.0, 0.1), 5.0, False, False, "open"),
        (Pose(6.0, 1.0, 2.0), 5.0, True, True, "as found"),  # the odometry carried it off, the images go on
        (Pose(6.0, 1.0, 2.0), 5.0, True, False, "open"),
    ],
)
def test_the_end_of_a_pose_that_images_show_again_is_the_held_one_if_only_one_is_near(
    found: Pose, seconds: float, by_odometry: bool, same_end: bool, shown: str
) -> None:
    system = holding(found, Verdict(True, not by_odometry), same_end)
    assert system.safeguard.held is not None
    covariance = np.diag([1.0, 1.0, 1e-4])
    wide = system.safeguard.held.placed(found, covariance)
    system.safeguard._release(round(1e9 * seconds), system.bank, system.end, system.delay)
    assert system.safeguard.held is None
    assert system.end.undecided is (shown == "open")
    pose = system.bank.members[0].filter.pose
    assert shown == "open" or pose.is_near(found if shown == "as found" else found.mirrored(), 1e-9, 1e-9)
    system = holding(found, Verdict(True, not by_odometry), same_end)  # as seen along a lone line
    system.bank.reset(wide)
    system.safeguard._release(round(1e9 * seconds), system.bank, system.end, system.delay)
    assert system.bank.members[0].filter.covariance[0, 0] == pytest.approx(1.0)


def test_a_held_pose_is_let_go_in_the_image_in_which_the_odometry_is_blamed(monkeypatch: pytest.MonkeyPatch) -> None:
    """It was carried by that odometry."""
    system = holding(Pose(5.0, 1.0, 0.0), Verdict(False, True, is_guess=True), True)
    guard, best = system.safeguard, system.bank.best
    assert best is not None

    def blamed(*_: object) -> Verdict:
        guard.integrity.verdict = Verdict(True, False, Problem(ProblemCode.ODOMETRY_FROZEN, "odometry"))
        return guard.integrity.verdict

    monkeypatch.setattr(guard.integrity, "update", blamed)
    image = system._image(Frame(10**9), Observation(10**9), None)
    guard.update(
        10**9, image, system.bank, system.end, system.history, system.delay, Jump(best.filter.pose, False, True)
    )
    assert guard.held is None
    assert not system.end.undecided


@pytest.mark.parametrize(("gyro", "is_guess"), [(0.0, True), (1.0, False)])
def test_what_neither_an_explanation_nor_the_gyro_tells_is_a_guess(gyro: float, is_guess: bool) -> None:
    relation = related(lambda step: Pose(0.5 * step.x + 0.1, step.y - 0.1, -0.5 * step.heading + 0.1))
    relation._left = 2.0  # that no explanation accounts for it
    relation.gain = 0.0
    relation._every.gyro[:] = relation._every.driven[:, 2] if gyro else np.nan
    assert relation.is_guess is is_guess


def test_what_was_named_stays_named_while_it_explains_as_much_and_is_over_with_its_alarm() -> None:
    """Mirrored images of a robot that does not turn are an odometry with a wrong sign, too."""
    history, relation = MotionHistory(), MotionRelation()
    pose, told, culprits = Pose(0.0, 0.0, 0.0), Pose(0.0, 0.0, 0.0), []
    for k in range(3 * WINDOW):
        stamp_ns = 100_000_000 * (k + 1)
        history.add(Frame(stamp_ns, odometry=Samples(np.array([stamp_ns]), np.array([told]))))
        jumped = k == WINDOW // 4  # as mirrored images make a chain do
        relation.update(
            Sighting(stamp_ns, pose.as_array(), 1e-6 * np.eye(3), 1.0, 0.0, begun=k == 0), history, 0.0, jumped
        )
        step = Pose(0.2, 0.15, 0.1 if k < WINDOW else 0.0)
        pose, told = pose.compose(step), told.compose(Pose(step.x, -step.y, -step.heading))
        if max(relation.statistics.values()) >= 1.0:
            culprits.append(relation.blame().at_fault)
    assert set(culprits) == {"images"}
    relation.end_alarm()
    relation._explain(history)
    assert relation.blame().at_fault == "odometry"


def test_single_images_that_may_lie_elsewhere_are_no_contradiction() -> None:
    """Four of 32, the first one among them: each would make two steps that contradict; two in a row do."""
    apart, pairs = (0, 8, 16, 24), (7, 8, 15, 16, 23, 24)
    shown = {
        (outliers, blurred): related(lambda step: step, outliers=outliers, blurred=blurred)
        for outliers in (apart, pairs)
        for blurred in (False, True)
    }
    assert max(shown[apart, True].statistics.values()) < 0.1
    assert all(max(shown[each].statistics.values()) >= 1.0 for each in shown if each != (apart, True))


def test_the_step_to_an_image_that_may_lie_elsewhere_waits() -> None:
    waiting = related(lambda step: step, steps=26, outliers=(5, 6, 10, 11, 25), blurred=True)
    assert waiting.may_contradict
    assert max(waiting.statistics.values()) < 1.0
    assert not related(lambda step: step, steps=26, outliers=(25,), blurred=True).may_contradict


def test_wheels_that_spin_for_half_a_second_are_no_late_images() -> None:
    """A lag would explain the steps while they spin, and none of those after."""
    history, relation, told_m, true_m = MotionHistory(), MotionRelation(), 0.0, 0.0
    for k in range(40):
        stamp_ns, step_m = 100_000_000 * (k + 1), 0.15 if k < 18 else 0.25
        told_m, true_m = told_m + step_m + (0.2 if 12 <= k < 18 else 0.0), true_m + step_m
        history.add(Frame(stamp_ns, odometry=Samples(np.array([stamp_ns]), np.array([[told_m, 0.0, 0.0]]))))
        sighting = Sighting(stamp_ns, np.array([true_m, 0.0, 0.0]), 1e-6 * np.eye(3), 1.0, 0.0, begun=k == 0)
        relation.update(sighting, history, 0.0, jumped=False)
        if max(relation.statistics.values()) >= 1.0:
            assert relation.blame().code != "stamps-late"


def test_a_pose_found_elsewhere_is_on_trial() -> None:
    """A lucky place shows it, and three fifths of the usual lines have to be seen after that."""
    system = open_system("touchline", match().setup)
    assert isinstance(system, Touchline)
    lines, coverage = system.setup.field.line_tables, LineCoverage()
    around = np.linspace(-math.pi, math.pi, 73)[:-1]
    usual = np.column_stack((np.cos(around), np.sin(around))) * 2.0
    pose = np.array([0.0, 0.0, 0.0])
    rays = [usual[:k] for k in (72, 4)]

    def take(points: FloatArray, found: bool = False) -> None:
        if coverage.begins_image(found, settled=True):
            coverage.update(lines, points, pose)

    for points, still in ((rays[0], True), (rays[1], False)):
        coverage.reset()
        for _ in range(10):
            take(rays[0])
        take(rays[0], found=True)
        assert coverage.shown
        for _ in range(30):
            take(points)
        assert coverage.shown is still


def test_a_field_is_not_proved_across_a_turn_to_the_other_end() -> None:
    proof = FieldProof(18.0)
    for k in range(40):
        proof.update(Pose(1.0 + 0.05 * k, 0.3, 0.0), Pose(1.0 + 0.05 * k, 0.3, 0.0), 0.1)
    for k in range(40):
        back = Pose(-3.0 - 0.05 * k, -0.3, math.pi)
        proof.update(back, back, 0.1)
    assert not proof.given
    for k in range(100):
        on = Pose(-5.0 + 0.1 * k, -0.3, math.pi)
        proof.update(on, on, 0.1)
    assert proof.given


def test_steps_that_slip_as_feet_do_are_no_contradiction_and_a_wrong_sign_is() -> None:
    """A step's noise of legs, 12 cm of way with 3 cm of error, is no fault of images or odometry."""
    for sign, legs in ((1.0, True), (1.0, False), (-1.0, True)):
        rng, history, relation = np.random.default_rng(3), MotionHistory(), MotionRelation()
        relation.all_round = False
        pose, driven = Pose(0.0, 0.0, 0.0), Pose(0.0, 0.0, 0.0)
        for k in range(WINDOW):
            stamp_ns = 500_000_000 * (k + 1)
            history.add(Frame(stamp_ns, odometry=Samples(np.array([stamp_ns]), np.array([driven]))))
            sighting = Sighting(stamp_ns, pose.as_array(), 1e-6 * np.eye(3), 1.0, 0.0, begun=k == 0)
            relation.update(sighting, history, 0.0, jumped=False, steps=StepNoise(legs))
            slip = 0.03 * rng.standard_normal(2)
            pose = pose.compose(Pose(0.12, 0.05, 0.1))
            driven = driven.compose(Pose(sign * (0.12 + slip[0]), sign * (0.05 + slip[1]), 0.1))
        worst = max(relation.statistics.values())
        assert (worst < 0.9) is (legs and sign > 0.0)


def test_a_camera_that_shows_what_lies_ahead_does_not_look_back() -> None:
    def around(step: Pose) -> Pose:
        return Pose(-0.999 * step.x - 0.04 * step.y, 0.04 * step.x - 0.999 * step.y, step.heading)

    assert related(around).blame().at_fault == "images"
    assert related(around, all_round=False).blame().at_fault == "odometry"


def test_a_pose_found_where_mirrored_images_would_put_it_is_distrusted() -> None:
    integrity = open_system("touchline", match().setup).safeguard.integrity  # type: ignore[attr-defined]
    before = Pose(2.0, 1.6, 3.0)
    assert not integrity.suspect_mirror(1, Pose(2.0, 0.4, 3.0), before)
    assert not integrity.suspect_mirror(1, Pose(2.0, -1.6, 3.0), before)
    assert integrity.verdict.images
    assert integrity.suspect_mirror(1, Pose(2.1, -1.5, -3.0), before)
    assert not integrity.verdict.images
    assert integrity.verdict.problem.code == "images-mirrored"


def test_the_bound_holds_a_clock_that_was_set_until_the_motion_refutes_it() -> None:
    clean = driven("straight-tracks", 8305, 30.0, "motion.speed_m_s=0.5")  # at one speed nothing else shows it
    drive = Fault("", FROM_S, math.inf, stepped(0.3)).laid_into(clean, np.random.default_rng(0))
    found = frames_of(drive, estimates_of(drive))
    late = np.arange(len(found.bounded)) > 10.0 * FROM_S + 1
    assert found.bounded[late].sum() > 200
    assert found.misleading[late].mean() < 0.01


@pytest.mark.parametrize("late_s", [0.0, 0.3])
def test_what_was_driven_before_a_clock_was_set_refutes_nothing_of_it(late_s: float) -> None:
    """A robot that changes its speed, then drives on evenly while its clock is set, then changes it again: only now it
    shows whether images are stamped late.
    """
    history, relation, refuted = MotionHistory(), MotionRelation(), []

    def at(seconds: float) -> FloatArray:
        speed = (1.0, 0.5, 1.5)
        spans = np.clip([seconds, seconds - 1.5, seconds - 5.0], 0.0, [1.5, 3.5, np.inf])
        return np.array([float(spans @ speed), 0.0, 0.0])

    for k in range(80):
        stamp_ns, seconds = 100_000_000 * (k + 1), 0.1 * (k + 1)
        history.add(Frame(stamp_ns, odometry=Samples(np.array([stamp_ns]), at(seconds)[None])))
        if k == 25:
            relation.set_clock(0.3)
        seen = at(seconds - (late_s if k >= 25 else 0.0))
        relation.update(Sighting(stamp_ns, seen, 1e-6 * np.eye(3), 1.0, 0.0, begun=k == 0), history, 0.0, jumped=False)
        refuted.append(relation.clock_s != 0.0 and relation.refutes_clock)
    assert not any(refuted[:49])
    assert any(refuted) is (late_s == 0.0)


def test_images_that_lay_on_no_line_leave_a_pose_on_probation() -> None:
    """A field that fits here and there is refuted again and again: what fits next has to do so for a while."""
    integrity = open_system("touchline", match().setup).safeguard.integrity  # type: ignore[attr-defined]
    follows, elsewhere, doubts = Jump(Pose(0.0, 0.0, 0.0), False), Jump(Pose(0.0, 0.0, 0.0), True), []
    images = [
        *15 * [(2.0, 0.3, follows)],
        *20 * [(0.5, 0.9, follows)],
        (0.5, 0.9, elsewhere),
        *31 * [(0.5, 0.9, follows)],
    ]
    for k, (share, newest, jump) in enumerate(images):
        integrity.statistics, integrity._shares = {"share": share, "chance": 0.0}, [newest]
        integrity._take_probation(100_000_000 * (k + 1), jump)
        doubts.append("lay on no line" in integrity._doubt)
    assert not any(doubts[:11])
    assert all(doubts[12:64])
    assert not doubts[-1]


def test_a_bound_is_never_narrower_than_odometry_and_gyro_are_apart() -> None:
    assert _unseen_rad(0.02, 0.04) == pytest.approx(0.04)
    assert _unseen_rad(1.0, 0.01) == pytest.approx(GYRO_RATIO)
    assert _unseen_rad(1.0, 0.5) == _unseen_rad(-1.0, math.nan) == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("gyro", "confirmed", "tracked"),
    [(None, False, False), (1.0, False, True), (-1.0, False, False), (None, True, True), (-1.0, True, False)],
)
def test_a_turn_that_no_image_shows_needs_a_witness(gyro: float | None, confirmed: bool, tracked: bool) -> None:
    """The odometry's sign may be wrong until a turn was confirmed; the gyro is another witness, for and against it."""
    integrity = open_system("touchline", match().setup).safeguard.integrity  # type: ignore[attr-defined]
    history, stamps_ns = MotionHistory(), 10_000_000 * np.arange(1, 101)
    turns = 0.8 * np.linspace(0.0, 1.0, 100)
    poses = Samples(stamps_ns, np.column_stack((np.zeros((100, 2)), turns)))
    rates = None if gyro is None else Samples(stamps_ns, np.tile([0.0, 0.0, 0.8 * gyro], (100, 1)))
    history.add(Frame(int(stamps_ns[-1]), odometry=poses, gyro=rates))
    integrity._seen_ns, integrity._turns_proved = int(stamps_ns[0]), confirmed
    bound = integrity.protection(1e-6 * np.eye(3), int(stamps_ns[-1]), history)
    assert (bound is not None) is tracked
    assert tracked or "odometry alone" in integrity.unbounded
    assert bound is None or (bound[1] < 0.5) is (gyro is not None)


def test_a_pose_found_elsewhere_has_to_show_as_many_lines_as_usual() -> None:
    drive, coverage = match(), LineCoverage()
    seen = [frame.observation.points.positions_m for frame in drive.frames if frame.observation is not None]
    truth, lines = list(drive.truth), drive.field.line_tables
    for points_m, pose in zip(seen[:60], truth, strict=False):
        if coverage.begins_image(found=False, settled=True):
            coverage.update(lines, points_m, pose)
        assert coverage.shown
    for points_m, pose in zip(seen[60:90], truth[60:], strict=False):  # a few things that lie on lines of the field
        ahead = np.abs(np.arctan2(points_m[:, 1], points_m[:, 0])) < 0.4
        assert coverage.begins_image(found=pose is truth[60], settled=True)
        coverage.update(lines, points_m[ahead], pose)
        assert not coverage.shown
    assert coverage.begins_image(found=False, settled=True)
    coverage.update(lines, seen[90], truth[90])
    assert coverage.shown


def test_an_image_of_a_lone_line_tells_nothing_along_it_and_a_poor_one_what_it_tells() -> None:
    lone, poor = (np.diag(np.square([0.5 * MAX_SIGMA_M if lone else 0.04, 0.05, 0.01])) for lone in (True, False))
    assert _told_alone(lone, 1.0)[1, 1] > UNKNOWN_M**2
    np.testing.assert_array_equal(_told_alone(poor, 1.0), poor)
    assert (np.diag(_told_alone(poor, 0.6))[:2] > UNKNOWN_M**2).all()  # whose points lie on no line
    for deviations_m, untold in ([0.5, 0.5], [0, 1]), ([0.1, 0.5], [1]):  # what was expected is not told
        told = _told_alone(np.diag(np.square([*deviations_m, 0.01])), 1.0)
        assert np.flatnonzero(np.diag(told) > UNKNOWN_M**2).tolist() == untold


def test_the_pose_of_an_image_alone_is_that_of_its_registration(monkeypatch: pytest.MonkeyPatch) -> None:
    """One step from the filter's fit, in nearly all images; not where that leads away from the image before."""
    plain, update = visual_motion._alone, VisualMotion.update
    now: list[Any] = []
    apart: list[float] = []

    def watched(motion: VisualMotion, stamp_ns: int, image: Image, *told: Any) -> Sighting:
        now[:] = [motion, image]
        return update(motion, stamp_ns, image, *told)

    def compared(stamp_ns: int, camera: visual_motion.Camera, fit: StateFit, start: FloatArray) -> Sighting | None:
        alone = plain(stamp_ns, camera, fit, start)
        registered = now[0]._registered(stamp_ns, now[1], camera, start, FOLLOWING)
        off = np.full(3, np.nan) if alone is None else difference(alone.pose, registered.pose)
        apart.append(math.sqrt(off @ np.linalg.solve(registered.covariance, off)))
        assert plain(stamp_ns, camera, fit, start + np.array([0.3, 0.0, 0.0])) is None
        return alone

    monkeypatch.setattr(visual_motion, "_alone", compared)
    monkeypatch.setattr(VisualMotion, "update", watched)
    estimates_of(match().until(7.0))
    assert np.isnan(apart).mean() < 0.05
    assert np.nanmedian(apart) < 0.2  # standard deviations
    assert np.nanpercentile(apart, 95) < 0.7


def test_steps_that_agree_raise_no_alarm() -> None:
    relation = related(lambda step: step)
    assert max(relation.statistics.values()) < 0.1
    assert relation.confirms


@pytest.mark.parametrize(
    ("name", "switch", "wrong_alone"),
    [("nubot-mti", "paper__failure__monitor", 20), ("iris-fusion", "paper__monitor", 0)],
)
def test_a_published_system_can_have_the_monitor(name: str, switch: str, wrong_alone: int) -> None:
    """Silent while all is well; mirrored images are named, and hardly tracked where they make a pose wrong."""
    clean, alone = estimates_of(match(), None, name), estimates_of(match(), None, name, **{switch: False})
    assert [each.pose for each in clean] == [each.pose for each in alone]
    assert [each.status for each in clean] == [each.status for each in alone]
    assert not any(each.statistics or each.reason for each in alone)
    alone, told = (estimates_of(match(), mirrored, name, **sets) for sets in ({switch: False}, {}))
    assert track_of(match(), alone).wrong.sum() >= wrong_alone
    assert track_of(match(), told).wrong.sum() <= 3
    assert not wrong_alone or "images-mirrored" in codes_of(*told)


def test_once_the_field_is_proven_clutter_costs_no_status(monkeypatch: pytest.MonkeyPatch) -> None:
    drive = driven("match", 8011, 30.0)
    cluttered = shown(all_of(robots, nets, standing(bars)), ratio=(0.55, 0.55))(
        drive, np.ones(len(drive.frames), np.bool_), np.random.default_rng(1)
    )
    track = track_of(cluttered, estimates_of(cluttered))
    assert not track.wrong.any()
    assert track.tracking[-100:].mean() > 0.95
    monkeypatch.setattr(FieldProof, "given", False)
    assert track_of(cluttered, estimates_of(cluttered)).tracking[-100:].mean() < 0.5
