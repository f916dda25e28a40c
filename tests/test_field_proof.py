"""Whether a pose has shown which field it is on."""

import pytest

from touchline.geometry import Pose
from touchline.localization.estimator.field_proof import CROSSED, FieldProof

LENGTH_M, STEP_M = 18.0, 0.15


def _driven(proof: FieldProof, way_m: float, slides: float = 0.0) -> None:
    """Along the field; slides: by so much of the way images move the pose."""
    for k in range(round(way_m / STEP_M)):
        x = k * STEP_M * (1.0 + slides)
        proof.update(Pose(x, 0.0, 0.0), Pose(x - slides * STEP_M, 0.0, 0.0), 0.1)


@pytest.mark.parametrize(("slides", "given"), [(0.0, True), (0.03, True), (-0.22, False), (0.22, False)])
def test_half_a_field_without_sliding_is_a_proof(slides: float, given: bool) -> None:
    """22 m of a field where 18 are told slide a pose by two metres from the circle to a goal."""
    proof = FieldProof(LENGTH_M)
    _driven(proof, 0.9 * CROSSED * LENGTH_M / (1.0 + abs(slides)), slides)
    assert not proof.given
    _driven(proof, 12.0, slides)
    assert proof.given is given


@pytest.mark.parametrize(("predicted", "seconds"), [(None, 0.1), (Pose(12.0, 0.0, 0.0), 1.0)])
def test_a_pose_that_was_not_followed_proves_nothing(predicted: Pose | None, seconds: float) -> None:
    proof = FieldProof(LENGTH_M)
    _driven(proof, 12.0)
    assert proof.given
    proof.update(Pose(12.0, 0.0, 0.0), predicted, seconds)
    assert not proof.given
