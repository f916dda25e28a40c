"""One observation: its covariance is honest about the camera, has no cliff, and rivals and open directions are told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from line_scenes import lone_line
from model_scans import load_points

from touchline.errors import NoFitError
from touchline.field import open_field
from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.localization.one_shot.advice import fit_scale
from touchline.localization.one_shot.locate import locate_points
from touchline.localization.one_shot.location import Location

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


def test_a_lone_line_leaves_its_direction_open() -> None:
    points = np.column_stack((np.linspace(-4.0, 4.0, 60), np.full(60, 2.0)))
    location = locate_points(points, lone_line(), heading=0.0)
    assert np.sqrt(location.covariance[0, 0]) > 3.0
    assert any("do not fix the pose" in doubt for doubt in location.doubts)


@pytest.mark.parametrize("factor", [0.9, 1.0, 1.12])
def test_a_scale_is_found_from_one_observation(measured: FloatArray, factor: float) -> None:
    found = fit_scale(measured / factor, FIELD)
    assert found.factor == pytest.approx(factor, abs=3.0 * found.deviation)
    assert found.deviation < 0.005


def test_a_scale_beyond_those_tried_is_refused(measured: FloatArray) -> None:
    with pytest.raises(NoFitError, match=r"no scale between 0\.84 and 1\.18 fits best"):
        fit_scale(measured / 1.3, FIELD)


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
