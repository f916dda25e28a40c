"""How sure a calibration from lines is, and when it is none."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from touchline.calibration.lines.equations import SHAPE, Lines, Noise, Seen, scores
from touchline.calibration.lines.joint import JointFit
from touchline.calibration.lines.mirror_shape import MirrorShape
from touchline.calibration.lines.search import GROUND_M, WIDTHS
from touchline.geometry import FloatArray

_CELL_M = 2.0  # pieces of the field's lines that err together: tape measures and paint
_SECTORS = 18  # ... and of the mirror


class Certainty(NamedTuple):
    """What a fit says of itself.

    covariance (Q, Q): of the mirror's parameters, from how far the residuals of neighbouring points agree; with
    center_px (2,) and bend_per_m (2,), their standard deviations. residuals, distances: of all points, in standard
    deviations (about pixels) and m.
    """

    covariance: FloatArray
    center_px: FloatArray
    bend_per_m: FloatArray
    residuals: FloatArray
    distances_m: FloatArray
    agreement: float

    @property
    def on_lines(self) -> float:
        """Share of the points that lie on lines."""
        return float(np.mean(self.residuals < WIDTHS[-1]))

    def range_ratio(self, shape: MirrorShape, radius_px: FloatArray) -> FloatArray:
        """Standard deviation (N,) of the ranges at radii (N,), as a share of them."""
        step = 1e-4 * np.sqrt(np.maximum(np.diag(self.covariance), 1e-18))
        base = np.log(shape.range_m(radius_px))
        slopes = np.zeros((len(radius_px), len(step)))
        for k in range(len(step)):
            moved = shape.parameters.copy()
            moved[k] += step[k]
            other = MirrorShape(moved, shape.handedness, shape.knot_px, shape.origin_m)
            slopes[:, k] = (np.log(other.range_m(radius_px)) - base) / step[k]
        ratio: FloatArray = np.sqrt(np.einsum("nk,kl,nl->n", slopes, self.covariance, slopes))
        return ratio


def certainty_of(fit: JointFit, seen: Sequence[Seen], lines: Lines) -> Certainty:
    """The certainty of a fit: Huber's sandwich, its points in groups that err together, and its own covariance."""
    size = len(fit.mirror)
    noise = Noise(GROUND_M, WIDTHS[-1])
    added, residuals, distances, places, sectors = [], [], [], [], []
    for k, one in enumerate(seen):
        own, residual, distance = scores(one, np.concatenate((fit.mirror, fit.poses[k])), lines, noise)
        wide = np.zeros((len(own), size + 3 * len(seen)))
        wide[:, :size], wide[:, size + 3 * k : size + 3 * k + 3] = own[:, :size], own[:, size:]
        added.append(wide)
        residuals.append(residual)
        distances.append(distance)
        shape = MirrorShape(fit.mirror, int(one.handedness), one.knot_px, np.zeros(2))
        places.append(_cells(_on_field(shape.ground(one.pixels), fit.poses[k])))
        offset = one.pixels - fit.mirror[:2]
        sectors.append(np.floor(np.arctan2(offset[:, 1], offset[:, 0]) / (2.0 * np.pi) * _SECTORS).astype(np.int64))
    inverse = np.linalg.inv(fit.matrix)
    rows = np.concatenate(added)
    spreads = [_sandwich(rows, np.concatenate(groups), inverse) for groups in (places, sectors)]
    largest = max([*spreads, inverse], key=_of_center)  # never less than points that are one pixel off would leave
    agreement = max(_of_center(spread) for spread in spreads) / _of_center(inverse)
    covariance = largest[:size, :size]
    deviations = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    points = np.concatenate(residuals), np.concatenate(distances)
    return Certainty(covariance, deviations[:2], deviations[4:SHAPE], *points, agreement)


def _of_center(covariance: FloatArray) -> float:
    return float(np.trace(covariance[:2, :2]))


def _sandwich(rows: FloatArray, groups: FloatArray, inverse: FloatArray) -> FloatArray:
    _, index = np.unique(groups, return_inverse=True)
    sums = np.zeros((index.max() + 1, rows.shape[1]))
    np.add.at(sums, index, rows)
    count = len(sums)
    few = count / max(count - 1.0, 1.0)
    result: FloatArray = few * inverse @ (sums.T @ sums) @ inverse
    return result


def _cells(points: FloatArray) -> FloatArray:
    cells = np.clip(np.floor(points / _CELL_M), -500, 500).astype(np.int64)
    numbers: FloatArray = cells[:, 0] * 1001 + cells[:, 1]
    return numbers


def _on_field(points: FloatArray, pose: FloatArray) -> FloatArray:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    moved: FloatArray = points @ np.array([[c, s], [-s, c]]) + pose[:2]
    return moved
