"""One observation alone: the pose, its rivals, and the refusal of what fits nowhere."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from line_scenes import view
from rich.console import Console

import touchline
from touchline.errors import InputError, NoFitError
from touchline.field import FieldModel, open_field
from touchline.field.drawing import draw_field, field_view
from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.localization.one_shot.locate import (
    LocateSettings,
    locate,
    locate_points,
)
from touchline.localization.one_shot.location import Location, NotSignificantError, PoorFitError
from touchline.localization.one_shot.permutation_test import PIECES, rearranged
from touchline.localization.one_shot.points_file import read_points
from touchline.localization.one_shot.thinning import sampled, thinned, thinned_to
from touchline.localization.search.coarse_search import CoarseSearch
from touchline.localization.search.pose_grid import PoseGrid
from touchline.published.nubot.kernels import grid_errors
from touchline.types import LinePoints

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


def test_poses_over_the_whole_circle_are_found() -> None:
    rng = np.random.default_rng(1)
    for seed in range(4):
        truth = Pose(rng.uniform(-8, 8), rng.uniform(-5, 5), rng.uniform(-math.pi, math.pi))
        location = locate_points(seen_from(truth, seed), FIELD)
        assert is_at(location, truth) or is_at(location, truth.mirrored())


def test_two_alike_places_are_rivals_of_each_other() -> None:
    circles = FieldModel(
        name="circles", length=18.0, width=12.0, line_width=0.125, circles=np.array([[-4.0, 0, 1.0], [4.0, 0, 1.0]])
    )
    points = view(circles, Pose(4.0, 0.5, 0.3), np.random.default_rng(0), reach_m=3.0)
    location = locate_points(points, circles, heading=0.3)
    found = sorted(pose.x for pose in (location.pose, *(rival.pose for rival in location.hypotheses)))
    assert found[0] == pytest.approx(-4.0, abs=0.5)
    assert found[-1] == pytest.approx(4.0, abs=0.5)


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


def test_weights_are_heeded() -> None:
    """Half of the points are of another place; their weight decides which half is believed."""
    one, other = Pose(3.2, -1.4, 0.5), Pose(-5.0, 2.0, 0.5)
    points = np.vstack((seen_from(one, clutter=0.0), seen_from(other, seed=1, clutter=0.0)))
    for weights, expected in (((1.0, 0.05), one), ((0.05, 1.0), other)):
        location = locate_points(points, FIELD, heading=0.5, weights=np.repeat(weights, 100))
        assert is_at(location, expected)


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


def test_lines_of_another_field_are_refused_with_what_to_check() -> None:
    points = view(open_field("spl-9x6"), Pose(1.0, 0.5, 0.3), np.random.default_rng(0))
    with pytest.raises(NoFitError, match=r"Check the field, the unit \(metres\) and the axes"):
        locate_points(points, FIELD)


@pytest.mark.parametrize("off_deg", [60, -60, 90, 120])
def test_a_wrong_heading_is_refused_with_what_to_check(off_deg: float) -> None:
    """However crisp the lines: at that heading half of the points lie out of the error function's reach."""
    wrong = wrap_angle(TRUTH.heading + math.radians(off_deg))
    with pytest.raises(PoorFitError, match=rf"Check the heading \({wrong:.3f} rad.*the field, the unit \(metres\)"):
        locate_points(seen_from(TRUTH, count=600), FIELD, heading=wrong)


def test_a_fit_whose_lines_miss_half_of_the_points_is_refused_with_the_numbers() -> None:
    """Far better than chance, but farther from the lines than is allowed."""
    strict = LocateSettings(max_median_m=0.005)
    with pytest.raises(PoorFitError) as refused:
        locate_points(seen_from(TRUTH), FIELD, settings=strict)
    assert not isinstance(refused.value, NotSignificantError)
    median_m = np.median(FIELD.line_distances(refused.value.best.pose.transform(seen_from(TRUTH))))
    assert f"half of them more than {median_m:.2f} m from the lines" in str(refused.value)
    assert "Check the field, the unit" in str(refused.value)
    assert is_near(refused.value.best.pose, TRUTH) or is_near(refused.value.best.pose, TRUTH.mirrored())


@pytest.mark.parametrize("heading", [180.0, -90.0, 6.4])
def test_a_heading_beyond_a_whole_turn_is_not_in_radians(heading: float) -> None:
    with pytest.raises(InputError, match=rf"the heading {heading:g} is more than a whole turn: is it in radians\?"):
        locate_points(seen_from(TRUTH), FIELD, heading=heading)


def test_a_whole_turn_more_is_the_same_heading() -> None:
    assert is_at(locate_points(seen_from(TRUTH), FIELD, heading=TRUTH.heading - 2 * math.pi), TRUTH)


def test_rivals_are_as_near_to_the_lines_as_the_pose() -> None:
    """On a field with another penalty area the error saturates: only the distance tells the poor poses apart."""
    points = view(open_field("msl-22x14"), Pose(6.0, 2.0, 0.5), np.random.default_rng(0), count=400)
    loose = LocateSettings(hypothesis_factor=3.0, hypothesis_margin_m=10.0, max_median_m=5.0)
    tied = loose.model_copy(update={"hypothesis_margin_m": 0.0})
    many, few = (locate_points(points, FIELD, settings=s) for s in (loose, tied))
    assert few.pose == many.pose
    assert max(rival.residual_m for rival in many.hypotheses) > 3 * many.mean_distance_m
    assert few.hypotheses == tuple(r for r in many.hypotheses if r.residual_m <= 3 * many.mean_distance_m)


def test_the_twin_is_always_a_rival_on_a_symmetric_field() -> None:
    strict = LocateSettings(hypothesis_factor=1.0, hypothesis_margin=0.0, hypothesis_margin_m=0.0)
    for seed in range(3):
        location = locate_points(seen_from(TRUTH, seed), FIELD, settings=strict)
        assert any(is_near(rival.pose, location.pose.mirrored()) for rival in location.hypotheses)


def test_too_few_points_are_refused() -> None:
    with pytest.raises(NoFitError, match="7 different points are too few"):
        locate_points(np.vstack((seen_from(TRUTH, count=7), seen_from(TRUTH, count=7))), FIELD)
    with pytest.raises(NoFitError, match="1 different point is too few"):
        locate_points(np.ones((9, 2)), FIELD)


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


def test_the_same_points_give_the_same_answer(located: Location) -> None:
    again = locate_points(seen_from(TRUTH), FIELD)
    assert again.pose == located.pose
    assert again.chance == located.chance
    assert again.hypotheses == located.hypotheses


def test_rearranging_keeps_the_ranges_and_the_pieces() -> None:
    points = seen_from(TRUTH)
    turned = rearranged(points, PIECES, np.random.default_rng(0))
    np.testing.assert_allclose(np.hypot(*turned.T), np.hypot(*points.T))
    turns = np.round(np.mod(np.arctan2(*turned.T[::-1]) - np.arctan2(*points.T[::-1]), 2 * np.pi), 6)
    values, counts = np.unique(turns, return_counts=True)
    assert len(values) == 8
    assert counts.max() - counts.min() <= 1


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


def test_the_best_of_the_coarse_search_are_no_neighbours() -> None:
    grid = PoseGrid(FIELD.length, FIELD.width, 0.5, 1.0, 0.0873)
    search = CoarseSearch(FIELD.distance_map(), grid, 0.5)
    best = search.best(seen_from(TRUTH), 40)
    apart_m = np.abs(best[:, np.newaxis, :2] - best[:, :2]).max(axis=2)
    apart_rad = np.abs(np.angle(np.exp(1j * (best[:, np.newaxis, 2] - best[:, 2]))))
    assert np.all((apart_m >= 0.75) | (apart_rad >= 0.218) | np.eye(40, dtype=bool))
    of_heading = np.argmin(np.abs(grid.headings - best[:, 2:]), axis=1)
    of_position = np.argmin(np.hypot(*(grid.positions - best[:, np.newaxis, :2]).T), axis=0)
    errors = search.errors(seen_from(TRUTH))
    found = errors[of_heading, of_position]
    assert found[0] == errors.min()
    assert np.all(np.diff(found) >= 0)


def dense(points: FloatArray, count: int) -> FloatArray:
    rng = np.random.default_rng(3)
    return points[rng.integers(0, len(points), count)] + rng.normal(0, 0.01, (count, 2))


@pytest.mark.parametrize("heading", [None, 0.6])
def test_a_sample_of_very_many_points_gives_the_same_answer(
    monkeypatch: pytest.MonkeyPatch, heading: float | None
) -> None:
    """The same: found, within a standard deviation of the pose, with the same hypotheses."""
    points = dense(seen_from(TRUTH, count=400, clutter=0.02), 30_000)
    quick = LocateSettings(finalists=4)
    some = locate_points(points, FIELD, heading, settings=quick)
    monkeypatch.setattr("touchline.localization.one_shot.locate.MAX_POINTS", len(points))
    all_of_them = locate_points(points, FIELD, heading, settings=quick)
    assert some.points == all_of_them.points == 30_000
    sigma_m, sigma_rad = np.sqrt(all_of_them.covariance[0, 0]), np.sqrt(all_of_them.covariance[2, 2])
    one, other = ([found.pose, *(h.pose for h in found.hypotheses)] for found in (some, all_of_them))
    assert len(one) == len(other)
    assert all(any(apart(p, q)[0] < sigma_m and apart(p, q)[1] < sigma_rad for q in other) for p in one)
    deviations = np.sqrt(np.diag(all_of_them.covariance))
    assert np.all(np.abs(some.covariance - all_of_them.covariance) <= 0.01 * np.outer(deviations, deviations))
    assert some.mean_distance_m == pytest.approx(all_of_them.mean_distance_m, rel=0.02)


@pytest.mark.parametrize("kind", ["disc", "heaps", "streaks"])
def test_very_many_scattered_points_are_refused_as_ever(kind: str) -> None:
    with pytest.raises(NotSignificantError):
        locate_points(dense(scatter(kind, 0), 30_000), FIELD, settings=LocateSettings(finalists=4))


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


def test_three_lines_of_python(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "points.csv", seen_from(TRUTH), delimiter=",", header="x_m,y_m", comments="")
    assert is_at(locate(tmp_path / "points.csv", "msl-18x12", heading=0.5), TRUTH)
    assert is_at(locate(seen_from(TRUTH), FIELD, heading=0.5), TRUTH)
    assert is_at(touchline.locate(seen_from(TRUTH), FIELD, heading=0.5), TRUTH)


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


def test_line_points_are_weighed_by_their_precision() -> None:
    """Half of the points are of another place and said to be imprecise; one that is no number is left out."""
    one, other = Pose(3.2, -1.4, 0.5), Pose(-5.0, 2.0, 0.5)
    positions = np.vstack((seen_from(one, clutter=0.0), seen_from(other, seed=1, clutter=0.0), [[np.nan, 0.0]]))
    sigmas = np.repeat([0.01, 0.5], [100, 101])
    for sigma_m, expected in ((sigmas, one), (sigmas[::-1], other)):
        covariances = sigma_m[:, np.newaxis, np.newaxis] ** 2 * np.eye(2)
        points = LinePoints(positions, covariances, np.ones(201), np.full((201, 2), np.nan))
        assert is_at(touchline.locate(points, FIELD, heading=0.5), expected)


@pytest.mark.parametrize("points", [[(1.0, 2.0), (1.0,)], [("a", "b")], None])
def test_what_is_no_list_of_pairs_is_refused(points: Any) -> None:
    with pytest.raises(InputError, match="line points need two columns, x and y in metres"):
        touchline.locate(points, FIELD)


def test_points_are_read_from_any_usual_header(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text("\ufeffname, y , x_m,weight\r\na,2,1,0.5\r\n\r\nb,4,3,1\r\n", encoding="utf-8")
    points, weights = read_points(path)
    np.testing.assert_array_equal(points, [[1, 2], [3, 4]])
    assert weights is not None
    np.testing.assert_array_equal(weights, [0.5, 1])
    path.write_text("x,y\n1,2\n")
    assert read_points(path)[1] is None


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "is empty"),
        ("x_m,y_m\n", "holds no points"),
        ("1.0,2.0\n3,4\n", "line 1: expected the header x_m,y_m, found '1.0,2.0'"),
        ("x_m,y_m\n1,2\n3,abc\n", "line 3: the y 'abc' is not a number"),
        ("x_m,y_m\n1,2\n\n3\n", "line 4: the y is missing"),
        ("x_m,y_m\n1,nan\n", "line 2: the y 'nan' is not a finite number"),
        ("x_m,y_m,weight\n1,2,1\n1,2,-1\n", "line 3: a weight can't be negative"),
    ],
)
def test_a_broken_points_file_is_refused_with_file_and_line(tmp_path: Path, text: str, complaint: str) -> None:
    path = tmp_path / "points.csv"
    path.write_text(text)
    with pytest.raises(InputError) as refused:
        read_points(path)
    assert str(refused.value).startswith(str(path))
    assert complaint in str(refused.value)


def test_a_missing_or_binary_points_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_points(tmp_path / "none.csv")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(InputError, match="is not a text file"):
        read_points(tmp_path / "binary.csv")
