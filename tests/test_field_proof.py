"""Whether a pose has shown which field it is on."""

import numpy as np
import pytest

from touchline.geometry import Pose
from touchline.localization.estimator.field_proof import CROSSED, FieldProof

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
