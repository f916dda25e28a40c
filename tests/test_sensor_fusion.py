"""The fusion of Ismail et al. 2021, section II.D: equations (15) to (19), and how each mode is entered and left."""

from __future__ import annotations

import math

import numpy as np
import pytest

from touchline.geometry import Pose
from touchline.motion.dead_reckoning import without_bias
from touchline.motion.odometry import Motion
from touchline.published.iris_fusion import field_side, restart
from touchline.published.iris_fusion import modes as limits
from touchline.published.iris_fusion.field_side import FieldSide
from touchline.published.iris_fusion.modes import (
    SensorFusion,
    SensorFusionPaper,
    SensorFusionSettings,
    blended,
)
from touchline.published.iris_fusion.restart import RestartRule
from touchline.published.particles.particle_set import ParticleEstimate
from touchline.types import Mode

STEP = Motion(Pose(0.1, 0.0, 0.0), np.diag([1e-5, 1e-5, 1e-6]), 0.0)
SURE = np.diag([0.02, 0.02, 0.01]) ** 2
HERE = Pose(1.0, 0.5, 0.3)
SETTINGS = SensorFusionSettings()


def seen(pose: Pose, points: int = 80, inlier_ratio: float = 0.95, spread_m: float = 0.03) -> ParticleEstimate:
    return ParticleEstimate(pose, np.diag([spread_m**2 / 2, spread_m**2 / 2, 1e-4]), points, inlier_ratio)


def at(x: float, y: float = 0.5, heading: float = 0.3) -> Pose:
    return Pose(x, y, heading)


def placed(settings: SensorFusionSettings | None = None, pose: Pose = HERE) -> SensorFusion:
    """A fusion that has used both for some images, at a pose."""
    fusion = SensorFusion(settings)
    fusion.place(pose, SURE)
    for _ in range(3):
        fusion.update(pose, Motion(Pose(0, 0, 0), STEP.covariance, 0.0), seen(pose), 0.1)
    assert fusion.mode is Mode.BOTH
    return fusion


def step(fusion: SensorFusion, odometry: Pose, vision: ParticleEstimate | None, motion: Motion = STEP) -> Mode:
    return fusion.update(odometry, motion, vision, 0.1)


# --- equations (15) to (19) -----------------------------------------------------------------------------------------


def test_the_pose_of_each_mode_is_the_paper_s() -> None:
    fusion = placed(SensorFusionSettings(beta=0.3, paper=SensorFusionPaper(bias_gain_per_s=0)))
    odometry, particles = at(1.1), at(1.16)
    assert step(fusion, odometry, seen(particles)) is Mode.BOTH
    assert fusion.pose == pytest.approx(blended(odometry, particles, 0.3))
    assert step(fusion, odometry, None) is Mode.ODOMETRY
    assert fusion.pose == odometry
    found = SensorFusion()
    for _ in range(limits.FRAMES):
        step(found, HERE, seen(at(-3.0)), Motion(Pose(0, 0, 0), STEP.covariance, 0.0))
    assert found.mode is Mode.OMNIVISION
    assert found.pose == at(-3.0)


def test_after_a_gap_the_odometry_has_a_smaller_share() -> None:
    shares = []
    for duration_s in (0.1, 0.4, 3.0):
        fusion = placed(SensorFusionSettings(beta=0.5, paper=SensorFusionPaper(bias_gain_per_s=0)))
        fusion.update(at(1.1), STEP, seen(at(1.2)), duration_s)
        shares.append((1.2 - fusion.pose.x) / 0.1)
    assert shares == pytest.approx([0.5, 0.5**4, 0.5**30], abs=1e-6)
    constant = placed(SensorFusionSettings(beta=0.5, paper=SensorFusionPaper(bias_gain_per_s=0, beta_period_s=None)))
    constant.update(at(1.1), STEP, seen(at(1.2)), 3.0)
    assert constant.pose.x == pytest.approx(1.15)


# --- omnivision + odometry ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "bad",
    [
        {"points": limits.MIN_POINTS - 1},
        {"inlier_ratio": limits.MIN_RATIO - 0.01},
        {"spread_m": limits.MAX_SPREAD_M + 0.01},
    ],
)
def test_an_image_that_shows_too_little_leaves_odometry_alone(
    bad: dict[str, float],
) -> None:
    fusion = placed()
    assert step(fusion, at(1.1), seen(at(1.13), **bad)) is Mode.ODOMETRY  # type: ignore[arg-type]
    assert fusion.pose == at(1.1)
    assert step(fusion, at(1.2), seen(at(1.2))) is Mode.BOTH


@pytest.mark.parametrize(
    "middling",
    [
        {"points": (limits.MIN_POINTS + limits.ENOUGH_POINTS) // 2},
        {"inlier_ratio": 0.5 * (limits.MIN_RATIO + SETTINGS.accepted_ratio)},
        {"spread_m": 0.5 * (limits.NARROW_M + limits.MAX_SPREAD_M)},
    ],
)
def test_limits_have_hysteresis(middling: dict[str, float]) -> None:
    """A middling image keeps the mode, whichever it is."""
    fusion = placed()
    assert step(fusion, at(1.1), seen(at(1.1), **middling)) is Mode.BOTH  # type: ignore[arg-type]
    step(fusion, at(1.2), None)
    assert step(fusion, at(1.3), seen(at(1.3), **middling)) is Mode.ODOMETRY  # type: ignore[arg-type]


# --- omnivision -----------------------------------------------------------------------------------------------------


def test_images_that_contradict_in_one_way_are_believed() -> None:
    fusion = placed()
    modes = [step(fusion, at(1.0 + 0.1 * k), seen(Pose(1.5 + 0.1 * k, 0.5, 0.3))) for k in range(1, 3)]
    assert modes == [Mode.ODOMETRY] * 2
    step_x = Motion(Pose(0.1 * math.cos(0.3), -0.1 * math.sin(0.3), 0.0), STEP.covariance, 0.0)  # along x of the field
    assert fusion.contradicting == 2
    assert step(fusion, at(1.3), seen(at(1.8)), step_x) is Mode.OMNIVISION
    assert fusion.pose == at(1.8)
    modes = [step(fusion, at(1.8 + 0.1 * k), seen(at(1.8 + 0.1 * k)), step_x) for k in range(1, 4)]
    assert modes == [Mode.OMNIVISION, Mode.OMNIVISION, Mode.BOTH]


def test_images_that_contradict_each_otherwise_are_never_believed() -> None:
    fusion = placed()
    for k in range(12):
        away = Pose(1.0 + 0.8 * (-1) ** k, 0.5 + 0.5 * (k % 3), 0.3)
        assert step(fusion, HERE, seen(away), Motion(Pose(0, 0, 0), STEP.covariance, 0.0)) is Mode.ODOMETRY
    assert fusion.pose == HERE


def test_only_images_that_fit_well_find_a_robot() -> None:
    still = Motion(Pose(0, 0, 0), STEP.covariance, 0.0)
    poor = SETTINGS.found_ratio - 0.02
    fusion = SensorFusion()
    assert {step(fusion, HERE, seen(at(-2.0), inlier_ratio=poor), still) for _ in range(10)} == {Mode.ODOMETRY}
    assert not fusion.has_pose
    fusion.search_anew(1, displaced=False)  # one has ended without finding it: a poor calibration, perhaps
    assert [step(fusion, HERE, seen(at(-2.0), inlier_ratio=poor), still) for _ in range(3)][-1] is Mode.OMNIVISION
    assert fusion.has_pose


# --- odometry -------------------------------------------------------------------------------------------------------


def test_the_gyro_s_bias_is_learned_from_the_particles() -> None:
    fusion, bias_rad_s, heading = SensorFusion(), math.radians(1.0), 0.0
    fusion.place(HERE, SURE)
    truth = Pose(0.0, 0.0, 0.0)
    fusion.pose = odometry = truth
    for _ in range(150):
        felt = Motion(Pose(0.0, 0.0, bias_rad_s * 0.1), STEP.covariance, 0.0)
        motion = without_bias(felt, fusion.bias_rad_s, 0.1)
        odometry = odometry.compose(motion.pose)
        assert step(fusion, odometry, seen(truth), motion) is Mode.BOTH
        odometry, heading = fusion.pose, fusion.pose.heading
    assert fusion.bias_rad_s == pytest.approx(bias_rad_s, rel=0.05)
    assert abs(heading) < math.radians(0.02)
    paper = placed(SensorFusionSettings(paper=SensorFusionPaper(bias_gain_per_s=0)))
    step(paper, at(1.1, heading=0.32), seen(at(1.1)))
    assert paper.bias_rad_s == 0.0


# --- restart --------------------------------------------------------------------------------------------------------


def test_particles_start_anew_after_images_that_contradict_them() -> None:
    rule = RestartRule()
    poor = restart.MIN_RATIO - 0.1
    assert [rule.is_refuted(poor) for _ in range(restart.FRAMES)] == [False] * (restart.FRAMES - 1) + [True]
    rule.start()
    assert [rule.is_refuted(0.1) for _ in range(2)] == [False, True]
    rule.start()
    rule.reset()
    for _ in range(restart.FRAMES - 1):
        rule.is_refuted(poor)
    assert not rule.is_refuted(0.9)
    assert not rule.is_refuted(poor)
    for found_since in (False, True):
        rule.reset()
        for _ in range(restart.BLIND_FRAMES):
            rule.see_nothing()
        if found_since:
            rule.found()
        assert rule.is_refuted(poor) is not found_since
    rule.reset()
    lost = [rule.is_refuted(0.95, lost=True) for _ in range(restart.FRAMES)]  # fits well, but elsewhere
    assert lost == [False] * (restart.FRAMES - 1) + [True]


def test_the_compass_leads_from_the_wrong_end() -> None:
    side, frames = FieldSide(1.6), field_side.HEADING_FRAMES
    answers = []
    for _ in range(frames):
        side.update_from_compass(math.pi)
        answers.append(side.wrong)
    assert answers == [False] * (frames - 1) + [True]
    side.search(known=False)
    assert not side.wrong
    for _ in range(frames):
        assert not side.known
        side.update_from_compass(0.1)
        assert not side.wrong
    assert side.known
    paper = FieldSide(None)
    for _ in range(50):
        paper.update_from_compass(math.pi)
        assert not paper.wrong


def heard(side: FieldSide, off_compass_rad: float, frames: int) -> list[bool]:
    """So many images with such a compass; whether the robot was at the wrong end after each."""
    answers = []
    for _ in range(frames):
        side.update_from_compass(off_compass_rad)
        answers.append(side.wrong)
    return answers


def test_a_compass_that_turns_round_is_doubted() -> None:
    side = FieldSide(1.6)
    assert not any(heard(side, 0.1, 100))
    assert not any(heard(side, math.pi, 100))  # ten seconds
    assert side.doubted
    assert not side.known  # the twin is named meanwhile
    heard(side, 0.1, field_side.HEADING_FRAMES)
    assert side.known
    assert not side.doubted
    answers = heard(side, math.pi, 105 + field_side.PATIENCE_FRAMES + 1)  # one that goes on for longer is right
    assert answers.index(True) == len(answers) - 1


def test_searches_start_anew_after_some_cycles_each_with_wider_headings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(restart, "MAX_CYCLES", 4)
    rule = RestartRule()
    assert rule.start_is_due()
    assert rule.start() == 1.0
    for due in (False, False, False, True):
        rule.count_cycle()
        assert rule.start_is_due() is due
    assert rule.failed == 1
    assert [rule.start(), rule.start()] == [1.5, 1.5**2]
    rule.found()
    assert rule.failed == 0
    assert rule.start() == 1.0
