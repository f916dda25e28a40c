"""The solver of the calibrations: a bundle of known answer, beside dense algebra and SciPy's own least squares."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from touchline.calibration.bundle import (
    Block,
    Equations,
    NormalEquations,
    entries,
    marginal,
    minimise,
    prior_block,
    residual_block,
)
from touchline.errors import NoFitError
from touchline.geometry import FloatArray

SCALE, OFFSET = 1.25, -0.4  # what all images share: y = scale * (x - own) + offset
OWN = np.array([0.3, -0.2, 0.1, 0.0])
SHARED_AT, OWN_AT = entries(2, len(OWN), 1)


def images(noise: float = 0.01, wrong: int = 0) -> list[tuple[FloatArray, FloatArray]]:
    """x and y (12,) of each image; so many of the values are wrong."""
    rng, seen = np.random.default_rng(7), []
    for own in OWN:
        x = rng.uniform(-2.0, 2.0, 12)
        y = SCALE * (x - own) + OFFSET + noise * rng.standard_normal(12)
        y[:wrong] += 3.0
        seen.append((x, y))
    return seen


def residuals(state: FloatArray, seen: list[tuple[FloatArray, FloatArray]]) -> list[FloatArray]:
    return [state[0] * (x - own) + state[1] - y for (x, y), own in zip(seen, state[2:], strict=True)]


def equations(state: FloatArray, seen: list[tuple[FloatArray, FloatArray]], width: float = 1e3) -> Equations:
    """With robust weights (Geman, McClure), and a prior of 0.5 for each image's own number."""
    blocks, cost = [], 0.0
    for (x, _), off, mine in zip(seen, residuals(state, seen), OWN_AT, strict=True):
        own = state[mine]
        shares = 1.0 / (1.0 + (off / width) ** 2)
        rows = np.column_stack((np.full(len(x), -state[0]), x - own, np.ones(len(x))))
        blocks.append(residual_block(np.concatenate((mine, SHARED_AT)), rows, off, shares**2 * 1e4))
        blocks.append(prior_block(mine, np.array([4.0]), own))
        cost += 1e4 * width**2 * float(np.sum(1.0 - shares)) + 4.0 * float(own @ own)
    return Equations(blocks, cost)


def dense(blocks: list[Block], size: int) -> tuple[FloatArray, FloatArray]:
    matrix, gradient = np.zeros((size, size)), np.zeros(size)
    for one in blocks:
        matrix[np.ix_(one.at, one.at)] += one.information
        gradient[one.at] += one.gradient
    return matrix, gradient


def test_step_covariance_and_influences_are_those_of_dense_algebra() -> None:
    blocks = equations(np.concatenate(([1.0, 0.0], np.zeros(4))), images()).blocks
    matrix, gradient = dense(blocks, 6)
    sparse, inverse = NormalEquations(blocks), np.linalg.inv(matrix)
    assert sparse.matrix.toarray() == pytest.approx(matrix)
    assert sparse.step() == pytest.approx(inverse @ gradient)
    assert sparse.covariance(SHARED_AT) == pytest.approx(inverse[:2, :2])
    assert sparse.influences(blocks, SHARED_AT).sum(axis=0) == pytest.approx((inverse @ gradient)[:2])
    damped = NormalEquations(blocks, 0.5)
    assert damped.step() == pytest.approx(np.linalg.solve(matrix + np.diag(0.5 * np.diag(matrix)), gradient))


def test_what_images_share_is_schurs_complement() -> None:
    blocks = equations(np.concatenate(([1.0, 0.0], np.zeros(4))), images()).blocks
    matrix, gradient = dense(blocks, 6)
    solved = np.linalg.solve(matrix[2:, 2:], np.column_stack((matrix[2:, :2], gradient[2:])))
    for prior in (np.array([1.0, 1.0]), np.array([1e4, 10.0])):  # whatever is added meanwhile
        information, pull = marginal(blocks, SHARED_AT, prior)
        assert information == pytest.approx(matrix[:2, :2] - matrix[:2, 2:] @ solved[:, :2], rel=1e-6)
        assert pull == pytest.approx(gradient[:2] - matrix[:2, 2:] @ solved[:, 2], rel=1e-6)


def test_the_known_answer_is_found_with_an_honest_covariance() -> None:
    state, found = minimise(lambda each: equations(each, images()), np.concatenate(([1.0, 0.0], np.zeros(4))))
    deviations = np.sqrt(np.diag(NormalEquations(found.blocks).covariance(np.arange(6))))
    assert np.all(np.abs(state - [SCALE, OFFSET, *OWN]) < 3.0 * deviations)
    assert deviations[0] < 0.01
    # own numbers and the offset can only be told apart by the prior
    assert deviations[1] > 0.1


@pytest.mark.parametrize("wrong", [0, 3])
def test_scipys_least_squares_come_to_the_same(wrong: int) -> None:
    seen, width = images(wrong=wrong), 0.5

    def whitened(state: FloatArray) -> FloatArray:
        return np.concatenate((*(100.0 * off for off in residuals(state, seen)), 2.0 * state[2:]))

    def loss(squares: FloatArray) -> FloatArray:
        """Geman's and McClure's, of all but the prior."""
        scale = np.concatenate((np.full(len(squares) - 4, (100.0 * width) ** 2), np.full(4, 1e12)))
        share = 1.0 / (1.0 + squares / scale)
        return np.array([scale * (1.0 - share), share**2, -2.0 * share**3 / scale])

    start = np.concatenate(([1.0, 0.0], np.zeros(4)))
    other = least_squares(whitened, start, loss=loss, xtol=1e-12, ftol=1e-12, gtol=1e-12)
    state, _ = minimise(lambda each: equations(each, seen, width), start)
    assert state == pytest.approx(other.x, abs=5e-4)  # a thousandth of its deviation
    assert state[0] == pytest.approx(SCALE, abs=0.02)


def test_what_leaves_an_entry_open_is_refused_in_words() -> None:
    along = np.array([[1.0, 1.0], [1.0, 1.0]])
    with pytest.raises(NoFitError, match="leaves the camera open"):
        NormalEquations([Block(np.arange(2), along, np.ones(2))])
