"""The line structure graph: hand-drawn skeletons, and the humanoid's recordings with their truth."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from touchline.camera import GroundView, OmniCamera, PinholeCamera
from touchline.cli.compile import drawn_image
from touchline.errors import InputError
from touchline.field import open_field
from touchline.geometry import FloatArray, Pose, Pose3
from touchline.perception.line_graph import LineGraphDetector, LineGraphPaper, LineGraphSettings
from touchline.perception.line_graph.arms import STRAIGHT_RAD, arms_meet, judge_arms
from touchline.perception.line_graph.cell_crossings import white_runs
from touchline.perception.line_graph.chains import find_chains
from touchline.perception.line_graph.circle import Circle, without_arcs
from touchline.perception.line_graph.colour_classes import CELL_PX, GREEN, WHITE
from touchline.perception.line_graph.field_boundary import smooth_boundary
from touchline.perception.line_graph.graph import Graph, connect, lead_through, line_graph
from touchline.perception.line_graph.image_plane import ground_from_pixel, image_plane, make_lens
from touchline.perception.line_graph.key_nodes import key_nodes
from touchline.perception.line_graph.lines import split_and_merge
from touchline.perception.line_graph.profiles import (
    LINE,
    NEAR_PX,
    NO_LINE,
    PROFILE_ROOM,
    Pixels,
    find_paint,
    read_profile,
)
from touchline.perception.line_graph.skeleton import low_pass, rank_cells
from touchline.sources import open_source
from touchline.types import Frame, Lines, Observation

ROWS, COLUMNS = 40, 60
SWITCHES = [
    "plain_boundary", "fixed_low_pass", "corner_split", "circles_in_image", "subpixel", "circle", "meetings", "paths",
    "white_marks",
]  # fmt: skip


def drawn(*strokes: tuple[float, float, float, float], width: float = 1.2) -> FloatArray:
    """White counts (rows, columns) of strokes x0, y0, x1, y1 in cells."""
    y, x = np.mgrid[0:ROWS, 0:COLUMNS].astype(np.float64)
    white = np.zeros((ROWS, COLUMNS))
    for x0, y0, x1, y1 in strokes:
        length = np.hypot(x1 - x0, y1 - y0)
        along = np.clip(((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) / length**2, 0.0, 1.0)
        away = np.hypot(x - x0 - along * (x1 - x0), y - y0 - along * (y1 - y0))
        white = np.maximum(white, 64.0 * np.clip(0.5 * width + 0.5 - away, 0.0, 1.0))
    return white


def graph_of(white: FloatArray, passes: int = 1) -> Graph:
    smooth, ranks = np.empty_like(white), np.empty(white.shape, dtype=np.uint8)
    low_pass(white, np.full(ROWS, passes), smooth)
    rank_cells(smooth, ranks, 0.75)
    return line_graph(smooth, ranks)


def degrees(graph: Graph, *, least: int) -> list[int]:
    return sorted(int(d) for d in graph.degrees if d >= least)


def test_a_straight_line_is_one_chain() -> None:
    graph = graph_of(drawn((10.0, 20.3, 50.0, 24.1)))
    chains = find_chains(graph)
    assert len(chains.starts) == 2
    assert sorted(np.bincount(graph.degrees).tolist()[1:]) == sorted([2, len(graph.degrees) - 2])
    ends = graph.places[graph.degrees == 1]
    np.testing.assert_allclose(np.sort(ends[:, 0]), [10.0, 50.0], atol=1.2)
    expected = 20.3 + (graph.places[:, 0] - 10.0) * 3.8 / 40.0
    inner = graph.degrees == 2
    assert np.abs(graph.places[inner, 1] - expected[inner]).mean() < 0.15


@pytest.mark.parametrize(
    ("strokes", "junctions"),
    [
        ([(10.0, 10.0, 40.0, 10.0), (10.0, 10.0, 10.0, 35.0)], []),
        ([(5.0, 10.0, 55.0, 10.0), (30.0, 10.0, 30.0, 35.0)], [3]),
        ([(5.0, 20.0, 55.0, 20.0), (30.0, 3.0, 30.0, 37.0)], [4]),
    ],
    ids=["L", "T", "X"],
)
def test_crossings_are_nodes_of_their_degree(
    strokes: list[tuple[float, float, float, float]], junctions: list[int]
) -> None:
    assert degrees(graph_of(drawn(*strokes)), least=3) == junctions


def test_a_circle_is_a_ring() -> None:
    angles = np.linspace(0.0, 2.0 * np.pi, 40)
    x, y = 30.0 + 14.0 * np.cos(angles), 20.0 + 12.0 * np.sin(angles)
    graph = graph_of(drawn(*zip(x[:-1], y[:-1], x[1:], y[1:], strict=True)))
    assert set(graph.degrees.tolist()) == {2}
    chains = find_chains(graph)
    assert len(chains.starts) == 2
    assert chains.nodes[0] == chains.nodes[-1]


def test_a_broken_line_is_bridged_over_a_pale_gap() -> None:
    white = drawn((5.0, 20.0, 55.0, 20.0))
    white[:, 28:32] *= 0.35
    assert len(find_chains(graph_of(white)).starts) == 2


def test_two_lines_close_by_stay_two() -> None:
    graph = graph_of(drawn((5.0, 18.0, 55.0, 18.0), (5.0, 22.0, 55.0, 22.0)))
    assert len(find_chains(graph).starts) == 3
    assert degrees(graph, least=3) == []


def test_a_stray_is_no_skeleton_unless_all_white_counts() -> None:
    white = np.zeros((ROWS, COLUMNS))
    white[20, 30] = 2.0
    smooth, ranks = np.empty_like(white), np.empty(white.shape, dtype=np.uint8)
    low_pass(white, np.ones(ROWS, dtype=np.int64), smooth)
    for least, cells in ((0.75, 0), (0.0, 1)):
        rank_cells(smooth, ranks, least)
        assert (ranks == 0).sum() == cells


def test_a_component_is_split_at_its_corner() -> None:
    """A short arm's end lies farthest from the fitted line: without the corner, the long arm stays crooked."""
    graph = graph_of(drawn((5.0, 10.0, 50.0, 10.0), (50.0, 10.0, 50.0, 19.0)))
    lines = split_and_merge(graph.places, find_chains(graph), 1.0, True)
    angles = np.degrees(np.arctan2(lines[:, 3] - lines[:, 1], lines[:, 2] - lines[:, 0])) % 180.0
    assert sorted(np.round(angles / 90.0) % 2) == [0.0, 1.0]
    without = split_and_merge(graph.places, find_chains(graph), 1.0, False)
    assert np.hypot(*(without[:, 2:] - without[:, :2]).T).sum() < np.hypot(*(lines[:, 2:] - lines[:, :2]).T).sum()


def test_junctions_merge_on_the_skeleton() -> None:
    places = [(10.0, 10.0), (11.2, 9.4), (12.4, 10.0), (2.0, 10.0), (10.0, 20.0), (12.4, 1.0), (20.0, 10.0)]
    graph = Graph(np.array(places), np.zeros((7, 8), dtype=np.int64), np.zeros(7, dtype=np.int64))
    for a, b in ((0, 1), (1, 2), (0, 3), (0, 4), (2, 5), (2, 6)):
        connect(graph, a, b)
    cleaned, corners = key_nodes(graph)
    np.testing.assert_array_equal(corners, [[11.2, 9.4, 4.0, 0.0]])
    assert cleaned.degrees[0] == 4


def test_a_connection_that_passes_an_end_by_leads_through_it() -> None:
    places = np.array([(10.0, 10.0), (16.0, 10.0), (13.0, 10.6), (13.0, 15.0)])
    graph = Graph(places, np.zeros((4, 8), dtype=np.int64), np.zeros(4, dtype=np.int64))
    connect(graph, 0, 1)
    connect(graph, 2, 3)
    lead_through(graph, 4)
    assert graph.degrees.tolist() == [1, 1, 3, 1]


@pytest.mark.parametrize("arms", [2, 3, 4])
def test_white_runs_on_a_circle_of_cells_are_the_arms(arms: int) -> None:
    ends = [(50.0, 20.0), (30.0, 38.0), (10.0, 20.0), (30.0, 2.0)][:arms]
    white = drawn(*((30.0, 20.0, *end) for end in ends))
    counts = np.zeros((8, ROWS, COLUMNS), dtype=np.uint8)
    counts[WHITE], counts[GREEN] = white, 64.0 - white
    np.testing.assert_allclose(white_runs(counts, 30.0, 20.0), 0.5 * np.pi * np.arange(arms), atol=0.12)
    assert len(white_runs(counts, 2.0, 20.0)) == 0  # the circle leaves the image
    counts[GREEN, 17:24, 27:30] = 0
    counts[GREEN, 24, 26:30] = 0
    assert len(white_runs(counts, 30.0, 20.0)) in (0, arms)  # a post beside it: no more arms than there are


def test_an_arc_drawn_out_beyond_its_circle_is_an_arc_still() -> None:
    circle, at = Circle(2.0, 0.0, 0.75, 20, 0.01), (0.0, 0.0, 1.0)

    def follows(ends_m: FloatArray) -> bool:
        one, some = np.eye(2)[np.newaxis], np.zeros((1, 2, 2))
        lines = Lines(ends_m[np.newaxis], np.tile(one, (1, 2, 1, 1)), np.ones(1), some)
        return not len(without_arcs(lines, circle, at))

    along = np.array([[2.75, -0.45], [2.75, 0.7]])
    assert follows(along)
    assert not follows(along + np.array([0.4, 0.0]))
    assert not follows(np.array([[2.0, -2.0], [2.0, 2.0]]))  # the halfway line
    assert not follows(np.array([[2.6, 0.0], [2.9, 0.0]]))


def test_a_circle_is_found_by_a_camera_that_leans_by_degrees_more_than_it_is_thought_to() -> None:
    """Half as long again on the ground, it was none; where it was seen in the first images, it is seen from then on."""
    field, pose = open_field("indoor-9x6"), Pose(-3.6, 0.5, -0.1)
    mount = Pose3.from_roll_pitch_yaw(0.0, 0.35, 0.0, (0.0, 0.0, 1.1))
    known = PinholeCamera(640, 480, 420.0, 420.0, 319.5, 239.5, np.zeros(5), mount, use_attitude=False)
    true = known.corrected(np.radians([-1.0, 3.2, 0.0, 0.0]), np.linspace(0.05, 0.5, 10))
    detector, image = LineGraphDetector(known, LineGraphSettings(), field), drawn_image(field, true, pose)
    middle = GroundView(true).image_from_ground(pose.inverse().transform(np.zeros((1, 2))))
    expected = GroundView(known).ground_from_image(middle)[0]
    for k in range(8):
        seen = detector.observe(Frame(k, image=image)).landmarks
        (at,) = np.flatnonzero(seen.kinds == "circle")
        assert np.hypot(*(seen.positions_m[at] - expected)) < 2.5 * np.sqrt(seen.covariances_m2[at, 0, 0])
    ends_m = detector.observe(Frame(8, image=image)).lines.ends_m
    near = np.hypot(*(ends_m.mean(axis=1) - expected).T) < 1.2
    assert near.any()
    assert np.all(np.hypot(*(ends_m[near, 1] - ends_m[near, 0]).T) > 2.0)  # its arcs are no lines
    detector.reset()
    empty = np.full_like(image, (60, 140, 50))
    for k in range(6):
        detector.observe(Frame(k, image=empty))
    late = detector.observe(Frame(6, image=image))
    assert len(late.lines) > 0
    assert not np.any(late.landmarks.kinds == "circle")


def test_the_boundary_bridges_a_notch_and_keeps_a_bay() -> None:
    ends, smoothed = np.full(40, 20.0), np.empty(40)
    ends[10] = 5.0  # one column: the median's
    ends[25:35] = 8.0  # a robot close by: wider than one step of the convex rule fills
    smooth_boundary(ends, smoothed)
    assert smoothed[10] == pytest.approx(20.0)
    assert smoothed[30] == pytest.approx(8.0)


def test_arms_tell_kind_and_orientation() -> None:
    quarter = 0.5 * np.pi
    assert judge_arms(np.array([0.1, 0.1 + quarter]), STRAIGHT_RAD) == (2, pytest.approx(0.1 + 0.5 * quarter))
    assert judge_arms(np.array([3.1, 3.1 - quarter, 3.1 + 2.0 * quarter]), STRAIGHT_RAD) == (
        3,
        pytest.approx(3.1 - quarter),
    )
    assert judge_arms(0.3 + quarter * np.arange(4), STRAIGHT_RAD) == (4, pytest.approx(0.3))
    assert judge_arms(np.array([0.0, np.pi]), STRAIGHT_RAD)[0] == 0
    assert judge_arms(np.array([0.0, 1.0, 2.0]), STRAIGHT_RAD)[0] == 0


def test_arms_of_a_line_that_bends_meet_where_they_cross() -> None:
    """The centre circle, of 0.75 m, and the halfway line; the candidate lies a little off their crossing."""
    circles = []
    for radius in (0.25, 0.4):
        bend = 2.0 * np.arcsin(radius / 1.5)
        along, across = 0.75 * np.sin(bend), 0.75 * (1.0 - np.cos(bend))
        places = np.array([(radius, 0.0), (across, along), (-radius, 0.0), (across, -along)])
        circles.append(np.column_stack((np.arctan2(places[:, 1], places[:, 0]), places)))
    assert np.hypot(*arms_meet(*circles)) < 0.005
    bar, stem = (circles[0][[0, 1, 3]], circles[1][[0, 1, 3]])
    assert np.hypot(*arms_meet(bar, stem)) < 0.005


def test_paint_is_found_between_carpet() -> None:
    samples = np.array([0.0, 0.0, 0.0, 0.25, 1.0, 1.0, 1.0, 0.75, 0.0, 0.0, 0.0])
    shown, middle, width, _ = find_paint(samples, 4.0, 2.0)
    assert shown == LINE
    assert (middle, width) == (pytest.approx(5.333, abs=0.2), pytest.approx(4.0, abs=0.3))
    thin = np.array([0.0, 0.0, 0.0, 0.3, 0.7, 0.6, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert find_paint(thin, 1.2, 2.0)[0] == NO_LINE  # half a cell off: not where a line that is placed would be
    assert find_paint(thin, 1.2, 5.0)[:2] == (LINE, pytest.approx(4.5, abs=0.3))
    assert find_paint(np.ones(11), 4.0, 2.0)[0] == NO_LINE
    assert find_paint(np.zeros(11), 4.0, 2.0)[0] == NO_LINE


@pytest.mark.parametrize("wide_px", [4.0, 9.0, 15.0, 26.0])
@pytest.mark.parametrize("off_px", [-1.2, 0.0, 0.7])
def test_profiles_of_near_lines_whose_samples_are_pixels_apart_are_right_to_a_millimetre(
    wide_px: float, off_px: float
) -> None:
    """Of a camera that looks down at paint 5 cm wide, whose edges are a pixel and a half of blur."""
    down = Pose3.from_roll_pitch_yaw(0.0, math.pi / 2.0, 0.0, (0.0, 0.0, 1.0))
    camera = PinholeCamera(160, 120, 20.0 * wide_px, 20.0 * wide_px, 79.5, 59.5, np.zeros(5), down)
    plane, middle = image_plane(make_lens(camera), GroundView(camera)), 70.0
    x, y = ground_from_pixel(plane, middle, 60.0)
    share = np.clip((0.5 * wide_px - np.abs(np.arange(160.0) - middle - off_px)) / 1.5 + 0.5, 0.0, 1.0)[:, np.newaxis]
    row = (1.0 - share) * np.array([40.0, 120.0, 40.0]) + share * np.array([220.0, 220.0, 220.0])
    image = np.tile(np.rint(row).astype(np.uint8), (120, 1, 1))
    signal = (np.arange(256.0) - np.array([[40.0], [120.0], [40.0]])) / 460.0
    cells = 120 // CELL_PX, 160 // CELL_PX
    pixels = Pixels(image, 0.02, signal, np.ones(cells), np.zeros(cells), 0.05, 1.4, 0.7)
    found = np.empty(PROFILE_ROOM)
    assert read_profile(pixels, plane, x, y, 0.0, 1.0, found, NEAR_PX) == LINE
    assert found[0] == pytest.approx(middle + off_px, abs=max(0.1, 0.02 * wide_px))
    assert found[2] == pytest.approx(wide_px, rel=0.08)
    assert found[3] == pytest.approx(wide_px, rel=0.02)


@pytest.mark.parametrize("name", SWITCHES)
def test_each_switch_to_the_paper_does_something(small_data: Path, name: str) -> None:
    recording = open_source(small_data / "humanoid_hsl_pan")
    plain = LineGraphPaper()
    other = plain.model_copy(update={name: not getattr(plain, name)})
    detectors = [
        LineGraphDetector(recording.camera, LineGraphSettings(paper=paper), recording.field) for paper in (plain, other)
    ]
    for frame in recording:
        one, two = (detector.observe(frame) for detector in detectors)
        if _differ(one, two):
            return
    pytest.fail(f"{name} changes nothing")


def _differ(one: Observation, two: Observation) -> bool:
    return any(
        a.shape != b.shape or not np.array_equal(a, b)
        for a, b in (
            (one.lines.ends_m, two.lines.ends_m),
            (one.crossings.positions_m, two.crossings.positions_m),
            (one.landmarks.positions_m, two.landmarks.positions_m),
            (one.boundary.positions_m, two.boundary.positions_m),
        )
    )


def test_an_image_without_carpet_says_so(small_data: Path) -> None:
    recording = open_source(small_data / "humanoid_9x6_walk")
    detector = LineGraphDetector(recording.camera, LineGraphSettings(), recording.field)
    grey = np.full((480, 752, 3), 128, dtype=np.uint8)
    seen = detector.observe(Frame(0, image=grey))
    assert seen.problem is not None
    assert len(seen.lines) == 0


def test_a_mirror_is_refused(small_data: Path) -> None:
    recording = open_source(small_data / "omni_msl_track")
    assert isinstance(recording.camera, OmniCamera)
    with pytest.raises(InputError, match="perspective"):
        LineGraphDetector(recording.camera, LineGraphSettings(), recording.field)
