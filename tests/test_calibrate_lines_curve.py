"""What `calibrate lines` makes of a mirror it has found: kinks, lines aside, marks, and what it says of itself."""

from __future__ import annotations

import numpy as np
import pytest
from line_scenes import along_edges

from touchline.calibration.lines.calibration import LineCalibration, refined
from touchline.calibration.lines.certainty import certainty_of
from touchline.calibration.lines.equations import HEIGHT_M, Lines, Seen
from touchline.calibration.lines.joint import expected_mirror
from touchline.calibration.lines.range_curve import KNOTS, CurveFit
from touchline.calibration.lines.search import Candidate
from touchline.calibration.nearest_line import nearest_line, outward
from touchline.errors import NoFitError
from touchline.field import FieldModel, open_field
from touchline.geometry import FloatArray, Pose

CENTER, SCALE_M, PER_PX = np.array([238.0, 243.0]), 1.6, 0.0070
KINK_PX = 130.0
TURN = [Pose(3.0, -1.5, heading) for heading in (0.3, 1.9, 3.5, 5.1)]


@pytest.fixture(scope="module")
def field() -> FieldModel:
    return open_field("msl-18x12")


def tangent_m(radius_px: FloatArray) -> FloatArray:
    return np.asarray(SCALE_M * np.tan(PER_PX * radius_px))


def kinked_m(radius_px: FloatArray) -> FloatArray:
    """A mirror of two parts: from the kink on, each pixel reaches as far."""
    at = tangent_m(np.array([KINK_PX]))[0]
    return np.where(radius_px < KINK_PX, tangent_m(radius_px), at + 0.047 * (radius_px - KINK_PX))


def pixels_of(points: FloatArray, ranges_m: FloatArray, rng: np.random.Generator, noise_px: float) -> FloatArray:
    """Pixels (N, 2) of ground points (N, 2) through an upright mirror with ranges (K,) at the radii 0.1 (0, 1, ...)."""
    radius = np.interp(np.hypot(*points.T), ranges_m, 0.1 * np.arange(len(ranges_m)))
    bearing = np.arctan2(points[:, 1], points[:, 0])
    pixels = CENTER + radius[:, np.newaxis] * np.column_stack((np.cos(bearing), np.sin(bearing)))
    return np.asarray(pixels + rng.normal(0.0, noise_px, pixels.shape))


def calibrated(
    field: FieldModel,
    laid: FieldModel,
    poses: list[Pose],
    ranges_m: FloatArray,
    rng: np.random.Generator,
    bend_per_m: FloatArray | None = None,
    reach_m: float = 8.0,
) -> LineCalibration:
    """From the lines of a field as it is laid, one point every 0.3 m, and a start near the truth."""
    images = []
    for pose in poses:
        ground = pose.inverse().transform(np.concatenate(laid.polylines(0.3)))
        ground = ground[(np.hypot(*ground.T) < reach_m) & (np.hypot(*ground.T) > 0.6)]
        if bend_per_m is not None:
            upright = ground - HEIGHT_M**2 * bend_per_m
            for _ in range(20):
                upright = ground * (1.0 - upright @ bend_per_m)[:, np.newaxis] - HEIGHT_M**2 * bend_per_m
            ground = upright
        images.append(Seen(pixels_of(ground, ranges_m, rng, 0.3), 1.0, 220.0 / KNOTS))
    start = np.array([*CENTER, np.log(SCALE_M), PER_PX, 0.0, 0.0])
    states = np.array([[pose.x, pose.y, pose.heading] for pose in poses])
    return refined(Candidate(start, states, 0.0), 1.0, images, np.array([240.0, 240.0]), 220.0, field)


def tangent_table() -> FloatArray:
    return tangent_m(0.1 * np.arange(2150))


def ratios(found: LineCalibration, ranges_m: FloatArray, low: float = 2.0, high: float = 6.0) -> FloatArray:
    """Errors (N,) of ranges between low and high (m), as shares, against those of the table."""
    radii = np.interp(np.linspace(low, high, 25), ranges_m, 0.1 * np.arange(len(ranges_m)))
    return np.asarray(found.shape.range_m(radii) / np.linspace(low, high, 25) - 1.0)


@pytest.mark.slow
def test_a_mirror_of_two_parts_is_followed_over_its_kink(field: FieldModel) -> None:
    table = kinked_m(0.1 * np.arange(2150))
    found = calibrated(field, field, TURN, table, np.random.default_rng(0), reach_m=5.9)
    errors = ratios(found, table, 1.5, 5.5)
    assert np.abs(errors).max() < 0.02
    assert np.sqrt(np.mean(errors**2)) < 0.006


@pytest.mark.slow
def test_a_file_of_outer_edges_shifts_no_mirror(field: FieldModel) -> None:
    # ranges were 1 % off, and said to be right to 0.2
    found = calibrated(along_edges(field), field, TURN, tangent_table(), np.random.default_rng(6))
    errors = ratios(found, tangent_table())
    assert np.abs(errors).max() < 0.004
    edge_m, sigma_m = found.certainty.edge_m
    assert edge_m == pytest.approx(-0.5 * field.line_width, abs=4.0 * sigma_m)
    assert sigma_m < 0.008


def test_a_matrix_that_tells_nothing_is_refused_by_name(field: FieldModel) -> None:
    found = calibrated(field, field, TURN, tangent_table(), np.random.default_rng(8), reach_m=4.0)
    lines = Lines(True, field.distance_map(0.05, 3.0).table, field.line_tables)
    seen = [Seen(one, 1.0, found.shape.knot_px) for one in found.pixels]
    for matrix in (np.zeros_like(found.tangent.matrix), -np.eye(len(found.tangent.matrix))):
        fit = found.tangent._replace(matrix=matrix)
        expected = expected_mirror(CENTER, 10.0, bends=True)
        with pytest.raises(NoFitError, match="no single calibration"):
            certainty_of(CurveFit(fit, expected, 0.001), seen, lines)


def test_points_on_penalty_marks_are_left_out(field: FieldModel) -> None:
    pose, rng = Pose(4.0, -1.0, 0.7), np.random.default_rng(4)
    start = np.array([*CENTER, np.log(SCALE_M), PER_PX, 0.0, 0.0])
    ground = pose.inverse().transform(np.concatenate(field.polylines(0.3)))
    ground = ground[(np.hypot(*ground.T) < 8.0) & (np.hypot(*ground.T) > 0.6)]
    mark = field.discs[np.argmax(field.discs[:, 0]), :2]
    ring = mark + 0.03 * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0], [0.7, 0.7]])
    pixels = pixels_of(np.concatenate((ground, pose.inverse().transform(ring))), tangent_table(), rng, 0.3)
    seen = [Seen(pixels, 1.0, 220.0 / KNOTS)]
    states = np.array([[pose.x, pose.y, pose.heading]])
    found = refined(Candidate(start, states, 0.0), 1.0, seen, np.array([240.0, 240.0]), 220.0, field)
    assert len(found.pixels[0]) == len(ground)


def test_the_outer_side_of_a_line(field: FieldModel) -> None:
    """A touch line's is beyond the field, a penalty area's front's towards the middle, a circle's outside."""
    places = np.array([[2.0, 6.1], [6.7, 1.0], [-6.7, 1.0], [1.5, 1.5], [9.1, 3.0]])
    near = nearest_line(field.line_tables, places)
    assert (outward(field.line_tables)[near.line] * near.side).tolist() == [1.0] * 5


def test_the_side_of_a_line(field: FieldModel) -> None:
    near = nearest_line(field.line_tables, np.array([[0.1, 3.0], [-0.1, 3.0], [0.0, 6.3], [1.0, 0.0]]))
    line, side, next_m = near.line, near.side, near.next_m
    assert line[0] == line[1]
    assert side[0] == -side[1] != 0.0
    assert next_m[0] == pytest.approx(np.hypot(0.1, 3.0) - 1.9375)
    assert line[3] >= len(field.segments)  # inside the centre circle
    assert side[3] == -1.0
    assert np.abs(near.distance_m) == pytest.approx([0.1, 0.1, 0.3625, 0.9375])
    beyond = nearest_line(field.line_tables, np.array([[9.3, 6.2]]))
    assert beyond.side[0] == 0.0  # beyond the ends of both lines of a corner
