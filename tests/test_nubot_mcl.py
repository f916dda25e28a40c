"""nubot-mcl on the public recordings, under black sectors, and on what may go wrong."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from touchline.camera import OmniCamera
from touchline.config import PAPER, load_settings
from touchline.field import open_field
from touchline.geometry import FloatArray, Pose, wrap_angle, wrap_angles
from touchline.perception import SelfLearningDetector, observe
from touchline.published.nubot import particle_localizer
from touchline.published.nubot_mcl.alone import NubotMclAlone, NubotMclAloneSettings
from touchline.published.nubot_mcl.particle_localizer import CONFIRMATIONS
from touchline.published.nubot_mcl.particles import NubotParticleSettings
from touchline.published.nubot_mcl.system import NubotMcl, NubotMclSettings
from touchline.sources import open_source
from touchline.systems import SYSTEMS, RobotSetup, open_system
from touchline.types import Estimate, Frame, LinePoints, Observation, Prior, Samples, Status

FIELD = open_field("msl-18x12")
# from, to in degrees, in the image; the last is a contiguous half, which the papers don't have
SECTORS = {
    "none": [],
    "12.5 %": [(0, 45)],
    "25 %": [(0, 45), (180, 225)],
    "50 %": [(0, 45), (90, 135), (180, 225), (270, 315)],
    "half": [(0, 180)],
}


def in_sectors(camera: OmniCamera, sectors: list[tuple[int, int]]) -> FloatArray:
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    angle = np.degrees(np.arctan2(v - camera.center[1], u - camera.center[0])) % 360
    return np.any([(angle >= low) & (angle < high) for low, high in sectors] or [angle < 0], axis=0)


@cache
def recorded(folder: Path, sectors: str) -> tuple[list[Frame], list[bool], FloatArray]:
    """The frames with their line points in place of images, which images are black, and the true poses (N, 3)."""
    source = open_source(folder)
    detector = SelfLearningDetector(source.camera, line_width_m=source.field.line_width)
    hidden = in_sectors(source.camera, SECTORS[sectors])
    frames, black = [], []
    for frame in source:
        assert frame.image is not None
        image = np.where(hidden[..., np.newaxis], np.uint8(0), frame.image)
        points = observe(replace(frame, image=image), detector).points
        frames.append(replace(frame, image=None, observation=Observation(frame.stamp_ns, points)))
        black.append(bool(frame.image.mean() < 12))
    truth = np.loadtxt(folder / "ground_truth.tum")
    return frames, black, np.column_stack((truth[:, 1:3], 2 * np.arctan2(truth[:, 6], truth[:, 7])))


def follow(
    folder: Path, sectors: str, *sets: str, name: str = "nubot-mcl"
) -> tuple[FloatArray, list[Estimate], FloatArray]:
    """Errors (N, 3), estimates, and which images are black (N,)."""
    frames, black, poses = recorded(folder, sectors)
    settings = load_settings(SYSTEMS[name].settings, None, sets)
    source = open_source(folder)
    system = open_system(name, RobotSetup(source.field, source.camera), settings)
    return *errors_of([system.step(each) for each in frames], poses), np.array(black)


def errors_of(estimates: list[Estimate], poses: FloatArray) -> tuple[FloatArray, list[Estimate]]:
    errors = np.array([e.pose for e in estimates]) - poses
    errors[:, 2] = wrap_angles(errors[:, 2])
    return errors, estimates


@pytest.mark.parametrize("sectors", SECTORS)
def test_black_sectors_over_up_to_half_the_image_cost_little(shared_data: Path, sectors: str) -> None:
    errors, estimates, _ = follow(shared_data / "omni_msl_track", sectors)
    followed = np.array([e.status is Status.TRACKING for e in estimates])
    assert followed[1:].all()
    distance_m = np.hypot(errors[followed, 0], errors[followed, 1])
    assert distance_m.mean() <= 0.015
    assert distance_m.max() <= 0.05
    assert np.abs(errors[followed, 2]).mean() <= 0.005


def test_a_system_with_a_camera_sees_the_lines_itself(shared_data: Path) -> None:
    source = open_source(shared_data / "omni_msl_sun")
    made = open_system("nubot-mcl", RobotSetup(source.field, source.camera))
    seen = [made.step(each) for each in itertools.islice(source, 10)]
    _, told, _ = follow(shared_data / "omni_msl_sun", "none")
    assert [e.pose for e in seen] == [e.pose for e in told[:10]]
    assert [e.points for e in seen] == [e.points for e in told[:10]]


@pytest.mark.parametrize("name", ["omni_msl_match", "omni_msl_sun", "omni_9x6_points"])
def test_every_recording_is_followed(shared_data: Path, name: str) -> None:
    errors, estimates, _ = follow(shared_data / name, "none")
    assert all(e.status is Status.TRACKING for e in estimates[2:])
    assert np.hypot(errors[2:, 0], errors[2:, 1]).max() <= 0.05


def test_a_kidnapped_robot_is_found_within_5_frames(shared_data: Path) -> None:
    errors, estimates, black = follow(shared_data / "omni_msl_kidnap", "none")
    returns = np.nonzero(black[:-1] & ~black[1:])[0] + 1
    assert len(returns) == 2
    for first in [*returns, 0]:
        place = slice(first + 4, first + 17)
        assert np.hypot(errors[place, 0], errors[place, 1]).max() <= 0.05
    assert any(e.status is Status.LOST for e in estimates)


# ---- from here on without images: points of a known pose --------------------------------------------------------


def seen_from(pose: Pose, seed: int = 0, reach_m: float = 5.0) -> LinePoints:
    rng = np.random.default_rng(seed)
    robot = pose.inverse().transform(np.concatenate([line[::5] for line in FIELD.polylines()]))
    robot = robot[np.hypot(*robot.T) < reach_m]
    robot = np.concatenate((robot + rng.normal(0, 0.01, robot.shape), rng.uniform(-4, 4, (5, 2))))
    n = len(robot)
    return LinePoints(robot, np.tile(np.eye(2) * 0.02**2, (n, 1, 1)), np.ones(n), np.full((n, 2), np.nan))


def frame(index: int, points: LinePoints, odometry: Pose, compass_rad: float | None) -> Frame:
    stamp = np.array([index * 100_000_000], dtype=np.int64)
    compass = None if compass_rad is None else Samples(stamp, np.array([[compass_rad]]))
    return Frame(
        int(stamp[0]),
        observation=Observation(int(stamp[0]), points),
        odometry=Samples(stamp, np.array([odometry])),
        compass=compass,
    )


def system(*sets: str, prior: Prior | None = None, seed: int = 0) -> NubotMcl:
    settings = load_settings(NubotMclSettings, None, sets)
    made = open_system("nubot-mcl", RobotSetup(FIELD), settings, np.random.default_rng(seed))
    assert isinstance(made, NubotMcl)
    made.reset(prior)
    return made


def alone(*sets: str, prior: Prior | None = None, seed: int = 0) -> NubotMclAlone:
    settings = load_settings(NubotMclAloneSettings, None, sets)
    made = open_system("nubot-mcl-alone", RobotSetup(FIELD), settings, np.random.default_rng(seed))
    assert isinstance(made, NubotMclAlone)
    made.reset(prior)
    return made


Make = Callable[..., NubotMcl | NubotMclAlone]
either = pytest.mark.parametrize("make", [system, alone])


def stand(made: NubotMcl | NubotMclAlone, pose: Pose, frames: range, compass_rad: float | None) -> list[Estimate]:
    return [made.step(frame(k, seen_from(pose, k), Pose(0.0, 0.0, 0.0), compass_rad)) for k in frames]


def error_m(estimate: Estimate, pose: Pose) -> float:
    return estimate.pose.distance_to(pose)


def test_figure_3_particles_then_matching_then_five_bad_frames_then_particles_again() -> None:
    here, there = Pose(2.0, 1.0, 0.3), Pose(-5.0, -3.0, -2.0)
    made = system("paper.failure.single_criterion_failure=false", "paper.failure.monitor=false")
    found = stand(made, here, range(10), 0.3)
    assert found[-1].status is Status.TRACKING
    assert error_m(found[-1], here) < 0.02
    after = stand(made, there, range(10, 30), -2.0)
    statuses = [e.status for e in after]
    assert statuses[:4] == [Status.TRACKING] * 4  # the paper's rule: five cycles in a row
    assert after[-1].status is Status.TRACKING
    assert error_m(after[-1], there) < 0.02


def test_the_second_opinion_lets_a_right_pose_among_clutter_alone() -> None:
    """A sixth of the points on no line at all: the mean distance is suspect in most frames."""
    pose = Pose(2.0, 1.0, 0.3)
    made = system(prior=Prior(pose=pose))
    for k in range(30):
        points = seen_from(pose, k)
        positions = points.positions_m.copy()
        positions[::6] = np.random.default_rng(k).uniform(-4.0, 4.0, positions[::6].shape)
        estimate = made.step(frame(k, replace(points, positions_m=positions), Pose(0.0, 0.0, 0.0), 0.3))
        assert estimate.status is Status.TRACKING
        assert error_m(estimate, pose) < 0.05
    assert estimate.residual_m > 0.12
    assert made.following.failure.failures == 0


def test_a_robot_carried_to_the_twin_of_its_pose_is_found_by_the_compass() -> None:
    """The lines look exactly the same there; nothing but the compass can tell."""
    here = Pose(-5.0, -3.0, -2.0)
    made = system()
    stand(made, here, range(10), -2.0)
    assert (
        stand(made, here.mirrored(), range(10, 25), here.mirrored().heading)[-1].pose.distance_to(here.mirrored())
        < 0.03
    )


def test_a_told_pose_is_tracked_from_the_first_frame() -> None:
    pose = Pose(-5.0, -3.0, -2.0)
    estimate = stand(system(prior=Prior(pose=Pose(-4.9, -3.1, -1.95))), pose, range(1), None)[0]
    assert estimate.status is Status.TRACKING
    assert error_m(estimate, pose) < 0.03


def test_without_a_compass_the_pose_or_its_twin_is_found_and_both_are_named() -> None:
    pose = Pose(-5.0, -3.0, -2.0)
    estimate = stand(system(), pose, range(12), None)[-1]
    assert estimate.status is Status.TRACKING
    named = [estimate.pose, *(rival.pose for rival in estimate.hypotheses)]
    assert min(p.distance_to(pose) for p in named) < 0.03
    assert min(p.distance_to(pose.mirrored()) for p in named) < 0.03


def test_the_own_half_decides_without_a_compass() -> None:
    pose = Pose(-5.0, -3.0, -2.0)
    estimate = stand(system(prior=Prior(own_half=True)), pose, range(12), None)[-1]
    assert error_m(estimate, pose) < 0.03
    assert not any(rival.pose.distance_to(pose.mirrored()) < 0.5 for rival in estimate.hypotheses)


@pytest.mark.parametrize("error_deg", [5.0, -5.0, 20.0, -20.0])
def test_a_compass_that_errs_delays_but_does_not_deceive(error_deg: float) -> None:
    for k, pose in enumerate((Pose(2.0, 1.0, 0.3), Pose(-7.0, 4.0, 2.0), Pose(6.0, -2.0, -1.0))):
        estimate = stand(system(seed=k), pose, range(25), pose.heading + math.radians(error_deg))[-1]
        assert error_m(estimate, pose) < 0.05
        assert abs(wrap_angle(estimate.pose.heading - pose.heading)) < 0.02


def test_particles_alone_as_the_paper_prints_them_follow_too_but_less_exactly() -> None:
    """The paper's comparison: MCL without matching."""
    pose = Pose(2.0, 1.0, 0.3)
    switches = load_settings(NubotParticleSettings, preset=PAPER).paper
    as_printed = [f"paper.particles.{name}={json.dumps(getattr(switches, name))}" for name in switches.model_fields_set]
    estimates = stand(alone(*as_printed), pose, range(40), 0.3)[20:]
    errors = [error_m(e, pose) for e in estimates]
    assert max(errors) < 0.3
    assert np.mean(errors) > 0.02


@pytest.mark.parametrize("sectors", ["none", "50 %", "half"])
def test_particles_alone_follow_a_recording_under_black_sectors(shared_data: Path, sectors: str) -> None:
    errors, estimates, _ = follow(shared_data / "omni_msl_track", sectors, name="nubot-mcl-alone")
    followed = np.array([e.status is Status.TRACKING for e in estimates])
    assert followed[2:].all()
    distance_m = np.hypot(errors[followed, 0], errors[followed, 1])
    assert distance_m.mean() <= 0.015
    assert distance_m.max() <= 0.05
    assert np.abs(errors[followed, 2]).mean() <= 0.005


def test_particles_alone_that_agree_on_a_place_that_does_not_fit_are_not_believed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One cycle of few particles: the heaviest takes all weight, wherever it is."""
    poor = ("particles.particles=20", "paper.particles.refined_clusters=0")
    poor += ("paper.particles.independent_points=null",)
    monkeypatch.setattr(particle_localizer, "CONFIRMATIONS", 1000)
    for seed in range(10):
        pose = Pose(2.0, 1.0, 0.3)
        for estimate in stand(alone(*poor, seed=seed), pose, range(6), 0.3):
            assert estimate.status is not Status.TRACKING or error_m(estimate, pose) < 1.0


def clutter_beside(pose: Pose, index: int) -> LinePoints:
    """A third of the points on things behind the goal, a metre beyond its line."""
    points = seen_from(pose, index, reach_m=4.0)
    rng = np.random.default_rng([index, 1])
    count = len(points) // 2
    net = pose.inverse().transform(np.column_stack((rng.uniform(9.6, 11.0, count), rng.uniform(-2.0, 2.0, count))))
    n = len(points) + len(net)
    positions = np.concatenate((points.positions_m, net))
    return LinePoints(positions, np.tile(np.eye(2) * 0.02**2, (n, 1, 1)), np.ones(n), np.full((n, 2), np.nan))


@either
def test_points_on_a_goal_s_net_start_no_search_at_a_right_pose(make: Make) -> None:
    """The lines fit badly for many frames, but no other place explains the points better."""
    pose = Pose(7.5, 0.0, 0.0)
    made = make(prior=Prior(pose=pose))
    stand(made, pose, range(5), 0.0)
    for k in range(5, 20):
        estimate = made.step(frame(k, clutter_beside(pose, k), Pose(0.0, 0.0, 0.0), 0.0))
        assert error_m(estimate, pose) < 0.15
    assert estimate.residual_m > 0.35
    assert (made.following if isinstance(made, NubotMcl) else made).failure.failures == 0


@either
def test_a_pose_that_is_not_believed_is_published_as_uncertain_as_the_field_is_large(
    make: Make,
) -> None:
    here, there = Pose(2.0, 1.0, 0.3), Pose(-5.0, -3.0, -2.0)
    made = make()
    estimates = stand(made, here, range(8), 0.3)
    estimates += [made.step(frame(k, LinePoints.none(), Pose(0.0, 0.0, 0.0), 0.3)) for k in range(8, 12)]
    estimates += stand(made, there, range(12, 20), -2.0)
    followed = [e.status is Status.TRACKING for e in estimates]
    assert followed[-1]
    assert not all(followed)
    for estimate, tracked in zip(estimates, followed, strict=True):
        deviations = np.sqrt(np.diag(estimate.covariance))
        assert (deviations[:2] < 0.4).all() if tracked else (deviations >= [10.0, 10.0, 3.0]).all()


def test_a_single_particle_follows_once_it_is_certain() -> None:
    pose = Pose(2.0, 1.0, 0.3)
    made = alone("particles.adaptive.enabled=true", "paper.particles.resampling_threshold=1")
    estimates = stand(made, pose, range(20), 0.3)
    assert len(made.particles.particles) == 1
    assert max(error_m(e, pose) for e in estimates[10:]) < 0.1


def test_a_single_particle_that_was_kidnapped_finds_back() -> None:
    """Its spread is that of a bin: there is something to start anew from."""
    here, there = Pose(2.0, 1.0, 0.3), Pose(-5.0, -3.0, -2.0)
    made = alone("particles.adaptive.enabled=true", "paper.particles.resampling_threshold=1")
    before = stand(made, here, range(20), 0.3)[-1]
    assert len(made.particles.particles) == 1
    assert np.sqrt(np.diag(before.covariance)) == pytest.approx([0.144, 0.144, 0.0756], rel=0.01)
    for k in range(20, 23):
        made.step(frame(k, LinePoints.none(), Pose(0.0, 0.0, 0.0), -2.0))
    after = stand(made, there, range(23, 40), -2.0)[-1]
    assert after.status is Status.TRACKING
    assert error_m(after, there) < 0.1


@pytest.mark.parametrize("name", ["omni_msl_track", "omni_msl_kidnap"])
def test_adaptive_numbers_follow_a_recording_down_to_few_particles(shared_data: Path, name: str) -> None:
    sets = ("particles.adaptive.enabled=true",)
    errors, estimates, _ = follow(shared_data / name, "none", *sets, name="nubot-mcl-alone")
    followed = np.array([e.status is Status.TRACKING for e in estimates])
    assert followed.mean() > 0.8
    assert np.hypot(errors[followed, 0], errors[followed, 1]).mean() <= 0.03


def test_particles_that_do_not_converge_start_anew_with_wider_headings(monkeypatch: pytest.MonkeyPatch) -> None:
    made = system("particles.converged_m=1e-6", "max_cycles=4")
    widenings: list[float] = []
    restart = made.particles.restart

    def noted(*arguments: Any, widening: float, **named: Any) -> None:
        widenings.append(widening)
        restart(*arguments, widening=widening, **named)

    monkeypatch.setattr(made.particles, "restart", noted)
    estimates = stand(made, Pose(2.0, 1.0, 0.3), range(12), 0.3)
    assert widenings == [1.0, 2.0, 4.0]
    assert all(estimate.status is Status.SEARCHING for estimate in estimates)


@pytest.mark.parametrize("step_m", [0.0, 0.25, 0.6])
def test_a_poor_calibration_is_believed_after_some_starts_however_fast_the_robot_is(step_m: float) -> None:
    """Points 10 % too far: no pose is accepted, but the particles come to the same one again and again."""
    made, step = system(), Pose(step_m, 0.0, 0.0)
    pose, driven = Pose(-6.0, 2.0, 0.3), Pose(0.0, 0.0, 0.0)
    for k in range(8):
        points = seen_from(pose, k)
        far = replace(points, positions_m=1.1 * points.positions_m)
        estimate = made.step(frame(k, far, driven, pose.heading))
        assert estimate.status is (Status.SEARCHING if k < CONFIRMATIONS else Status.TRACKING)
        assert error_m(estimate, pose) < 0.6
        pose, driven = pose.compose(step), driven.compose(step)


def test_particles_alone_are_not_started_anew_while_they_follow() -> None:
    made = alone("max_cycles=4")
    stand(made, Pose(2.0, 1.0, 0.3), range(12), 0.3)
    assert made.follower.search.starts == 1
    assert made.follower.search.cycles == 12


def test_frames_without_points_keep_the_search_going_and_break_nothing() -> None:
    made = system()
    for k in range(3):
        estimate = made.step(frame(k, LinePoints.none(), Pose(0.0, 0.0, 0.0), 0.3))
        assert estimate.status is Status.SEARCHING
    assert stand(made, Pose(2.0, 1.0, 0.3), range(3, 10), 0.3)[-1].status is Status.TRACKING


def test_the_same_seed_gives_the_same_trajectory() -> None:
    def trajectory(seed: int) -> list[Pose]:
        return [e.pose for e in stand(alone(seed=seed), Pose(2.0, 1.0, 0.3), range(6), 0.3)]

    assert trajectory(3) == trajectory(3)
    assert trajectory(3) != trajectory(4)
