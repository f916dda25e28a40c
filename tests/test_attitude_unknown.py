"""Roll and pitch of a perspective camera that are degrees off: learned from the lines."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from conftest import FULL_DATA

from touchline.camera import GroundView, PinholeCamera
from touchline.evaluation.runner import robot_setup
from touchline.field import open_field
from touchline.geometry import Pose, Pose3
from touchline.localization.camera_errors.base import placed_points
from touchline.localization.camera_errors.perspective import PerspectiveResponse, ahead
from touchline.localization.registration.attitudes import attitude_offsets, fit_leaning, likely_attitudes
from touchline.localization.registration.feature_model import LineFeatures
from touchline.localization.registration.joint import StatePrior
from touchline.localization.registration.registration import TRACKING, Registration
from touchline.localization.registration.seen import seen_points
from touchline.motion.lean import LAG_S, LeanFilter
from touchline.sources import open_source
from touchline.systems import RobotSetup, open_system
from touchline.systems.touchline import Touchline
from touchline.types import Frame, LinePoints, Observation, Prior, Samples, Status
from touchline.view.learned_view import seen_through
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

SUN = FULL_DATA / "humanoid_hsl_sun"


def test_a_pan_turns_the_axes_of_roll_and_pitch() -> None:
    """Errors of a camera that has turned its head to the left move what it sees as those of one that looks ahead."""
    eye, errors = np.array([0.0, 0.0, 0.6]), np.array([0.03, -0.05, 0.01, 0.02])
    points = np.array([[2.0, 0.5], [3.0, -1.0], [1.0, 0.2]])
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    here = PerspectiveResponse(eye, np.array([math.cos(0.3), 0.0, -math.sin(0.3)]), fisheye=False)
    aside = PerspectiveResponse(eye, np.array([0.0, math.cos(0.3), -math.sin(0.3)]), fisheye=False)
    np.testing.assert_allclose(
        placed_points(points @ turn.T, errors, aside), placed_points(points, errors, here) @ turn.T, atol=1e-12
    )
    assert ahead(np.zeros(3)) == (1.0, 0.0)


def test_the_pose_of_the_camera_is_turned_on_by_the_rates() -> None:
    """Kinematics hold the lean that the IMU has told late."""
    stamps = np.arange(0, 200_000_001, 20_000_000)
    gyro = Samples(stamps, np.tile([0.0, 0.5, 0.0], (len(stamps), 1)))
    frame = Frame(200_000_000, gyro=gyro, base_from_camera=Pose3.from_roll_pitch_yaw(0.0, 0.3, 0.0, (0.0, 0.0, 0.5)))
    turned = LeanFilter().at_image(frame).base_from_camera
    assert turned is not None
    assert turned.roll_pitch_yaw()[1] == pytest.approx(0.3 + 0.5 * LAG_S, abs=1e-6)


def test_a_grid_of_attitudes_begins_at_the_expected_one_and_is_fine_enough() -> None:
    offsets = attitude_offsets(np.array([0.05, 0.005]))
    assert not offsets[0].any()
    assert np.diff(np.unique(offsets[:, 0])).max() <= 0.025 + 1e-12
    assert offsets[:, 0].max() == pytest.approx(0.075)


@pytest.mark.parametrize("pitch_deg", [4.0, -4.0])
def test_a_fit_begins_at_other_attitudes_where_the_expected_one_explains_too_little(pitch_deg: float) -> None:
    """Four degrees of pitch of a camera half a metre up: lines lie metres off."""
    field, truth = open_field("hsl-s-9x6"), Pose(0.5, 0.6, 0.4)
    response = PerspectiveResponse(np.array([0.0, 0.0, 0.5]), np.array([0.95, 0.0, -0.3]), fisheye=False)
    errors = np.array([0.0, math.radians(pitch_deg), 0.0, 0.0])
    steps = np.linspace(0.0, 1.0, 60)[:, np.newaxis]
    lines = np.concatenate([one[:2] + steps * (one[2:] - one[:2]) for one in np.asarray(field.segments)[:, :4]])
    points = truth.inverse().transform(lines)
    ahead_m = np.hypot(points[:, 0], points[:, 1])
    points = points[(np.abs(np.arctan2(points[:, 1], points[:, 0])) < 0.7) & (ahead_m < 4.5)]
    shown = placed_points(np.ascontiguousarray(points), -errors, response)
    spread = np.tile(0.02**2 * np.eye(2), (len(shown), 1, 1))
    seen = seen_points(LinePoints(shown, spread, np.ones(len(shown)), np.full_like(shown, np.nan)), 0.25)
    deviations = np.array([0.2, 0.2, 0.1, 0.05, 0.05, 0.005, 0.005])
    expected = StatePrior(np.array([*truth, 0.0, 0.0, 0.0, 0.0]), np.diag(deviations**-2.0))
    registration = Registration(field.distance_map())
    fit = fit_leaning(registration, seen, expected.mean, expected, TRACKING, response)
    assert registration.fit_state(seen, expected.mean, expected, TRACKING, response).explained < 0.85
    assert fit.explained > 0.95
    assert math.degrees(fit.state[4]) == pytest.approx(pitch_deg, abs=0.1)
    np.testing.assert_allclose(fit.state[:2], truth.as_array()[:2], atol=0.1)


@pytest.mark.parametrize(("sigma_rad", "tried"), [(0.014, 1), (0.05, 81)])
def test_no_other_attitude_is_tried_where_it_is_known(
    monkeypatch: pytest.MonkeyPatch, sigma_rad: float, tried: int
) -> None:
    """Of scatter, which no attitude explains."""
    places = np.random.default_rng(0).uniform(1.0, 4.0, (40, 2))
    points = LinePoints(places, np.tile(1e-4 * np.eye(2), (40, 1, 1)), np.ones(40), np.full((40, 2), np.nan))
    deviations = np.array([0.2, 0.2, 0.1, sigma_rad, sigma_rad, 0.005, 0.005])
    expected = StatePrior(np.zeros(7), np.diag(deviations**-2.0))
    response = PerspectiveResponse(np.array([0.0, 0.0, 0.5]), np.array([0.95, 0.0, -0.3]), fisheye=False)
    registration, starts, fit = Registration(open_field("hsl-s-9x6").distance_map()), [], Registration.fit_state
    monkeypatch.setattr(
        Registration,
        "fit_state",
        lambda self, seen, start, *rest: (starts.append(start), fit(self, seen, start, *rest))[1],
    )
    found = fit_leaning(registration, seen_points(points, 0.25), expected.mean, expected, TRACKING, response)
    assert found.explained < 0.85
    assert len(starts) == tried


@pytest.mark.parametrize("stray_rad", [0.4, 0.8, 1.2])
def test_an_arc_among_the_lines_does_not_turn_the_camera(stray_rad: float) -> None:
    """Two lines and a crossing one tell the attitude to a degree, whatever direction a fourth has that is none."""
    errors = np.radians([1.5, -3.0, 0.0, 0.0])
    response = PerspectiveResponse(np.array([0.0, 0.0, 0.5]), np.array([0.95, 0.0, -0.3]), fisheye=False)
    ends = np.array([[[1.5, -1.0], [1.5, 1.0]], [[1.2, -0.8], [4.0, -0.8]], [[1.0, 0.9], [3.5, 0.9]]])
    stray = np.array([2.0, 0.0]) + np.outer([-0.4, 0.4], [math.cos(stray_rad), math.sin(stray_rad)])
    turned = Pose(0.0, 0.0, 0.3).transform(np.concatenate((ends, stray[np.newaxis])).reshape(-1, 2))
    shown, sigmas, ones = placed_points(turned, -errors, response), np.full((4, 2), 0.04), np.ones(4)
    lines = LineFeatures(shown.reshape(-1, 2, 2), sigmas, sigmas, ones, ones, ones)
    deviations = np.array([9.0, 9.0, 9.0, 0.05, 0.05, 0.005, 0.005])
    expected = StatePrior(np.zeros(7), np.diag(deviations**-2.0))
    likely = np.array(likely_attitudes(lines, expected, response, 3))
    assert np.degrees(np.abs(likely[:, :2] - errors[:2]).max(axis=1).min()) < 1.0


def test_a_given_pose_between_two_places_that_fit_as_well_is_not_tracked() -> None:
    """One line ahead may be either of two; which one a second image of more lines tells."""
    mount = Pose3.from_roll_pitch_yaw(0.0, 0.3, 0.0, (0.0, 0.0, 0.5))
    camera = PinholeCamera(752, 480, 493.0, 493.0, 376.0, 240.0, np.zeros(5), mount)
    field, truth = open_field("hsl-s-9x6"), Pose(1.525, 0.0, 0.0)
    system = open_system("touchline", RobotSetup(field, camera))
    assert isinstance(system, Touchline)
    ahead_m = np.column_stack((np.full(60, 1.0), np.linspace(-1.2, 1.2, 60)))
    spread = np.tile(0.02**2 * np.eye(2), (len(ahead_m), 1, 1))
    points = LinePoints(ahead_m, spread, np.ones(len(ahead_m)), np.full_like(ahead_m, np.nan))
    system.reset(Prior(Pose(truth.x + 0.5, 0.0, 0.0)))
    estimate = system.step(Frame(0, observation=Observation(0, points)))
    places = sorted(one.filter.pose.x for one in system.bank.members)
    np.testing.assert_allclose(places, [truth.x, truth.x + 1.0], atol=0.3)
    assert estimate.status is not Status.TRACKING


@pytest.mark.parametrize("off_deg", [(1.5, 3.5), (-1.0, -3.0)])
def test_a_still_of_a_robot_with_kinematics_degrees_off_gives_no_wrong_pose(off_deg: tuple[float, float]) -> None:
    """Six places of one robot each, from nothing: most are found, either end being right; none is wrong and sure."""
    scenario = open_scenario("humanoid-walk", 31, 60.0, ("camera.rate_hz=0.1", "field=hsl-s-9x6"))
    run, found = Simulation(scenario, "points"), 0
    camera = run.camera
    assert isinstance(camera, PinholeCamera)
    told = Pose3.from_roll_pitch_yaw(*np.radians(off_deg).tolist(), 0.0).rotation @ camera.base_from_camera.rotation
    wrong = Pose3(told, camera.base_from_camera.translation_m)
    for index in range(len(run)):
        whole = replace(run.features(index), points=run.points(index))
        seen = seen_through(whole, GroundView(camera), GroundView(camera, wrong)).usable(8.0)
        system = open_system("touchline", RobotSetup(run.field, camera))
        system.reset()
        estimate, truth = system.step(Frame(0, observation=seen, base_from_camera=wrong)), run.truth[index]
        off_m = min(estimate.pose.distance_to(end) for end in (truth, truth.mirrored()))
        assert estimate.status is not Status.TRACKING or off_m < 0.3
        found += estimate.status is Status.TRACKING
    assert found >= 4


if SUN.is_dir():

    def test_a_robot_with_kinematics_degrees_off_is_followed() -> None:
        """Low sun in patches; whenever it is tracked it is right, and it learns the camera's pitch. From one start or
        another the first images are too few, whatever rounds the colours.
        """
        starts, tracked, images = ((0.2, -0.2, 6.0), (-0.25, 0.1, -8.0), (0.1, 0.3, -5.0), (-0.15, -0.25, 7.0)), 0, 0
        for x, y, turned in starts:
            source = open_source(SUN)
            assert source.truth is not None
            system = open_system("touchline", robot_setup(source))
            assert isinstance(system, Touchline)
            first = source.truth.nearest(int(source.image_stamps[0]))
            system.reset(Prior(Pose(first.x + x, first.y + y, first.heading + math.radians(turned))))
            off_m = []
            for frame in source:
                estimate, truth = system.step(frame), source.truth.nearest(frame.stamp_ns)
                tracked, images = tracked + (estimate.status is Status.TRACKING), images + 1
                assert system.bank.best is not None
                off_m.append(system.bank.best.filter.pose.distance_to(truth))
            assert np.median(off_m) < 0.04
            assert max(off_m[8:]) < 0.15
            assert math.degrees(system.bank.best.filter.errors[1]) == pytest.approx(-2.2, abs=0.5)
        assert tracked >= 0.97 * images
