"""iris-fusion on the public recordings, in simulated drives, and on what may go wrong."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from touchline.config import load_settings
from touchline.field import open_field
from touchline.geometry import FloatArray, Pose, wrap_angle, wrap_angles
from touchline.motion import DeadReckoning, MotionHistory
from touchline.motion.compass import COMPASS_FALSE
from touchline.published.iris_fusion.system import IrisFusion, IrisFusionSettings
from touchline.sources import open_source
from touchline.systems import RobotSetup, open_system
from touchline.types import (
    Estimate,
    Frame,
    LinePoints,
    Mode,
    Observation,
    Prior,
    Samples,
    Status,
    points_at,
)
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import MotionSettings, open_scenario

PAPER = (
    "paper.particles.max_units=255", "paper.particles.tempering_threshold=0", "paper.particles.roughening=0",
    "paper.particles.nearby_ratio=0", "paper.fusion.beta_period_s=null", "paper.fusion.bias_gain_per_s=0",
    "paper.fusion.camera_errors=false", "paper.fusion.displacement=false", "paper.restart.heading_rad=null",
    "paper.restart.image_cycles=1", "paper.restart.lone_line=true",
)  # fmt: skip


@cache
def simulation(field: str, seed: int) -> Simulation:
    """A robot that visits places on a field for 10 s, the camera seen as line points."""
    chosen = open_scenario("tour-20", seed, 10.0, ["ideal=true"])
    return Simulation(chosen.model_copy(update={"field": field}), level="points")


def system(run: Simulation, *sets: str, prior: Prior | None = None, seed: int = 0, wheels: bool = True) -> IrisFusion:
    settings = load_settings(IrisFusionSettings, None, sets)
    directions = run.wheel_directions_rad if wheels else None
    made = open_system("iris-fusion", RobotSetup(run.field, None, directions), settings, np.random.default_rng(seed))
    assert isinstance(made, IrisFusion)
    made.reset(prior)
    return made


def off_m(estimate: Estimate, pose: Pose) -> float:
    return estimate.pose.distance_to(pose)


def truth(run: Simulation, index: int) -> Pose:
    return Pose(*(float(value) for value in run.truth.poses[index]))


# --- images ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["omni_msl_track", "omni_msl_match", "omni_msl_sun", "omni_9x6_points"])
def test_every_recording_is_followed_from_the_fifth_image_on(shared_data: Path, name: str) -> None:
    estimates, errors = recorded(shared_data / name)
    assert all(e.status is Status.TRACKING for e in estimates[5:])
    position_m = np.hypot(errors[5:, 0], errors[5:, 1])
    assert position_m.mean() <= 0.02
    assert position_m.max() <= (0.3 if name == "omni_msl_match" else 0.05)  # there it is shoved by up to 0.3 m
    assert np.degrees(np.abs(errors[5:, 2])).mean() <= 0.4


def test_a_robot_carried_away_under_a_covered_camera_is_right_within_5_images(shared_data: Path) -> None:
    estimates, errors = recorded(shared_data / "omni_msl_kidnap")
    black = np.array([e.points == 0 for e in estimates])
    returns = np.flatnonzero(black[:-1] & ~black[1:]) + 1
    assert len(returns) == 2
    for first in returns:
        assert estimates[first].status is Status.LOST
        assert np.hypot(errors[first + 5 : first + 16, 0], errors[first + 5 : first + 16, 1]).max() <= 0.1
        assert all(e.status is Status.TRACKING for e in estimates[first + 5 : first + 16])
    assert all(e.mode is Mode.ODOMETRY for e, hidden in zip(estimates, black, strict=True) if hidden)
    gone = [k for k, e in enumerate(estimates) if e.status is not Status.TRACKING]
    assert max(np.hypot(*errors[gone, :2].T)) > 3.0  # the prediction knows nothing of the abduction, and says so
    for k in gone:
        deviations = np.sqrt(np.diag(estimates[k].covariance))
        assert np.all(np.abs(errors[k]) <= 3.0 * deviations)


def recorded(folder: Path) -> tuple[list[Estimate], FloatArray]:
    source = open_source(folder)
    made = open_system("iris-fusion", RobotSetup(source.field, source.camera, source.wheel_directions_rad))
    estimates = [made.step(frame) for frame in source]
    assert source.truth is not None
    errors = np.array([e.pose for e in estimates]) - source.truth.samples().values
    errors[:, 2] = wrap_angles(errors[:, 2])
    return estimates, errors


# --- line points ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("field", ["indoor-9x6", "msl-18x12"])
def test_the_fused_pose_is_within_centimetres_and_an_undisturbed_robot_is_never_lost(field: str) -> None:
    for seed in range(3):
        run = simulation(field, seed)
        made = system(run)
        estimates = [made.step(frame) for frame in run]
        assert Status.LOST not in {e.status for e in estimates}
        assert all(e.status is Status.TRACKING for e in estimates[20:])  # a search may have to start anew
        assert max(off_m(e, truth(run, k)) for k, e in enumerate(estimates) if e.status is Status.TRACKING) < 0.1
        assert {e.mode for e in estimates[25:]} == {Mode.BOTH}


def test_the_paper_s_own_form_can_be_chosen_and_follows_a_robot_whose_place_was_told() -> None:
    run = simulation("indoor-9x6", 1)
    made = system(run, *PAPER, prior=Prior(pose=truth(run, 0)))
    estimates = [made.step(frame) for frame in run]
    assert made.particles.filter.exponent == 1.0
    assert max(off_m(e, truth(run, k)) for k, e in enumerate(estimates)) < 0.3


def test_without_measuring_wheels_the_odometry_of_the_driven_ones_serves() -> None:
    run = simulation("indoor-9x6", 2)
    made = system(run, wheels=False)
    estimates = [made.step(replace(frame, wheels=None)) for frame in run]
    assert all(e.status is Status.TRACKING for e in estimates[20:])
    assert max(off_m(e, truth(run, k)) for k, e in enumerate(estimates) if k >= 20) < 0.1


NO_MOTION: dict[str, Samples | None] = {"wheels": None, "odometry": None, "gyro": None}


@pytest.mark.parametrize("field", ["indoor-9x6", "msl-18x12"])
def test_without_any_odometry_omnivision_goes_on_alone(field: str) -> None:
    for seed in range(2):
        run = simulation(field, seed)
        made = system(run)
        estimates = [made.step(replace(frame, **NO_MOTION)) for frame in run]
        assert all(e.status is Status.TRACKING for e in estimates[10:])
        assert {e.mode for e in estimates[10:]} == {Mode.OMNIVISION}
        assert max(off_m(e, truth(run, k)) for k, e in enumerate(estimates) if k >= 10) < 0.1


def twin(estimate: Estimate) -> float | None:
    """Probability of the one hypothesis, the pose at the other end."""
    (other,) = estimate.hypotheses
    assert other.pose == estimate.pose.mirrored()
    return other.probability


def test_without_a_compass_both_ends_of_the_field_are_named() -> None:
    for seed in range(3):
        run = simulation("indoor-9x6", seed)
        made = system(run, seed=seed)
        last = [made.step(replace(frame, compass=None)) for frame in run][-1]
        here = truth(run, len(run) - 1)
        assert last.status is Status.TRACKING
        assert len(last.hypotheses) == 1
        assert last.hypotheses[0].pose == last.pose.mirrored()
        assert min(off_m(last, here), last.hypotheses[0].pose.distance_to(here)) < 0.05


def test_a_compass_that_is_heard_late_tells_which_end_it_is() -> None:
    mirrored = []
    for seed in range(4):
        run = simulation("indoor-9x6", seed)
        made = system(run, seed=seed)
        estimates = [made.step(replace(frame, compass=None) if k < 50 else frame) for k, frame in enumerate(run)]
        mirrored.append(off_m(estimates[49], truth(run, 49)) > 0.5)
        assert all(len(e.hypotheses) == 1 for e in estimates[10:50])
        assert all(
            twin(e) == COMPASS_FALSE and off_m(e, truth(run, k)) < 0.05 for k, e in enumerate(estimates) if k >= 65
        )
    assert {True, False} == set(mirrored)


@pytest.mark.parametrize("field", ["indoor-9x6", "msl-18x12"])
def test_a_robot_that_is_lost_without_a_compass_keeps_the_heading_that_was_known(field: str) -> None:
    """For 2.5 s it neither sees nor feels anything; then it is found at its own end of the field, not at the twin."""
    for seed in range(3):
        run = simulation(field, seed)
        made = system(run, seed=seed)
        for k, frame in enumerate(run):
            frame = frame if k < 30 else replace(frame, compass=None)
            hidden = 35 <= k < 60
            unseen = replace(frame, observation=Observation(frame.stamp_ns), **NO_MOTION)
            estimate = made.step(unseen if hidden else frame)
            if k == 59:
                assert estimate.status is Status.LOST
                assert math.sqrt(np.trace(estimate.covariance[:2, :2])) > 0.6
            if k >= 70:
                assert estimate.status is Status.TRACKING
                assert off_m(estimate, truth(run, k)) < 0.05


def test_the_own_half_decides_without_a_compass() -> None:
    run = next(r for r in (simulation("indoor-9x6", seed) for seed in range(3)) if truth(r, 0).x < -0.3)
    made = system(run, prior=Prior(own_half=True))
    last = [made.step(replace(frame, compass=None)) for frame in run][-1]
    assert off_m(last, truth(run, len(run) - 1)) < 0.05
    assert last.hypotheses == ()


@pytest.mark.parametrize("field", ["indoor-9x6", "msl-18x12"])
def test_particles_of_a_robot_in_its_own_half_never_wander_to_the_other_before_it_is_found(field: str) -> None:
    """Near the centre line, without compass and odometry: three images of nothing, two seconds in the dark."""
    chosen, here = open_scenario("tour-20", 1, 4.0, ["ideal=true"]), Pose(-0.3, 1.0, math.radians(30.0))
    motion = MotionSettings(kind="stand", pose=(here.x, here.y, 30.0))
    run = Simulation(chosen.model_copy(update={"motion": motion, "field": field}), level="points")
    frames = [replace(frame, compass=None, **NO_MOTION) for frame in run]
    for seed in range(6):
        made, rng = system(run, prior=Prior(own_half=True), seed=seed), np.random.default_rng(seed)
        estimates = []
        for k, frame in enumerate(frames):
            assert frame.observation is not None
            points = frame.observation.points
            points = strewn(points, rng) if k < 3 else LinePoints.none() if k < 23 else points
            estimates.append(made.step(replace(frame, observation=Observation(frame.stamp_ns, points))))
        assert all(e.status is Status.TRACKING for e in estimates[33:])
        assert all(off_m(e, here) < 0.1 for e in estimates if e.status is Status.TRACKING)


def test_a_robot_told_to_be_in_its_own_half_may_leave_it_while_it_is_searched_for() -> None:
    """What was told is about the start: it drives over the centre line unseen, felt by its wheels and gyro."""
    chosen = open_scenario("tour-20", 1, 4.0, ["ideal=true"])
    way = {"kind": "waypoints", "waypoints": ((-1.0, 0.5, 20.0), (2.0, 1.0, 60.0)), "dwell_s": 0.0, "speed_m_s": 1.2}
    run = Simulation(chosen.model_copy(update={"motion": MotionSettings.model_validate(way)}), level="points")
    assert truth(run, 25).x > 0.5
    made = system(run, prior=Prior(own_half=True))
    for k, frame in enumerate(run):
        hidden = replace(frame, compass=None, observation=Observation(frame.stamp_ns) if k < 25 else frame.observation)
        estimate = made.step(hidden)
    assert estimate.status is Status.TRACKING
    assert estimate.hypotheses == ()
    assert off_m(estimate, truth(run, len(run) - 1)) < 0.05


@pytest.mark.parametrize("what", ["odometry", "nothing"])
def test_the_gyro_s_bias_is_taken_off_what_the_gyro_told_and_nothing_else(what: str) -> None:
    """While the gyro is silent the odometry takes its place, or nothing does."""
    run = simulation("indoor-9x6", 2)
    made = system(run, prior=Prior(pose=truth(run, 0)))
    made.fusion.bias_rad_s = math.radians(2.0)
    s = made.settings
    history = MotionHistory(s.odometry, s.compass_track, s.gyro, s.wheels, run.wheel_directions_rad)
    plain = DeadReckoning(history)
    turns = {"felt": 0.0, "silent": 0.0}
    for k, frame in enumerate(run):
        silent = k >= 50
        frame = replace(frame, observation=None, gyro=None if silent else frame.gyro)
        frame = frame if what == "odometry" else replace(frame, odometry=None)
        before, reckoned = made.odometry.pose, plain.pose
        made.step(frame)
        history.add(frame)
        plain.advance(frame.stamp_ns)
        ours, theirs = (b.inverse().compose(o.pose) for b, o in ((before, made.odometry), (reckoned, plain)))
        if 0 < k < 50 or k > 55:
            turns["silent" if silent else "felt"] += wrap_angle(theirs.heading - ours.heading)
    assert math.degrees(turns["felt"]) == pytest.approx(2.0 * 4.9, abs=0.01)
    assert turns["silent"] == pytest.approx(0.0, abs=1e-9)


def test_with_a_compass_alone_the_twin_is_as_likely_as_a_compass_that_was_false_from_the_start() -> None:
    run = simulation("indoor-9x6", 0)
    made = system(run)
    assert {twin(made.step(frame)) for frame in run} == {COMPASS_FALSE}
    made = system(run, prior=Prior(pose=truth(run, 0)))
    assert all(made.step(frame).hypotheses == () for frame in run)


def test_a_robot_told_the_wrong_end_of_the_field_is_put_right_by_the_compass_and_stays_there_without() -> None:
    run = simulation("indoor-9x6", 2)
    here = truth(run, len(run) - 1)
    for sets, right in (((), here), (("paper.restart.heading_rad=null",), here.mirrored())):
        made = system(run, *sets, prior=Prior(pose=truth(run, 0).mirrored()))
        assert off_m([made.step(frame) for frame in run][-1], right) < 0.05


@pytest.mark.parametrize("covered", [0, 3])
def test_kidnapped_robots_are_right_within_a_second_of_being_seen(covered: int) -> None:
    """In full view the images have to contradict the particles for some time first."""
    right = total = 0
    for seed in range(2):
        scenario = open_scenario("kidnap", seed, 26.0, ["ideal=true"])
        disturbances = scenario.disturbances.model_copy(update={"kidnap_every_s": 4.0, "covered_images": covered})
        run = Simulation(scenario.model_copy(update={"disturbances": disturbances}), level="points")
        made = system(run, seed=seed)
        estimates = [made.step(frame) for frame in run]
        for event in (e for e in run.events if e["kind"] == "kidnap"):
            seen = int(np.searchsorted(run.image_stamps / 1e9, event["t"]))
            if seen + 20 < len(estimates):
                total += 1
                later = range(seen + (8 if covered else 14), seen + 20)
                right += all(off_m(estimates[k], truth(run, k)) < 0.15 for k in later)
    assert total >= 8
    assert right >= 0.9 * total


def moved(points: LinePoints, pose: Pose) -> LinePoints:
    return replace(points, positions_m=pose.transform(points.positions_m))


def strewn(points: LinePoints, rng: np.random.Generator) -> LinePoints:
    return replace(points, positions_m=rng.uniform(-5.0, 5.0, points.positions_m.shape))


@pytest.mark.parametrize("field", ["indoor-9x6", "msl-18x12"])
@pytest.mark.parametrize("what", ["shifted", "turned", "strewn", "clutter"])
def test_a_bad_image_never_pulls_the_pose(field: str, what: str) -> None:
    run = simulation(field, 1)
    made, rng = system(run, "paper.monitor=false"), np.random.default_rng(0)
    errors_m = []
    for k, frame in enumerate(run):
        assert frame.observation is not None
        points = frame.observation.points
        if k > 20 and k % 10 == 0:
            if what == "shifted":
                points = moved(points, Pose(0.4, 0.3, 0.0))
            elif what == "turned":
                points = moved(points, Pose(0.0, 0.0, math.radians(12.0)))
            elif what == "strewn":
                points = strewn(points, rng)
            else:
                positions_m = points.positions_m.copy()
                wrong = rng.random(len(points)) < 0.5
                positions_m[wrong] = rng.uniform(-5.0, 5.0, (int(wrong.sum()), 2))
                points = replace(points, positions_m=positions_m)
        estimate = made.step(replace(frame, observation=Observation(frame.stamp_ns, points)))
        if k > 20:
            assert estimate.status is Status.TRACKING
            errors_m.append(off_m(estimate, truth(run, k)))
    assert max(errors_m) < 0.05


def followed_along_a_false_line(*sets: str) -> list[Estimate]:
    """A robot that sees nothing but a straight line of 6 m, which is none of the field's."""
    run = simulation("indoor-9x6", 3)
    made, rng, told = system(run, *sets), np.random.default_rng(0), []
    at = np.column_stack((np.linspace(-3.0, 3.0, 60), np.full(60, 1.5)))
    for frame in itertools.islice(run, 90):
        assert frame.observation is not None
        line = points_at(at + 0.01 * rng.standard_normal((60, 2)))
        told.append(made.step(replace(frame, observation=Observation(frame.stamp_ns, line))))
    return told


def test_a_lone_line_finds_nobody_who_is_searched_for() -> None:
    assert not any(one.status is Status.TRACKING for one in followed_along_a_false_line())
    assert any(one.status is Status.TRACKING for one in followed_along_a_false_line("paper.restart.lone_line=true"))


def test_the_same_seed_gives_the_same_trajectory_and_another_seed_another() -> None:
    run = simulation("indoor-9x6", 0)

    def poses(seed: int) -> list[Pose]:
        made = system(run, seed=seed)
        return [made.step(run.frame(k)).pose for k in range(20)]

    assert poses(3) == poses(3)
    assert poses(3) != poses(4)


@pytest.mark.parametrize("prior", [None, Prior(own_half=True), Prior(pose=Pose(1.0, 0.5, 2.0))])
def test_a_reset_forgets_everything(prior: Prior | None) -> None:
    """After another drive, which ends searching, the same chance gives the same estimates as at first."""
    run, other = simulation("indoor-9x6", 0), simulation("indoor-9x6", 1)
    made = system(run)
    state = made.rng.bit_generator.state

    def told() -> list[tuple[object, ...]]:
        made.rng.bit_generator.state = state
        made.reset(prior)
        estimates = [made.step(frame) for frame in run]
        return [(e.pose, e.covariance.tolist(), e.status, e.mode, e.hypotheses, e.residual_m) for e in estimates]

    at_first, rng = told(), np.random.default_rng(0)
    made.reset()
    for k, frame in enumerate(other):
        assert frame.observation is not None
        seen = strewn(frame.observation.points, rng) if k > 60 else frame.observation.points
        last = made.step(replace(frame, compass=None, observation=Observation(frame.stamp_ns, seen)))
    assert last.status is Status.SEARCHING
    assert str(told()) == str(at_first)  # as text, since a residual may be NaN


def test_frames_without_anything_break_nothing() -> None:
    made = open_system("iris-fusion", RobotSetup(open_field("indoor-9x6")))
    statuses = [made.step(Frame(k * 100_000_000)).status for k in range(30)]
    assert set(statuses) == {Status.SEARCHING}
