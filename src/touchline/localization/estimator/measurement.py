"""Another measurement of the pose than the camera's: one file that gives information and gradient.

A measurement compares the reading of a sensor with the prediction of a pose. It corrects every hypothesis and adds its
log-likelihood to the hypothesis's log-odds; one that contradicts a prediction corrects nothing there.
`Frame.measurements` brings the readings of sensors that `Frame` does not name; `measurements.py` is the table.
"""

import math
from collections.abc import Iterable
from typing import NamedTuple, Protocol

import numpy as np

from touchline.geometry import FloatArray, Pose
from touchline.types import Frame

CLUTTER = math.exp(-6.0)  # likelihood of a false measurement beside that of a right one at its best


class PoseEvidence(NamedTuple):
    """Of a measurement at a pose of x, y (m), heading (rad), field frame: information (3, 3), inverse covariance;
    gradient (3,) of its log-likelihood by the pose; the log-likelihood, 0 at best.
    """

    information: FloatArray
    gradient: FloatArray
    log_likelihood: float


class Measurement(Protocol):
    """A further measurement, valid with every kind of camera."""

    def of(self, frame: Frame, pose: Pose) -> PoseEvidence | None:
        """The evidence for a pose, field frame, of a frame's reading; None where it brings none."""
        ...


def scalar_evidence(residual: float, by_pose: FloatArray, sigma: float) -> PoseEvidence:
    """Of one number. residual: measured less predicted; by_pose (3,): derivative of the prediction by the pose; sigma:
    standard deviation of the measurement.
    """
    weighted = by_pose / sigma**2
    likelihood = math.exp(-0.5 * (residual / sigma) ** 2)
    return PoseEvidence(np.outer(by_pose, weighted), residual * weighted, math.log(CLUTTER + likelihood))


def summed_evidence(each: Iterable[PoseEvidence]) -> PoseEvidence | None:
    """Of independent measurements, as the points of one scan; None of none."""
    found = list(each)
    if not found:
        return None
    return PoseEvidence(
        np.sum([one.information for one in found], axis=0),
        np.sum([one.gradient for one in found], axis=0),
        sum(one.log_likelihood for one in found),
    )
