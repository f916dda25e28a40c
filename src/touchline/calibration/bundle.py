"""Bundle adjustment: what all images share and what is each image's own, fitted together (Triggs et al. 2000).

The state is one vector. Every image and every prior adds a block of normal equations for the entries that it depends
on. Together they are a sparse matrix, which SciPy factorises: that gives a step of everything at once and the
covariance of any part. Robust weights are the caller's: iteratively reweighted least squares. (With robust losses and a
sparse Jacobian `scipy.optimize.least_squares` comes to the same in about twice the time.)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from touchline.errors import NoFitError
from touchline.geometry import FloatArray, IndexArray

_STEPS, _SETTLED = 60, 1e-3  # of Levenberg and Marquardt: at most so many, and the gain at which they end
_MIN_DAMPING, _MAX_DAMPING = 1e-7, 1e5
SINGULAR = (
    "what was seen leaves the camera open: no single calibration explains it best. Are the points line points of this "
    "field, from an image in which several lines are seen?"
)
_TINY = 1e-9  # added to the diagonal with any damping: an entry that nothing depends on stays


class Block(NamedTuple):
    """Normal equations of some entries of the state: their numbers (K,), information (K, K), gradient (K,).

    The gradient is that of the log-likelihood: a step along it improves the fit. It is -Jᵀ W r of residuals r.
    """

    at: IndexArray
    information: FloatArray
    gradient: FloatArray

    def divided(self, repeated: float) -> Block:
        """The block where so many residuals that err together count as one."""
        return Block(self.at, self.information / repeated, self.gradient / repeated)


class Equations(NamedTuple):
    """The blocks at a state, and the robust cost there that the steps lower: twice the negative log-likelihood."""

    blocks: list[Block]
    cost: float


def residual_block(at: IndexArray, rows: FloatArray, residuals: FloatArray, weights: FloatArray) -> Block:
    """Of residuals (N,) with derivatives (N, K) by the entries and weights (N,), which are inverse variances."""
    weighted = rows * weights[:, np.newaxis]
    return Block(at, weighted.T @ rows, -weighted.T @ residuals)


def prior_block(at: IndexArray, information: FloatArray, off: FloatArray) -> Block:
    """Of a Gaussian prior with information (K, K) or, of independent entries, (K,); off: (K,) entries less its mean."""
    matrix = np.diag(information) if information.ndim == 1 else information
    return Block(at, matrix, -matrix @ off)


def entries(shared: int, images: int, own: int) -> tuple[IndexArray, IndexArray]:
    """Numbers of the shared entries (S,), which come first, and of each image's own (V, P)."""
    return np.arange(shared), shared + np.arange(images * own).reshape(images, own)


class NormalEquations:
    """Blocks added up and factorised; damping: by what ratio the diagonal is raised (Levenberg and Marquardt).

    gradient: (P,) of the whole state. matrix: (P, P), sparse. Raises NoFitError where they leave an entry open.
    """

    def __init__(self, blocks: Sequence[Block], damping: float = 0.0) -> None:
        from scipy.sparse import coo_array
        from scipy.sparse.linalg import splu

        at = np.concatenate([one.at for one in blocks])
        rows = np.concatenate([np.repeat(one.at, len(one.at)) for one in blocks])
        columns = np.concatenate([np.tile(one.at, len(one.at)) for one in blocks])
        values = np.concatenate([one.information.ravel() for one in blocks])
        self.matrix: Any = coo_array((values, (rows, columns)), shape=(at.max() + 1, at.max() + 1)).tocsc()
        self.gradient: FloatArray = np.bincount(at, np.concatenate([one.gradient for one in blocks])).astype(np.float64)
        if damping:
            self.matrix.setdiag((1.0 + damping) * self.matrix.diagonal() + _TINY)
        try:
            self._factors = splu(self.matrix, "MMD_AT_PLUS_A", 0.0, options={"SymmetricMode": True})
        except RuntimeError:  # exactly singular, or not finite
            raise NoFitError(SINGULAR) from None

    def step(self, gradient: FloatArray | None = None) -> FloatArray:
        """The Gauss-Newton step (P,), or that of another gradient, (P,) or several of them (P, G)."""
        return self._factors.solve(self.gradient if gradient is None else gradient)

    def covariance(self, at: IndexArray) -> FloatArray:
        """Covariance (K, K) of some entries (K,), whatever all others are."""
        units = np.zeros((len(self.gradient), len(at)))
        units[at, np.arange(len(at))] = 1.0
        return self.step(units)[at]

    def influences(self, blocks: Sequence[Block], at: IndexArray) -> FloatArray:
        """By how much (B, K) each block moves some entries (K,)."""
        columns = np.zeros((len(self.gradient), len(blocks)))
        for column, one in zip(columns.T, blocks, strict=True):
            column[one.at] = one.gradient
        return self.step(columns)[at].T


def marginal(blocks: Sequence[Block], at: IndexArray, prior: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Information (K, K) and gradient (K,) of some entries (K,), whatever all others are.

    prior: (K,) information that is added while the blocks are solved, so that they need not tell each entry.
    """
    equations = NormalEquations([*blocks, prior_block(at, prior, np.zeros(len(at)))])
    information = np.linalg.inv(equations.covariance(at))
    return information - np.diag(prior), information @ equations.step()[at]


def minimise(equations: Callable[[FloatArray], Equations], start: FloatArray) -> tuple[FloatArray, Equations]:
    """The state (P,) that damped steps (Levenberg, Marquardt) come to from a start, and the equations there."""
    state, now, damping = start, equations(start), 1e-3
    for _ in range(_STEPS):
        trial = state + NormalEquations(now.blocks, damping).step()
        new = equations(trial)
        if not new.cost < now.cost:
            damping *= 6.0
            if damping > _MAX_DAMPING:
                break
            continue
        gained = now.cost - new.cost
        state, now, damping = trial, new, max(0.2 * damping, _MIN_DAMPING)
        if gained < _SETTLED:
            break
    return state, now
