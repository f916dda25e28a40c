"""One observation alone: the pose, its rivals and its doubt, and the refusal of what fits nowhere."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path

import numpy as np
import pytest
from line_scenes import lone_line, view
from rich.console import Console

import touchline
from touchline.errors import InputError, NoFitError
from touchline.field import open_field
from touchline.field.drawing import draw_field, field_view
from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.localization.one_shot.advice import fit_scale
from touchline.localization.one_shot.locate import (
    LocateSettings,
    locate_points,
)
from touchline.localization.one_shot.location import Location
from touchline.localization.one_shot.points_file import read_points
from touchline.localization.one_shot.thinning import sampled, thinned, thinned_to
from touchline.localization.search.coarse_search import CoarseSearch
from touchline.localization.search.pose_grid import PoseGrid
from touchline.published.nubot.kernels import grid_errors

FIELD = open_field("msl-18x12")
TRUTH = Pose(3.2, -1.4, 0.5)


def seen_from(pose: Pose, seed: int = 0, count: int = 100, clutter: float = 0.1) -> FloatArray:
    return view(FIELD, pose, np.random.default_rng(seed), count=count, clutter=clutter)


def apart(one: Pose, other: Pose) -> tuple[float, float]:
    return one.distance_to(other), abs(wrap_angle(one.heading - other.heading))


def is_near(pose: Pose, other: Pose) -> bool:
    distance_m, turn_rad = apart(pose, other)
    return distance_m < 0.1 and turn_rad < 0.03


def is_at(location: Location, pose: Pose) -> bool:
    return is_near(location.pose, pose)


@pytest.fixture(scope="module")
def located() -> Location:
    return locate_points(seen_from(TRUTH), FIELD)


def test_without_a_heading_the_pose_and_its_twin_are_found(located: Location) -> None:
    poses = [located.pose, *(rival.pose for rival in located.hypotheses)]
    for expected in (TRUTH, TRUTH.mirrored()):
        assert any(apart(pose, expected)[0] < 0.1 and apart(pose, expected)[1] < 0.03 for pose in poses)
    assert located.hypotheses[0].residual_m == pytest.approx(located.mean_distance_m, rel=0.05)


def test_the_figures_are_those_of_the_points(located: Location) -> None:
    distances = FIELD.line_distances(located.pose.transform(seen_from(TRUTH)))
    assert located.points == 100
    assert located.mean_distance_m == pytest.approx(distances.mean())
    assert located.median_distance_m == pytest.approx(np.median(distances))
    assert np.sqrt(located.covariance[0, 0]) < 0.05
    assert located.chance.significance > 5


@pytest.mark.parametrize("truth", [TRUTH, TRUTH.mirrored()])
def test_a_heading_leaves_one_of_the_twins(truth: Pose) -> None:
    location = locate_points(seen_from(TRUTH), FIELD, heading=wrap_angle(truth.heading + 0.1))
    assert is_at(location, truth)
    assert location.hypotheses == ()


def test_an_answer_is_a_tree_a_table_and_a_picture(located: Location) -> None:
    tree = json.loads(json.dumps(located.to_dict()))
    assert tree["pose"] == {"x_m": located.pose.x, "y_m": located.pose.y, "heading_rad": located.pose.heading}
    assert len(tree["hypotheses"]) == len(located.hypotheses)
    console = Console(file=io.StringIO(), width=100)
    console.print(located)
    table = console.file.getvalue()
    assert f"{located.pose.x:.3f}" in table
    assert "± of the pose" in table
    picture = located.draw("msl-18x12", seen_from(TRUTH))
    assert (picture.shape, picture.dtype) == (draw_field(FIELD).shape, np.uint8)
    u, v = np.rint(field_view(FIELD).picture_from_field(located.pose[:2])).astype(int)
    assert picture[v, u + 12].tolist() == [0, 0, 220]  # the robot's ring


def test_repeated_points_count_once(located: Location) -> None:
    points = seen_from(TRUTH)
    again = locate_points(np.vstack((points, points[:60], points[:30])), FIELD)
    assert again.points == 100
    assert again.pose == located.pose


def scatter(kind: str, seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    if kind == "disc":
        ranges, bearings = 5 * np.sqrt(rng.random(120)), rng.uniform(-np.pi, np.pi, 120)
        return np.column_stack((ranges * np.cos(bearings), ranges * np.sin(bearings)))
    if kind == "heaps":
        middles = rng.normal(0, 2.5, (10, 2))
        return middles[rng.integers(0, 10, 120)] + rng.normal(0, 0.3, (120, 2))
    starts, angles = np.repeat(rng.normal(0, 2.5, (6, 2)), 20, axis=0), np.repeat(rng.uniform(0, np.pi, 6), 20)
    along = np.tile(np.linspace(-1, 1, 20), 6)
    return starts + along[:, np.newaxis] * np.column_stack((np.cos(angles), np.sin(angles)))


@pytest.mark.parametrize("kind", ["disc", "heaps", "streaks"])
@pytest.mark.parametrize("seed", [0, 1])
def test_scatter_is_refused_whatever_its_form(kind: str, seed: int) -> None:
    with pytest.raises(NoFitError, match="fit no pose better than scatter"):
        locate_points(scatter(kind, seed), FIELD)


def test_a_heading_that_no_pose_has_is_refused() -> None:
    settings = LocateSettings(heading_tolerance_rad=0.01, finalists=1)
    with pytest.raises(NoFitError, match=r"no pose within 0.01 rad of the heading 1.30"):
        locate_points(seen_from(TRUTH), FIELD, heading=1.3, settings=settings)


def test_what_is_no_set_of_points_is_refused() -> None:
    with pytest.raises(InputError, match=r"two columns, x and y in metres; got an array of shape \(3, 3\)"):
        locate_points(np.zeros((3, 3)), FIELD)
    with pytest.raises(InputError, match="line point 1 is not a pair of finite numbers"):
        locate_points(np.array([[0.0, 1.0], [np.nan, 1.0]]), FIELD)
    with pytest.raises(InputError, match="the heading nan is not an angle"):
        locate_points(seen_from(TRUTH), FIELD, heading=math.nan)
    with pytest.raises(InputError, match="weights need one number of at least 0 per point"):
        locate_points(seen_from(TRUTH), FIELD, weights=-np.ones(100))


def test_thinning_keeps_one_point_of_each_cell() -> None:
    points = np.array([[0.01, 0.01], [0.02, 0.2], [0.3, 0.1], [-0.01, 0.01], [0.24, 0.24]])
    np.testing.assert_array_equal(thinned(points, 0.25), points[[0, 2, 3]])
    many = np.random.default_rng(0).uniform(-5, 5, (3000, 2))
    few = thinned_to(many, 150)
    assert 75 <= len(few) <= 150
    assert np.ptp(few, axis=0) == pytest.approx([10, 10], abs=1.0)


@pytest.mark.parametrize("heading", [None, 0.7])
def test_the_coarse_search_judges_every_pose_as_one_by_one(heading: float | None) -> None:
    """Sums over shifted blocks of the table are the means of look-ups at each pose, far beyond the map as well."""
    grid = PoseGrid(FIELD.length, FIELD.width, 0.5, 1.0, 0.0873)
    if heading is not None:
        grid.headings = heading + np.linspace(-0.6, 0.6, 15)
    distance_map = FIELD.distance_map()
    cells = distance_map.table._replace(values=np.ascontiguousarray(distance_map.values[::4, ::4]), resolution_m=0.1)
    points = np.vstack((seen_from(TRUTH), [[30.0, 2.0], [-1e6, 4.0], [5.0, -1e300]]))
    errors = CoarseSearch(distance_map, grid, 0.5).errors(points)
    one_by_one = grid_errors(points, cells, grid.positions, grid.headings, 0.5)
    assert np.mean(np.abs(errors - one_by_one) > 1e-6) < 1e-3  # a point on the border of two cells falls to either
    np.testing.assert_allclose(errors, one_by_one, atol=0.05)


def test_a_sample_heeds_the_weights_and_the_order() -> None:
    """Every tenth point has 81 times the weight of the others, and nine tenths of it together."""
    points = np.column_stack((np.arange(1000.0), np.zeros(1000)))
    weights = np.where(np.arange(1000) % 10 == 0, 0.009, 1e-3 / 9)
    heavy = []
    for seed in range(50):
        kept, shares = sampled(points, weights, 100, seed)
        assert shares.sum() == pytest.approx(1.0)
        assert np.all(np.diff(kept[:, 0]) > 0)
        assert np.diff(kept[:, 0]).max() <= 30
        heavy.append(shares[kept[:, 0] % 10 == 0].sum())
    assert np.mean(heavy) == pytest.approx(0.9, abs=0.02)
    assert sampled(points[:100], weights[:100], 100, seed=0)[0].base is points


def test_points_and_field_may_come_in_any_usual_form(tmp_path: Path) -> None:
    points = seen_from(TRUTH)
    FIELD.to_yaml(tmp_path / "field.yaml")
    expected = touchline.locate(points, "msl-18x12", heading=0.5)
    assert touchline.locate([tuple(point) for point in points.tolist()], FIELD, heading=0.5).pose == expected.pose
    assert touchline.locate(points, str(tmp_path / "field.yaml"), heading=0.5).pose == expected.pose
    assert touchline.locate(points, Path("msl-18x12"), heading=0.5).pose == expected.pose
    assert touchline.locate(points, FIELD, heading=0.5, seed=1).chance != expected.chance
    with pytest.raises(NoFitError, match="at least 101 are needed"):
        touchline.locate(points, FIELD, settings=LocateSettings(min_points=101))


def test_points_are_read_from_any_usual_header(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text("\ufeffname, y , x_m,weight\r\na,2,1,0.5\r\n\r\nb,4,3,1\r\n", encoding="utf-8")
    points, weights = read_points(path)
    np.testing.assert_array_equal(points, [[1, 2], [3, 4]])
    assert weights is not None
    np.testing.assert_array_equal(weights, [0.5, 1])
    path.write_text("x,y\n1,2\n")
    assert read_points(path)[1] is None


SCALE_M, PER_PX = 1.568777, 0.00708754  # of the robot's mirror: r = a tan(b rho)


@pytest.fixture(scope="module")
def measured(small_data: Path) -> FloatArray:
    """Every sixth of a real robot's points."""
    return np.unique(np.loadtxt(small_data / "real" / "nubot_robot1.csv", delimiter=",", skiprows=1), axis=0)[::6]


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
def test_wrong_centres_and_scales_are_within_the_covariance(
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
