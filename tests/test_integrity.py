"""The monitor of consistency: silent while all is well, it names the sensor that contradicts and holds the pose."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from drives import Drive, open_drive

from touchline.geometry import FloatArray, Pose
from touchline.localization.estimator.field_proof import FieldProof
from touchline.localization.estimator.motion_relation import (
    WINDOW,
    MotionRelation,
)
from touchline.localization.estimator.step_noise import StepNoise
from touchline.localization.estimator.visual_motion import (
    Sighting,
)
from touchline.motion import MotionHistory
from touchline.motion.delayed import Delayed, with_signs
from touchline.motion.odometry import Motion
from touchline.systems import open_system
from touchline.types import Frame, Samples


def match() -> Drive:
    return open_drive("match")


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
def test_the_gyro_tells_frozen_odometry_from_a_turning_head(gyro: float, code: str) -> None:
    relation = related(lambda step: Pose(0.0, 0.0, 0.0), all_round=False, ahead=0.0, gyro=lambda rate: gyro * rate)
    assert max(relation.statistics.values()) >= 1.0
    assert relation.blame().code == code


@pytest.mark.parametrize(
    ("gyro", "code"),
    [
        (lambda rate: rate, "odometry-against-gyro"),
        (lambda rate: 0.0, "images-against-odometry"),  # it agrees with neither
        (None, "images-against-odometry"),
    ],
)
def test_what_nothing_explains_is_the_odometrys_by_the_gyro(gyro: Callable[[float], float] | None, code: str) -> None:
    rng = np.random.default_rng(5)
    relation = related(lambda step: Pose(*rng.normal(0.0, 0.2, 3).tolist()), gyro=gyro)
    assert not relation.is_explained
    assert relation.blame().code == code
    assert relation.is_guess is (code == "images-against-odometry")


def test_odometry_of_known_wrong_signs_is_put_right() -> None:
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


def test_a_turn_to_the_other_end_proves_no_field() -> None:
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


def test_slipping_feet_contradict_nothing_and_a_wrong_sign_does() -> None:
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


def test_a_camera_that_looks_ahead_does_not_look_back() -> None:
    def around(step: Pose) -> Pose:
        return Pose(-0.999 * step.x - 0.04 * step.y, 0.04 * step.x - 0.999 * step.y, step.heading)

    assert related(around).blame().at_fault == "images"
    assert related(around, all_round=False).blame().at_fault == "odometry"


@pytest.mark.parametrize("late_s", [0.0, 0.3])
def test_the_way_before_a_clock_was_set_refutes_nothing(late_s: float) -> None:
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
