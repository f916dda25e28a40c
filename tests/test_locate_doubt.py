"""One observation: its covariance is honest about the camera, has no cliff, and rivals and open directions are told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from line_scenes import lone_line, view
from model_scans import load_points

from touchline.camera import OmniCamera
from touchline.camera.uncertainty import CameraUncertainty
from touchline.errors import NoFitError
from touchline.field import FieldModel, open_field
from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.localization.one_shot.advice import fit_scale
from touchline.localization.one_shot.certainty import Spread, with_camera
from touchline.localization.one_shot.locate import locate_points
from touchline.localization.one_shot.location import Location
from touchline.localization.registration.learned_mirror import LearnedMirror
from touchline.types import points_at
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

FIELD = open_field("msl-18x12")
SCALE_M, PER_PX = 1.568777, 0.00708754  # of the robot's mirror: r = a tan(b rho)


@pytest.fixture(scope="module")
def measured(small_data: Path) -> FloatArray:
    """Every sixth of a real robot's points."""
    return np.unique(load_points(small_data / "real" / "nubot_robot1.csv"), axis=0)[::6]


@pytest.fixture(scope="module")
def place(measured: FloatArray) -> Pose:
    return locate_points(measured, FIELD).pose


def seen_wrong(points: FloatArray, off_px: tuple[float, float], scale: float) -> FloatArray:
    """Points (N, 2) as a camera sees them whose centre is wrong by (2,) px and whose ranges are by a factor."""
    radius = np.arctan(np.hypot(*points.T) / SCALE_M) / PER_PX
    pixels = points / np.hypot(*points.T)[:, np.newaxis] * radius[:, np.newaxis] - np.array(off_px)
    radius = np.hypot(*pixels.T)
    kept = PER_PX * radius < 1.45
    ranges = scale * SCALE_M * np.tan(PER_PX * radius[kept])
    return np.ascontiguousarray(pixels[kept] / radius[kept][:, np.newaxis] * ranges[:, np.newaxis])


def nees(location: Location, place: Pose) -> float:
    """Squared error of a location in its own standard deviations, per degree of freedom."""
    true = min((place, place.mirrored()), key=location.pose.distance_to)
    found = location.pose
    error = np.array([found.x - true.x, found.y - true.y, wrap_angle(found.heading - true.heading)])
    return float(error @ np.linalg.solve(location.covariance, error)) / 3.0


@pytest.mark.parametrize(
    ("off_px", "scale"),
    [
        ((3.0, 0.0), 1.0),
        ((0.0, 3.0), 1.0),
        ((0.0, -3.0), 1.0),
        ((0.0, 0.0), 1.03),
        ((0.0, 0.0), 0.97),
        ((3.0, 0.0), 1.03),
    ],
)
def test_a_wrong_centre_or_scale_is_within_the_covariance_and_told(
    measured: FloatArray, place: Pose, off_px: tuple[float, float], scale: float
) -> None:
    """Before, these poses, 5 to 35 cm off, were said to be good to 7 mm: 40 to 900 for one here."""
    location = locate_points(seen_wrong(measured, off_px, scale), FIELD)
    assert nees(location, place) < 2.0
    assert any("ranges look" in doubt or "lines look bent" in doubt for doubt in location.doubts)


def test_a_good_calibration_is_not_doubted(measured: FloatArray) -> None:
    location = locate_points(measured, FIELD)
    assert location.doubts == ()
    assert np.sqrt(location.covariance[0, 0]) < 0.05


def test_a_camera_that_is_sure_of_itself_is_believed_unless_the_lines_contradict_it(
    measured: FloatArray, place: Pose
) -> None:
    told, sure = np.diag([1e-4, 1e-4, 1e-6]), Spread(0.002, 0.001)
    usual = with_camera(FIELD, measured, place, told)[0]
    assert np.trace(with_camera(FIELD, measured, place, told, sure)[0][:2, :2]) < 0.5 * np.trace(usual[:2, :2])
    assert np.trace(with_camera(FIELD, measured, place, told, Spread(0.05, 0.03))[0]) > np.trace(usual)
    wrong = np.ascontiguousarray(1.03 * measured)
    np.testing.assert_array_equal(
        with_camera(FIELD, wrong, place, told, sure)[0], with_camera(FIELD, wrong, place, told)[0]
    )


def test_what_a_camera_is_unsure_of_is_as_its_file_states_it() -> None:
    camera = Simulation(open_scenario("straight-tracks", 0, 0.2), "points").camera
    assert isinstance(camera, OmniCamera)
    outer_px = camera.outer_radius_px
    as_usual = replace(camera, stated_uncertainty=CameraUncertainty(0.3, 0.0, 0.03))
    assert Spread.stated_by(as_usual) == Spread.stated_by(None)
    beside = replace(camera, stated_uncertainty=CameraUncertainty(0.0, 0.03 * outer_px, 0.01))
    assert Spread.stated_by(beside) == pytest.approx((0.01, 2.0 * Spread().bend_per_m))
    made = [LearnedMirror(FIELD, given, looked_for=(False, True)) for given in (beside, None)]
    for mirror in made:
        mirror.update(points_at(view(FIELD, Pose(1.0, 0.5, 0.2), np.random.default_rng(1))), Pose(1.0, 0.5, 0.2))
    shift_m = np.sqrt(made[0].misfit[0, 0])
    assert 0.005 * 0.03 * outer_px < shift_m < 0.05 * 0.03 * outer_px  # of 0.5 to 5 cm per pixel
    assert made[1].misfit[0, 0] < 1e-8


def test_four_points_that_fix_a_direction_fix_it_to_decimetres() -> None:
    """Where they may all be clutter the covariance was that of a pose nobody knows: 10 m."""
    rng = np.random.default_rng(0)
    along = np.column_stack((rng.uniform(-2.5, 1.5, 30), np.full(30, 2.0)))
    across = np.column_stack((np.full(4, 1.5), np.array([0.4, 0.8, 1.2, 1.6])))
    cross = FieldModel(
        name="cross", length=12.0, width=9.0, line_width=0.1,
        segments=np.array([[-6.0, 0.0, 6.0, 0.0], [0.0, -4.5, 0.0, 4.5]]),
    )  # fmt: skip
    points = np.vstack((along, across)) + 0.01 * rng.standard_normal((34, 2))
    location = locate_points(points, cross, heading=0.0)
    deviations = np.sqrt(np.linalg.eigvalsh(location.covariance[:2, :2]))
    assert deviations[1] < 1.0


def test_a_lone_line_leaves_its_direction_open() -> None:
    points = np.column_stack((np.linspace(-4.0, 4.0, 60), np.full(60, 2.0)))
    location = locate_points(points, lone_line(), heading=0.0)
    assert np.sqrt(location.covariance[0, 0]) > 3.0
    assert any("do not fix the pose" in doubt for doubt in location.doubts)


@pytest.mark.parametrize("seed", range(3))
def test_one_line_of_a_whole_field_has_many_places_or_a_long_ellipse(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = np.column_stack((rng.uniform(-4.0, 4.0, 60), 2.0 + 0.02 * rng.standard_normal(60)))
    try:
        location = locate_points(points, FIELD)
    except NoFitError:
        return
    assert any("do not tell the place" in doubt or "do not fix the pose" in doubt for doubt in location.doubts)
    assert np.sqrt(np.linalg.eigvalsh(location.covariance[:2, :2])[0]) > 0.03


def test_a_view_of_one_corner_is_right_or_has_rivals_or_is_refused() -> None:
    """Four views of 120°: never a wrong place alone."""
    rng = np.random.default_rng(7)
    for _ in range(4):
        true = Pose(rng.uniform(-8, 8), rng.uniform(-5, 5), rng.uniform(-3, 3))
        points = view(FIELD, true, rng, clutter=0.1, field_of_view_rad=2.0 * np.pi / 3.0, reach_m=5.0)
        try:
            location = locate_points(points, FIELD)
        except NoFitError:
            continue
        assert nees(location, true) < 4.0 or any("do not tell the place" in doubt for doubt in location.doubts)


@pytest.mark.parametrize("factor", [0.9, 1.0, 1.12])
def test_a_scale_is_found_from_one_observation(measured: FloatArray, factor: float) -> None:
    found = fit_scale(measured / factor, FIELD)
    assert found.factor == pytest.approx(factor, abs=3.0 * found.deviation)
    assert found.deviation < 0.005


def test_a_scale_beyond_those_tried_is_refused(measured: FloatArray) -> None:
    with pytest.raises(NoFitError, match=r"no scale between 0\.84 and 1\.18 fits best"):
        fit_scale(measured / 1.3, FIELD)


@pytest.mark.parametrize("seed", range(3))
def test_clutter_is_not_taken_for_the_line_of_another_field(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = view(FIELD, Pose(3.2, -1.4, 0.5), rng, count=300, clutter=0.3)
    assert not any("lie in one row" in doubt for doubt in locate_points(points, FIELD).doubts)


def test_furniture_beyond_the_field_is_left_out() -> None:
    """Nine of a hundred points lie metres beyond the touch line: they say nothing of how well the others fit."""
    field, pose = open_field("msl-18x12"), Pose(1.0, -3.0, 0.4)
    rng = np.random.default_rng(3)
    lines = np.concatenate([line[::4] for line in field.polylines(0.05)])
    lines = lines[np.hypot(*(lines - (pose.x, pose.y)).T) < 6.0]
    furniture = np.column_stack((rng.uniform(-3.0, 4.0, len(lines) // 10), rng.uniform(-8.0, -7.0, len(lines) // 10)))
    points = pose.inverse().transform(np.concatenate((lines, furniture))) + rng.normal(
        0.0, 0.02, (len(lines) + len(furniture), 2)
    )
    found = locate_points(points, field, 0.4)
    assert found.pose.distance_to(pose) < 0.03
    assert found.points == len(lines)
    assert found.mean_distance_m < 0.04
    assert found.doubts == ("9 % of the points lie beyond the outer lines and were left out",)
