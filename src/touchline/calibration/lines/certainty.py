"""How sure a calibration from lines is, and when it is none."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from touchline.calibration.lines.equations import SHAPE, Lines, Seen
from touchline.calibration.lines.joint import linearise
from touchline.calibration.lines.mirror_shape import MirrorShape
from touchline.calibration.lines.range_curve import CurveFit
from touchline.calibration.lines.search import WIDTHS
from touchline.geometry import FloatArray

_CELL_M = 2.0  # pieces of the field's lines that err together: tape measures and paint
_SECTORS = 18  # ... and of the mirror
_UPRIGHT = 0.001  # of the range: what a mirror that leans does beyond a bend
_KINKS = 0.25  # of the curve's usual second difference: how far a kink between knots is rounded off


class Certainty(NamedTuple):
    """What a fit says of itself.

    covariance (Q, Q): of the mirror's parameters, from how far the residuals of neighbouring points agree; with
    center_px (2,) and bend_per_m (2,), their standard deviations. residuals, distances: of all points, in standard
    deviations (about pixels) and m. unresolved: what ranges may be off by, as a share, between the curve's knots.
    """

    covariance: FloatArray
    center_px: FloatArray
    bend_per_m: FloatArray
    residuals: FloatArray
    distances_m: FloatArray
    unresolved: float

    @property
    def on_lines(self) -> float:
        """Share of the points that lie on lines."""
        return float(np.mean(self.residuals < WIDTHS[-1]))

    def range_ratio(self, shape: MirrorShape, radius_px: FloatArray) -> FloatArray:
        """Standard deviation (N,) of the ranges at radii (N,), as a share of them, where there are points."""
        step = 1e-4 * np.sqrt(np.maximum(np.diag(self.covariance), 1e-18))
        base = np.log(shape.range_m(radius_px))
        slopes = np.zeros((len(radius_px), len(step)))
        for k in range(len(step)):
            moved = shape.parameters.copy()
            moved[k] += step[k]
            other = MirrorShape(moved, shape.handedness, shape.knot_px, shape.origin_m)
            slopes[:, k] = (np.log(other.range_m(radius_px)) - base) / step[k]
        variance = np.einsum("nk,kl,nl->n", slopes, self.covariance, slopes)
        ratio: FloatArray = np.sqrt(np.maximum(variance, 0.0) + self.unresolved**2)
        return ratio


def certainty_of(found: CurveFit, seen: Sequence[Seen], lines: Lines) -> Certainty:
    """The certainty of a fit: Huber's sandwich, its points in groups that err together, and its own covariance."""
    fit, expected, curvature = found
    size = len(fit.mirror)
    points = linearise(seen, fit, lines)
    residuals = np.abs(points.residuals)
    sigmas_m = points.sigmas_m if expected.wider is None else points.sigmas_m * expected.wider
    shares = 1.0 / (1.0 + (points.distances_m / (WIDTHS[-1] * sigmas_m)) ** 2)
    added = points.rows * (points.distances_m * (shares / sigmas_m) ** 2 / expected.noise)[:, np.newaxis]
    offset = np.concatenate([one.pixels for one in seen]) - fit.mirror[:2]
    sectors = np.floor(np.arctan2(offset[:, 1], offset[:, 0]) / (2.0 * np.pi) * _SECTORS).astype(np.int64)
    inverse = np.linalg.inv(fit.matrix)
    spreads = [_sandwich(added, groups, inverse) for groups in (_cells(points.places), sectors)]
    covariance = max([*spreads, inverse], key=_of_center)[:size, :size]
    deviations = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unresolved = float(np.hypot(_UPRIGHT, _KINKS * curvature))
    return Certainty(covariance, deviations[:2], deviations[4:SHAPE], residuals, np.abs(points.distances_m), unresolved)


def _of_center(covariance: FloatArray) -> float:
    return float(np.trace(covariance[:2, :2]))


def _sandwich(rows: FloatArray, groups: npt.NDArray[np.int64], inverse: FloatArray) -> FloatArray:
    _, index = np.unique(groups, return_inverse=True)
    sums = np.zeros((index.max() + 1, rows.shape[1]))
    np.add.at(sums, index, rows)
    count = len(sums)
    few = count / max(count - 1.0, 1.0)
    result: FloatArray = few * inverse @ (sums.T @ sums) @ inverse
    return result


def _cells(points: FloatArray) -> npt.NDArray[np.int64]:
    cells = np.clip(np.floor(points / _CELL_M), -500, 500).astype(np.int64)
    numbers: npt.NDArray[np.int64] = cells[:, 0] * 1001 + cells[:, 1]
    return numbers
