"""What iris-fusion learns of its camera's errors from the lines, and how sure it is of its pose meanwhile."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from touchline.camera import OmniCamera
from touchline.camera.uncertainty import USUAL_TILT_DEG
from touchline.field import open_field
from touchline.geometry import FloatArray, Pose, wrap_angles
from touchline.localization.registration.learned_mirror import LearnedMirror
from touchline.motion.compass import COMPASS_FALSE
from touchline.published.iris_fusion.image_doubt import ImageMirror
from touchline.systems import RobotSetup, open_system
from touchline.types import Estimate, Frame, LinePoints, Observation, Samples, Status
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

FIELD = open_field("indoor-9x6")
TRUE = np.array([0.012, -0.006, 0.0, 0.0, 0.02])


def seen(pose: Pose, errors: FloatArray, rng: np.random.Generator, camera: LearnedMirror | None = None) -> LinePoints:
    """Points on the lines within 5 m of a pose, as a camera with errors sees them, 1 cm of noise."""
    camera = camera or LearnedMirror(FIELD)
    lines = np.concatenate([line[:-1] + 0.5 * np.diff(line, axis=0) for line in FIELD.polylines()])
    ends = [np.linspace(a, b, 12) for line in FIELD.polylines() for a, b in itertools.pairwise(line)]
    ground = pose.inverse().transform(np.concatenate([lines, *ends]))
    ground = ground[np.hypot(*ground.T) < 5.0]
    ground = ground[rng.permutation(len(ground))[:80]]
    raw = ground.copy()
    for _ in range(20):  # what is seen is corrected to the ground
        raw += ground - camera.corrected(raw, errors)
    raw += 0.01 * rng.standard_normal(raw.shape)
    count = len(raw)
    return LinePoints(raw, np.tile(1e-4 * np.eye(2), (count, 1, 1)), np.ones(count), np.zeros((count, 2)))


def test_a_tilted_mirror_and_too_long_ranges_are_learned_within_some_images() -> None:
    rng, camera = np.random.default_rng(3), LearnedMirror(FIELD)
    assert not camera.settled
    for _ in range(30):
        pose = Pose(*rng.uniform((-3.0, -2.0, -3.0), (3.0, 2.0, 3.0)).tolist())
        fit = camera.update(seen(pose, TRUE, rng), Pose(pose.x + 0.05, pose.y - 0.04, pose.heading + 0.02))
        assert fit is not None
    assert camera.settled
    assert camera.mean == pytest.approx(TRUE, abs=0.002)
    assert np.all(np.abs(camera.mean - TRUE) <= 4.0 * np.sqrt(np.diag(camera.covariance)))
    assert Pose(*fit.pose).distance_to(pose) < 0.02
    assert fit.noise == pytest.approx(0.5, abs=0.3)  # 1 cm where the points and the floor say 1.4
    camera.reset()
    assert camera.covariance[0, 0] == pytest.approx((2.0 * math.radians(USUAL_TILT_DEG) / 0.75) ** 2)


def test_a_displaced_mirror_is_learned_next_to_its_tilt_and_without_it_costs_centimetres() -> None:
    """2 px beside the centre, which is 0.4 mm: what is seen of it is not taken for a step of the robot."""
    exact, errors = tour("ideal=true").camera, np.array([0.006, -0.003, 2.0, -1.0, 0.0])
    assert isinstance(exact, OmniCamera)
    camera = replace(exact, stated_uncertainty=None)
    made = LearnedMirror(FIELD, camera), LearnedMirror(FIELD, camera, looked_for=(False, True))
    off_m: list[list[float]] = [[], []]
    for told, off in zip(made, off_m, strict=True):
        rng = np.random.default_rng(3)
        for _ in range(40):
            pose = Pose(*rng.uniform((-3.0, -2.0, -3.0), (3.0, 2.0, 3.0)).tolist())
            fit = told.update(seen(pose, errors, rng, made[0]), pose)
            assert fit is not None
            off.append(Pose(*fit.pose).distance_to(pose))
    assert made[0].mean[2:4] == pytest.approx(errors[2:4], abs=0.5)
    assert not made[1].mean[2:4].any()
    assert np.mean(off_m[0][20:]) < 0.5 * np.mean(off_m[1][20:])


def test_a_head_that_shakes_does_not_move_the_mean_but_is_taken_off_each_image() -> None:
    """0.1 degrees in every image: as a drift of the mean, they left it 0.002 per metre off in each of them."""
    rng, camera = np.random.default_rng(4), LearnedMirror(FIELD)
    image = ImageMirror(camera)
    off: list[list[float]] = [[], []]
    for k in range(60):
        errors = TRUE + np.array([*rng.normal(0.0, 0.004, 2), 0.0, 0.0, 0.0])
        pose = Pose(*rng.uniform((-3.0, -2.0, -3.0), (3.0, 2.0, 3.0)).tolist())
        points = seen(pose, errors, rng)
        if k >= 30:
            off[0].append(float(np.hypot(*(camera.mean - TRUE)[:2])))
            own = image.errors_of(points, pose)
            off[1].append(float(np.hypot(*((camera.correction if own is None else own) - errors)[:2])))
        image.see(points, pose)
        image.learn()
    assert np.mean(off[0]) < 0.0015
    assert np.mean(off[1]) < 0.003
    assert camera.vibration_per_m == pytest.approx(0.004, abs=0.001)


def test_until_the_errors_are_known_the_pose_is_as_unsure_as_they_leave_it() -> None:
    rng, pose = np.random.default_rng(1), Pose(-1.0, 0.7, 0.4)
    points = seen(pose, np.zeros(5), rng)
    at = pose.as_array()
    unknown, known = LearnedMirror(FIELD).fit_to(points, at), LearnedMirror(FIELD, enabled=False).fit_to(points, at)
    assert unknown is not None
    assert known is not None
    assert math.sqrt(np.trace(unknown.covariance[:2, :2])) > 1.5 * math.sqrt(np.trace(known.covariance[:2, :2]))
    learned = [3, 4, 7]  # no displacement is looked for without a camera
    assert np.all(np.diag(unknown.covariance)[learned] > 10.0 * np.diag(known.covariance)[learned])
    assert known.errors == pytest.approx(0.0, abs=1e-5)


def test_a_lone_line_teaches_nothing_of_the_camera() -> None:
    """One that seemed bent moved the mean by 0.01 per metre within 3 s, and the pose by 15 cm."""
    rng, camera = np.random.default_rng(2), LearnedMirror(FIELD)
    image = ImageMirror(camera)
    for _ in range(20):
        x = rng.uniform(-1.8, 1.8, 60)
        points = np.column_stack((x, -2.0 + 0.01 * x * x)) + 0.01 * rng.standard_normal((60, 2))
        seen_line = LinePoints(points, np.tile(1e-4 * np.eye(2), (60, 1, 1)), np.ones(60), np.zeros((60, 2)))
        image.see(seen_line, Pose(2.25, -1.0, 0.0))
        assert image.fit is not None
        assert image.fit.left_m > 0.1
        image.learn()
        assert image.errors_of(seen_line, Pose(2.25, -1.0, 0.0)) is None
    assert not camera.mean.any()
    assert not camera.settled


def test_points_far_from_every_line_teach_nothing_that_is_no_number() -> None:
    count = 30
    far = LinePoints(np.full((count, 2), 1e6), np.tile(np.eye(2), (count, 1, 1)), np.ones(count), np.zeros((count, 2)))
    fit = LearnedMirror(FIELD).fit_to(far, np.zeros(3))
    assert fit is None or np.isfinite(fit.covariance).all()


# --- the system -----------------------------------------------------------------------------------------------------


def driven(frames: list[Frame], run: Simulation) -> tuple[list[Estimate], FloatArray]:
    """The estimates and their errors (N, 3)."""
    system = open_system(
        "iris-fusion", RobotSetup(run.field, None, run.wheel_directions_rad), rng=np.random.default_rng(0)
    )
    estimates = [system.step(frame) for frame in frames]
    errors = np.array([e.pose for e in estimates]) - run.truth.poses[: len(frames)]
    errors[:, 2] = wrap_angles(errors[:, 2])
    return estimates, errors


def tour(*changes: str) -> Simulation:
    return Simulation(open_scenario("tour-20", 2, 12.0, changes), level="points")


def nees(estimates: list[Estimate], errors: FloatArray) -> float:
    """Mean squared error per degree of freedom in the unit of what was expected."""
    pairs = zip(estimates, errors, strict=True)
    return float(np.mean([error @ np.linalg.solve(e.covariance, error) / 3.0 for e, error in pairs]))


def test_a_mirror_tilted_by_half_a_degree_is_tracked_within_centimetres_and_its_doubt_is_honest() -> None:
    run = tour("camera.mirror.tilt_deg=[0.5,0.0]")
    estimates, errors = driven(list(run), run)
    assert np.mean([e.status is Status.TRACKING for e in estimates[30:]]) >= 0.98
    assert np.hypot(*errors[30:, :2].T).mean() <= 0.06
    assert nees(estimates[30:], errors[30:]) <= 4.0


def test_wheels_that_come_back_after_seconds_do_not_drive_the_way_twice() -> None:
    """The images have followed the robot meanwhile."""
    run = tour()
    gone = [replace(f, wheels=None, odometry=None) if 40 <= k < 70 else f for k, f in enumerate(run)]
    estimates, errors = driven(gone, run)
    assert all(e.status is Status.TRACKING for e in estimates[20:])
    assert np.hypot(*errors[20:, :2].T).max() < 0.3


def test_a_compass_that_turns_round_for_some_seconds_does_not_turn_the_robot() -> None:
    run = tour()
    frames = [
        replace(f, compass=Samples(f.compass.stamp_ns, f.compass.values + math.pi))
        if 40 <= k < 90 and f.compass is not None
        else f
        for k, f in enumerate(run)
    ]
    estimates, errors = driven(frames, run)
    assert np.hypot(*errors[20:, :2].T).max() < 0.1
    assert [[twin.probability for twin in e.hypotheses] for e in estimates[50:85]] == [[None]] * 35  # the doubt is told
    assert [twin.probability for twin in estimates[-1].hypotheses] == [COMPASS_FALSE]


@pytest.mark.parametrize("kind", ["uniform", "ring"])
def test_garbage_is_not_tracked(kind: str) -> None:
    run, rng = tour(), np.random.default_rng(0)
    angles = np.linspace(0.0, 2.0 * math.pi, 100, endpoint=False)
    frames = list(run)
    for k in range(20, len(frames)):
        ring = np.column_stack((np.cos(angles), np.sin(angles)))
        xy = rng.uniform(-8.0, 8.0, (100, 2)) if kind == "uniform" else ring
        points = LinePoints(xy, np.tile(1e-4 * np.eye(2), (100, 1, 1)), np.ones(100), np.zeros((100, 2)))
        frames[k] = replace(frames[k], observation=Observation(frames[k].stamp_ns, points))
    estimates, errors = driven(frames, run)
    wrong = np.hypot(*errors[:, :2].T) > 0.5
    assert sum(e.status is Status.TRACKING for e, off in zip(estimates, wrong, strict=True) if off) <= 5
    assert not any(e.status is Status.TRACKING for e in estimates[30:])
