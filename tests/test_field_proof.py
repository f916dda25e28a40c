"""Which field it is: what a pose has shown of it, what lies on its lines; a search shared out among images."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from touchline.field import open_field
from touchline.geometry import FloatArray, Pose
from touchline.localization.estimator.field_proof import CROSSED, FieldProof
from touchline.localization.registration.joint import StateFit, StatePrior
from touchline.localization.registration.line_share import BESIDE, LINE, THING, line_share
from touchline.localization.registration.registration import Registration
from touchline.localization.search.feature_search import FeatureSearch

LENGTH_M, STEP_M = 18.0, 0.15


def _driven(proof: FieldProof, from_m: float, to_m: float, slides: float = 0.0) -> None:
    """Along the field; slides: by so much of the way images move the pose."""
    for x in np.arange(from_m, to_m, STEP_M).tolist():
        proof.update(Pose(x, 0.0, 0.0), Pose(x - slides * STEP_M, 0.0, 0.0), 0.1)


@pytest.mark.parametrize(("slides", "given"), [(0.0, True), (0.05, True), (-0.1, False), (0.1, False), (0.22, False)])
def test_half_a_field_without_sliding_is_a_proof(slides: float, given: bool) -> None:
    """22 m of a field where 18 are told slide a pose by two metres from the circle to a goal."""
    proof, crossed_m = FieldProof(LENGTH_M), CROSSED * LENGTH_M
    _driven(proof, 0.0, 0.9 * crossed_m, slides)
    assert not proof.given
    _driven(proof, 0.9 * crossed_m, 2.0 * crossed_m, slides)
    assert proof.given is given


def test_a_pose_that_slides_later_proves_nothing_any_more() -> None:
    proof = FieldProof(LENGTH_M)
    _driven(proof, 0.0, 10.0)
    assert proof.given
    _driven(proof, 10.0, 14.0, 0.22)
    assert not proof.given


def test_a_way_across_the_field_is_none() -> None:
    proof = FieldProof(LENGTH_M)
    for y in np.arange(-6.0, 6.0, STEP_M).tolist():
        proof.update(Pose(1.0, y, 0.0), Pose(1.0, y, 0.0), 0.1)
    assert not proof.given


@pytest.mark.parametrize(("predicted", "seconds"), [(None, 0.1), (Pose(12.0, 0.0, 0.0), 1.0)])
def test_a_pose_that_was_not_followed_proves_nothing(predicted: Pose | None, seconds: float) -> None:
    proof = FieldProof(LENGTH_M)
    _driven(proof, 0.0, 12.0)
    assert proof.given
    proof.update(Pose(12.0, 0.0, 0.0), predicted, seconds)
    assert not proof.given
    assert proof.shows(0.9)
    assert not proof.shows(0.0)
    proof.reset()
    assert not proof.shows(0.6)


FIELD = open_field("msl-18x12")
TABLE = Registration(FIELD.distance_map()).table
POSE = np.array([1.0, -0.5, 0.4])


def _share(field_m: FloatArray) -> float:
    """Of points (N, 2) on the field, seen from a pose."""
    cosine, sine = np.cos(POSE[2]), np.sin(POSE[2])
    points = np.ascontiguousarray((field_m - POSE[:2]) @ np.array([[cosine, -sine], [sine, cosine]]))
    covariances = np.tile(np.diag([1e-4, 1e-4]), (len(points), 1, 1))
    return float(line_share(points, covariances, POSE, TABLE))


def _line(length_m: float, x: float, y: float, spacing_m: float = 0.12) -> FloatArray:
    """Points ahead in x from a place."""
    along = np.arange(0.5 * spacing_m, length_m, spacing_m)  # one in each cell
    return np.column_stack((x + along, np.full(len(along), y)))


ON_LINES = _line(6.0, -3.0, 6.0)  # a touch line, 50 points


def test_what_lies_on_lines_is_explained() -> None:
    assert _share(ON_LINES) == 1.0
    assert _share(np.zeros((0, 2))) == 0.0


def test_more_points_on_a_thing_are_no_more_things() -> None:
    thing = _line(1.0, 0.0, 4.0)
    dense = np.concatenate([thing + np.array([0.0, step]) for step in np.linspace(0.0, 0.05, 20)])
    once, often = (_share(np.concatenate((ON_LINES, points))) for points in (thing, dense))
    assert often == pytest.approx(once, abs=1e-9)


@pytest.mark.parametrize(("length_m", "weight"), [(1.0, THING), (4.0, LINE)])
def test_a_line_beside_all_counts_for_more_than_things(length_m: float, weight: float) -> None:
    apart = _line(length_m, 0.48, 4.26)
    on, off = len(ON_LINES), len(apart)
    assert _share(np.concatenate((ON_LINES, apart))) == pytest.approx(on / (on + weight * off), abs=1e-9)


def _turned(points: FloatArray, angle: float) -> FloatArray:
    """Points (N, 2) turned about their middle."""
    middle, (c, s) = points.mean(axis=0), (np.cos(angle), np.sin(angle))
    return np.asarray((points - middle) @ np.array([[c, s], [-s, c]]) + middle)


@pytest.mark.parametrize(("angle", "is_bar"), [(0.0, False), (0.05, False), (0.4, True), (-1.2, True), (1.55, False)])
def test_straight_things_parallel_to_no_axis_are_bars(angle: float, is_bar: bool) -> None:
    off = _turned(_line(2.4, -5.0, 3.66, 0.06), angle)
    share, parallel = (_share(np.concatenate((ON_LINES, points))) for points in (off, _line(2.4, -5.0, 3.66, 0.06)))
    assert (share > parallel + 0.2) is is_bar


def test_what_lies_beside_a_line_may_be_of_it() -> None:
    beside = _line(1.0, 0.48, 5.7)
    on, off = len(ON_LINES), len(beside)
    assert _share(np.concatenate((ON_LINES, beside))) == pytest.approx(on / (on + BESIDE * off), abs=1e-9)


class Recorder:
    """Registers nothing: every pose explains the image at once. `starts`: those that were tried."""

    def __init__(self) -> None:
        self.starts: list[float] = []

    def fit_state(self, seen: Any, start: Any, prior: Any, plan: Any, response: Any) -> StateFit:
        self.starts.append(float(start[0]))
        return StateFit(start, np.eye(3), np.zeros(3), 1.0, 1.0, 1.0, 0.0, 0.0, 0.0)


def test_parts_register_every_proposed_pose_once_and_share_them_evenly() -> None:
    poses = np.column_stack((np.arange(7.0), np.zeros(7), np.zeros(7)))
    proposals: Any = SimpleNamespace(of=lambda view: SimpleNamespace(poses=poses, log_likelihoods=-np.arange(7.0)))
    nothing: Any = None
    tried = []
    for part in ((0, 3), (1, 3), (2, 3)):
        recorder: Any = Recorder()
        search = FeatureSearch(proposals, recorder, symmetric=False)
        modes = search.modes(nothing, [(np.zeros(0), nothing)], StatePrior(np.zeros(3), np.eye(3)), nothing, (), part)
        assert len(modes) == len(recorder.starts)
        tried.append(recorder.starts)
    assert tried == [[0.0, 3.0, 6.0], [1.0, 4.0], [2.0, 5.0]]
