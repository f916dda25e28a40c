"""Clouds of crude detectors: heaps count little, dense lines no more than thin ones, a detector's as before."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from touchline.field import open_field
from touchline.field.association import FieldAssociations
from touchline.geometry import FloatArray, Pose
from touchline.localization.camera_errors.base import ALL_ROUND, SECTOR
from touchline.localization.registration.features import Features
from touchline.localization.registration.line_likeness import (
    CELL_M,
    CROWDED,
    MAX_POINTS,
    PER_CELL,
    PER_RING,
    RAYS,
    Counted,
    _thinned,
    _uncrowded,
    count_points,
)
from touchline.localization.registration.seen import POINT_SHARE, evenly_counted, seen_of
from touchline.types import Frame, Observation, Prior, generic_covariances, points_at
from touchline_lab.experiments.drives import Drive, driven, followed
from touchline_lab.points.point_set import polar_covariances, read_point_set

RNG = np.random.default_rng(25)
NOISE = (0.02, 0.01, 0.0087)  # of the point set
POINTS = Path(__file__).parent / "data" / "points" / "msl_18x12.npz"


def counted(points: FloatArray) -> Counted:
    """What counts of points (N, 2) of which nobody says how precise they are."""
    points = np.ascontiguousarray(points, dtype=np.float64)
    found: Counted = count_points(points, generic_covariances(points), np.ones(len(points)))
    return found


def painted(start: tuple[float, float], end: tuple[float, float], count: int) -> FloatArray:
    """So many white pixels (N, 2) of a line 5 cm wide."""
    ends, share = np.array([start, end]), RNG.random(count)[:, None]
    across = np.array([[0.0, -1.0], [1.0, 0.0]]) @ (ends[1] - ends[0]) / math.dist(start, end)
    points: FloatArray = ends[0] + share * (ends[1] - ends[0]) + RNG.uniform(-0.025, 0.025, (count, 1)) * across
    return points


def seeing(frame: Frame, points: FloatArray) -> Frame:
    """A frame that shows these points (N, 2), robot frame, instead."""
    return replace(frame, observation=Observation(frame.stamp_ns, points_at(points)))


def heap(x: float, y: float, count: int = 200, rng: np.random.Generator = RNG) -> FloatArray:
    """Points (N, 2) about a place."""
    points: FloatArray = np.array([x, y]) + 0.3 * rng.standard_normal((count, 2))
    return points


def weight_near(found: Counted, x: float, y: float, reach_m: float = 1.0) -> float:
    """Of what counts, the weight about a place."""
    return float(found.weights[np.hypot(*(found.positions_m - (x, y)).T) < reach_m].sum())


def test_points_of_scan_lines_stay_as_they_are() -> None:
    point_set = read_point_set(POINTS)
    for seen in point_set.points[:20]:
        points = np.ascontiguousarray(seen.positions_m)
        spreads, sure = polar_covariances(points, NOISE), np.linspace(0.5, 1.0, len(points))
        found = count_points(points, spreads, sure)
        assert not found.crude
        assert found.line_ratio == 1.0
        for kept, given in zip(found[:3], (points, spreads, sure), strict=True):
            assert np.array_equal(kept, given)


def test_crowded_cells_are_thinned_to_their_means() -> None:
    points = np.concatenate((painted((1.0, -1.0), (1.0, 1.0), 300), RNG.uniform(-4.0, 4.0, (50, 2))))
    found, _, weights = _thinned(points, generic_covariances(points), np.ones(len(points)))
    cells, numbers = np.unique(np.floor(points / CELL_M), axis=0, return_counts=True)
    expected, expected_weights = [], []
    for cell, number in zip(cells, numbers, strict=True):
        inside = points[(np.floor(points / CELL_M) == cell).all(axis=1)]
        densest = numbers[(np.abs(cells - cell) <= 1).all(axis=1)].max()
        crowded = number > PER_CELL
        expected.extend([inside.mean(axis=0)] if crowded else inside)
        expected_weights.extend([PER_CELL * number / densest] if crowded else [1.0] * number)
    order, wanted = np.lexsort(found.T), np.lexsort(np.array(expected).T)
    assert found[order] == pytest.approx(np.array(expected)[wanted])
    assert weights[order] == pytest.approx(np.array(expected_weights)[wanted])


@pytest.mark.parametrize("count", [1, 3, 40, 400])
def test_a_crowded_cell_counts_as_several_times_the_usual_one(count: int) -> None:
    points = np.concatenate((RNG.normal(0.0, 3.0, (count, 2)), RNG.normal((2.0, 1.0), 0.02, (count, 2))))
    rays = (np.arctan2(points[:, 1], points[:, 0]) * (RAYS / (2.0 * math.pi)) + 0.5) % RAYS
    rings = 0.5 * np.log((points**2).sum(axis=1)) / PER_RING
    cells = np.floor(np.column_stack((rays, rings)))
    _, of_point, numbers = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    most = CROWDED * np.sort(numbers)[len(numbers) // 4]
    expected = 0.5 * np.minimum(most / numbers[of_point.ravel()], 1.0)
    assert np.array_equal(_uncrowded(points, np.full(2 * count, 0.5)), expected)


@pytest.mark.parametrize("count", [900, 2000, 5000])
def test_information_does_not_grow_with_density(count: int) -> None:
    lines = [((1.0, -2.0), (1.0, 2.0)), ((1.0, 2.0), (4.0, 2.0)), ((-2.0, -3.0), (3.0, -3.0))]
    found = counted(np.concatenate([painted(*line, count // 3) for line in lines]))
    assert found.crude
    assert found.line_ratio > 0.95
    assert 0.8 * MAX_POINTS < found.weights.sum() <= 1.001 * MAX_POINTS


def test_a_heap_does_not_count_beside_a_line() -> None:
    line = painted((1.5, -2.0), (1.5, 2.0), 400)
    for x, y, count in ((-1.0, 0.0, 100), (-3.0, 1.0, 400), (0.0, -4.0, 200)):
        found = counted(np.concatenate((line, heap(x, y, count))))
        assert found.crude
        assert weight_near(found, x, y) < 0.15 * found.weights.sum()
        assert found.line_ratio < 0.9


def test_where_lines_meet_is_line_like() -> None:
    corner = np.concatenate((painted((2.0, 1.0), (2.0, -1.0), 400), painted((2.0, 1.0), (4.0, 1.0), 400)))
    cross = np.concatenate((painted((-2.0, -1.0), (-2.0, 1.0), 400), painted((-3.0, 0.0), (-1.0, 0.0), 400)))
    found = counted(np.concatenate((corner, cross)))
    for place in ((2.0, 1.0), (-2.0, 0.0)):
        assert weight_near(found, *place, 0.3) > 0.5


def test_streaks_away_from_the_robot_count_less() -> None:
    found = counted(np.concatenate((painted((2.0, 2.0), (4.0, 4.0), 400), painted((2.0, -4.0), (4.0, -2.0), 400))))
    assert weight_near(found, 3.0, 3.0, 1.5) < 0.6 * weight_near(found, 3.0, -3.0, 1.5)


def test_nothing_and_one_point_count_as_they_are() -> None:
    assert len(counted(np.zeros((0, 2))).weights) == 0
    assert counted(np.array([[1.0, 2.0]])).weights.tolist() == [1.0]
    assert len(counted(np.tile([1.0, 2.0], (500, 1))).weights) <= 1


def test_a_search_takes_as_many_points_as_a_cloud_counts() -> None:
    field = open_field("hsl-s-9x6")
    features = Features(FieldAssociations(field), None, 1.0, 0.01)
    cloud = points_at(np.concatenate((painted((1.5, -2.0), (1.5, 2.0), 400), heap(-1.0, 0.0))))
    seen = seen_of(Observation(0, cloud), features, 1.0)
    assert seen.crude
    even = evenly_counted(seen)
    assert np.all(even.shares == POINT_SHARE)
    assert even.shares.sum() == pytest.approx(seen.shares.sum(), rel=0.25)
    assert len(even.positions_m) == len(even.covariances_m2) == len(even.shares)


def test_a_crude_image_convicts_no_pose_by_itself() -> None:
    for trust in (ALL_ROUND, SECTOR):
        assert trust.of(crude=False) is trust
        assert trust.of(crude=True).max_gain < 1.0
        assert trust.of(crude=True).found_gain == 0.0
        assert trust.of(crude=True).tracked_ratio == 0.5
        assert trust.of(crude=False).share(0.4) == 0.4
        assert trust.of(crude=True).share(0.4) == pytest.approx(0.7)


def cloud_of(drive: Drive, density: int, clutter: float) -> Drive:
    """A drive with a crude cloud for each frame: pixels of the lines in view, and heaps that move along."""
    segments = [((x0, y0), (x1, y1)) for x0, y0, x1, y1 in drive.field.segments.tolist()]
    lengths = np.array([math.dist(*each) for each in segments])
    heaps = RNG.uniform(-3.0, 3.0, (5, 2))
    frames = []
    for frame, truth in zip(drive.frames, drive.truth.tolist(), strict=True):
        many = RNG.multinomial(4 * density, lengths / lengths.sum())
        ground = np.concatenate([painted(*each, n) for each, n in zip(segments, many, strict=True)])
        stand = np.concatenate([heap(x, y, int(clutter * density / 5)) for x, y in heaps])
        seen = Pose(*truth).inverse().transform(np.concatenate((ground, stand)))
        seen = seen[np.hypot(*seen.T) < 6.0]
        frames.append(seeing(frame, seen[RNG.permutation(len(seen))]))
    return replace(drive, frames=frames)


@pytest.mark.parametrize("density", [150, 1500])
def test_a_robot_among_clutter_is_tracked(density: int) -> None:
    drive = cloud_of(driven("match", 25, 6.0), density, 0.4)
    track = followed("touchline", drive, 25, prior=Prior(Pose(*drive.truth[0].tolist())))
    assert not track.wrong.any()
    assert track.tracking.mean() > 0.9
    assert np.median(track.distances_m) < 0.05


@pytest.mark.parametrize("seed", [5, 11, 25])
def test_seconds_of_a_heap_alone_move_nobody(seed: int) -> None:
    """Of two of these a handful of points is left now and then, which a pose half a metre away explains."""
    drive, rng = driven("match", 26, 8.0), np.random.default_rng(seed)
    times = drive.times_s
    frames = [
        seeing(frame, heap(2.0, 1.0, 300, rng)) if 3.0 <= t < 6.0 else frame
        for frame, t in zip(drive.frames, times, strict=True)
    ]
    track = followed("touchline", replace(drive, frames=frames), 26, prior=Prior(Pose(*drive.truth[0].tolist())))
    assert not track.wrong.any()
    assert track.found[-10:].all()


def test_what_scan_lines_would_not_see_so_densely_counts_as_what_they_see() -> None:
    bearings = np.radians(np.arange(0.0, 360.0, 2.0))
    circle = 3.0 * np.column_stack((np.cos(bearings), np.sin(bearings)))
    seen = counted(circle)
    assert (seen.weights == 1.0).all()
    bar = np.column_stack((np.full(60, 4.0), np.linspace(-0.3, 0.3, 60)))  # within two cells of five degrees
    both = counted(np.concatenate((circle, bar)))
    assert not both.crude
    assert (both.weights[: len(circle)] == 1.0).all()
    assert both.weights[len(circle) :].sum() < 0.5 * len(bar)
    denser = counted(np.repeat(circle, 4, axis=0) + 0.001 * RNG.standard_normal((4 * len(circle), 2)))
    assert denser.crude, "four times as many rays: thinned, and not less by the crowd"
