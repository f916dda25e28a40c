"""Clouds of crude detectors: heaps count little, dense lines no more than thin ones, a detector's as before."""

from __future__ import annotations

import math

import numpy as np
import pytest

from touchline.geometry import FloatArray
from touchline.localization.camera_errors.base import ALL_ROUND, SECTOR
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
from touchline.types import generic_covariances

RNG = np.random.default_rng(25)


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


def test_nothing_and_one_point_count_as_they_are() -> None:
    assert len(counted(np.zeros((0, 2))).weights) == 0
    assert counted(np.array([[1.0, 2.0]])).weights.tolist() == [1.0]
    assert len(counted(np.tile([1.0, 2.0], (500, 1))).weights) <= 1


def test_a_crude_image_convicts_no_pose_by_itself() -> None:
    for trust in (ALL_ROUND, SECTOR):
        assert trust.of(crude=False) is trust
        crude = trust.of(crude=True)
        assert (crude.max_gain, crude.found_gain, crude.tracked_ratio) == (0.5, 0.0, 0.5)
        assert trust.share(0.4) == 0.4
        assert crude.share(0.4) == pytest.approx(0.7)
