"""`locate` on the measurements of real robots: the documented poses, under the documented line conventions."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from model_scans import FIELDS, LINE_WIDTH_M, SCANS, fields, load_points, recovered

from touchline.errors import NoFitError
from touchline.field import FieldModel, open_field
from touchline.field.model import field_to_text
from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.localization.one_shot.locate import locate_points
from touchline.localization.one_shot.location import Location, NotSignificantError, PoorFitError

# file, field with the lines as documented, field with the paint's true centre lines, documented pose, mean distance (m)
MEASUREMENTS = [
    ("nubot_robot1", "msl-18x12-outer", "msl-18x12", Pose(4.117, -1.306, math.radians(183.32)), 0.058),
    ("nubot_robot2", "msl-18x12-outer", "msl-18x12", Pose(-4.379, 0.632, math.radians(356.95)), 0.054),
    ("nubot_robot3_recal", "nubot-lab-18x8-outer", "nubot-lab-18x8", Pose(3.521, -0.077, math.radians(359.5)), 0.030),
]


def field_named(name: str) -> FieldModel:
    own = FIELDS / f"{name}.yaml"
    return open_field(own if own.is_file() else name)


def near_points(points: FloatArray) -> FloatArray:
    """The points that the documented figures are of: different ones, nearer than 8 m."""
    different = np.unique(points, axis=0)
    return different[np.hypot(*different.T) < 8.0]


def mean_distance_m(field: FieldModel, location: Location, points: FloatArray) -> float:
    return float(np.mean(field.line_distances(location.pose.transform(near_points(points)))))


def images(pose: Pose) -> list[Pose]:
    """The poses that see the same on a symmetric field, for points that can't tell left from right either."""
    across = Pose(pose.x, -pose.y, -pose.heading)
    return [pose, pose.mirrored(), across, across.mirrored()]


def is_at_an_image(location: Location, pose: Pose, within_m: float, within_rad: float) -> bool:
    return any(
        location.pose.distance_to(image) < within_m
        and abs(wrap_angle(location.pose.heading - image.heading)) < within_rad
        for image in images(pose)
    )


@pytest.mark.parametrize(("name", "documented", "true_centres", "pose", "mean_m"), MEASUREMENTS)
def test_nubots_robots_stand_where_the_brute_force_fit_has_them(
    small_data: Path, name: str, documented: str, true_centres: str, pose: Pose, mean_m: float
) -> None:
    points = load_points(small_data / "real" / f"{name}.csv")
    field = field_named(documented)
    location = locate_points(points, field)
    other = field_named(true_centres)
    print(
        f"{name}: {mean_distance_m(field, location, points):.4f} m to lines drawn with the outer dimensions, "
        f"{mean_distance_m(other, locate_points(points, other), points):.4f} m to the paint's true centre lines"
    )
    assert is_at_an_image(location, pose, 0.03, math.radians(0.5))
    assert mean_distance_m(field, location, points) <= 1.1 * mean_m
    assert any(rival.pose.distance_to(location.pose.mirrored()) < 0.03 for rival in location.hypotheses)


def test_the_falcons_robot_stands_where_its_own_score_is_best(small_data: Path) -> None:
    """Their axes: robot x right, y forward; field x along the width, y along the length. Sizes include the lines."""
    theirs = load_points(small_data / "real" / "falcons_r5.csv")
    points = np.column_stack((theirs[:, 1], -theirs[:, 0]))
    field = open_field("msl-18x12")
    location = locate_points(points, field)
    along_width, along_length, angle = 0.298, 3.003, 1.746
    pose = Pose(along_length, -along_width, angle)
    outer = field_named("msl-18x12-outer")
    print(
        f"falcons_r5: {mean_distance_m(field, location, points):.4f} m to the paint's true centre lines, "
        f"{mean_distance_m(outer, locate_points(points, outer), points):.4f} m to lines drawn with the outer dimensions"
    )
    assert min(location.pose.distance_to(image) for image in (pose, pose.mirrored())) < 0.2
    assert is_at_an_image(location, pose, 0.2, math.radians(1.0))
    assert mean_distance_m(field, location, points) <= 1.1 * 0.095


@pytest.mark.parametrize("name", ["nubot_robot1", "nubot_robot3_recal"])
def test_with_a_heading_only_that_pose_is_left(small_data: Path, name: str) -> None:
    _, field, _, pose, _ = next(row for row in MEASUREMENTS if row[0] == name)
    points = load_points(small_data / "real" / f"{name}.csv")
    location = locate_points(points, field_named(field), heading=wrap_angle(pose.heading + 0.1))
    assert location.pose.distance_to(pose) < 0.03
    assert location.hypotheses == ()


@pytest.mark.parametrize("off_deg", [60, 90, 120, -60, -90, -120])
def test_with_a_wrong_heading_nothing_is_found(small_data: Path, off_deg: float) -> None:
    points = load_points(small_data / "real" / "nubot_robot1.csv")
    heading = wrap_angle(math.radians(183.32 + off_deg))
    with pytest.raises(PoorFitError, match="Check the heading"):
        locate_points(points, field_named("msl-18x12"), heading=heading)


@pytest.mark.parametrize(
    ("name", "field"), [("nubot_robot3_recal", "msl-18x12"), ("msl_scans/savvy_2017-11-18.points", "savvy_2017-11-18")]
)
def test_a_poor_fit_has_its_twin_and_no_rival_that_is_far_worse(small_data: Path, name: str, field: str) -> None:
    """On the wrong field, or with a poor mirror, a third of the points is off; poorer poses yet are no rivals."""
    location = locate_points(load_points(small_data / "real" / f"{name}.csv"), field_named(field))
    cm = [round(100 * rival.residual_m) for rival in location.hypotheses]
    print(f"{name}: {100 * location.mean_distance_m:.1f} cm; rivals {cm} cm")
    assert all(rival.residual_m <= 1.25 * location.mean_distance_m + 0.02 for rival in location.hypotheses)
    assert any(rival.pose.distance_to(location.pose.mirrored()) < 0.03 for rival in location.hypotheses)


def test_the_fields_of_the_scans_are_those_recovered_from_the_models(small_data: Path) -> None:
    for name, field in fields(small_data).items():
        assert (FIELDS / f"{name}.yaml").read_text(encoding="utf-8") == field_to_text(field)


@pytest.mark.parametrize("scan", SCANS)
def test_every_model_point_lies_on_the_recovered_field_where_the_robot_placed_it(small_data: Path, scan: str) -> None:
    model = load_points(small_data / "real" / "msl_scans" / f"{scan}.model.csv")
    _, field_from_robot = recovered(model)
    distances = field_named(scan).line_distances(field_from_robot.transform(model))
    assert distances.max() < 0.02


def scan_points(small_data: Path, scan: str) -> tuple[FloatArray, Pose]:
    """The points of a scan and the robot's own placing."""
    folder = small_data / "real" / "msl_scans"
    return load_points(folder / f"{scan}.points.csv"), recovered(load_points(folder / f"{scan}.model.csv"))[1]


@pytest.mark.parametrize("scan", ["myo_2017-11-17", "nase_2017-11-18"])
def test_it_agrees_with_robots_that_knew_where_they_were(small_data: Path, scan: str) -> None:
    points, own = scan_points(small_data, scan)
    location = locate_points(points, field_named(scan))
    assert min(location.pose.distance_to(pose) for pose in (own, own.mirrored())) < 0.4
    assert is_at_an_image(location, own, 0.4, math.radians(5))


def test_a_scan_that_is_mostly_scatter_is_refused(small_data: Path) -> None:
    points, _ = scan_points(small_data, "mops_2017-03-31")
    for heading in (None, 0.4):
        with pytest.raises(NoFitError, match="fit no pose better than scatter"):
            locate_points(points, field_named("mops_2017-03-31"), heading=heading)


@pytest.mark.parametrize("scan", ["foxy_2018-04-05", "hairy_2018-04-26", "savvy_2017-11-18"])
def test_of_the_other_scans_it_reports_what_it_finds(small_data: Path, scan: str) -> None:
    """Their own placing is poor, so there is nothing to agree with: a pose that beats their own, or a refusal."""
    points, own = scan_points(small_data, scan)
    field = field_named(scan)
    at_own = float(np.mean(field.line_distances(own.transform(near_points(points)))))
    try:
        pose = locate_points(points, field).pose
        said = "found"
    except NotSignificantError as error:
        pose, said = error.best.pose, f"refused ({error.chance.significance:.1f} deviations), best"
    found_m = float(np.mean(field.line_distances(pose.transform(near_points(points)))))
    print(f"{scan}: {said} {pose}: {found_m:.2f} m; its own placing {own}: {at_own:.2f} m")
    assert found_m < at_own


def test_line_widths_of_the_made_fields_are_the_rules() -> None:
    assert {field_named(name).line_width for name in (*SCANS, "msl-18x12-outer", "nubot-lab-18x8")} == {LINE_WIDTH_M}
