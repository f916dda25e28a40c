"""What the bank believes, as it is published: the likeliest pose and the other hypotheses, twins among them."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

from touchline.geometry import FloatArray, Pose, mirrored_covariance
from touchline.localization.estimator.bank import Bank
from touchline.localization.estimator.exact_camera import ExactCamera
from touchline.localization.estimator.filter import Filter
from touchline.localization.registration.covariance import ANYWHERE
from touchline.types import Hypothesis


class Believed(NamedTuple):
    """The likeliest pose, its covariance (3, 3) in (m, m, rad), field frame, the residual of its last fit (m; nan
    without one), and what makes the other hypotheses.
    """

    pose: Pose
    covariance: FloatArray
    residual_m: float
    others: Callable[[], tuple[Hypothesis, ...]]


class _Followed(NamedTuple):
    """What the bank follows, as it is published; probability: of it or its twin."""

    pose: Pose
    covariance: FloatArray
    residual_m: float
    probability: float


def believed(bank: Bank, end_probability: float, exact: ExactCamera, at_stamp: Callable[[Filter], Filter]) -> Believed:
    """Of a bank whose pose is at its end of the field, not at its twin's, with a probability. at_stamp: propagates."""
    followed: list[_Followed] = []
    for one, probability in zip(bank.members, bank.probabilities, strict=True):
        now = at_stamp(one.filter)
        pose, covariance = (now.pose, now.covariance) if followed else exact.pose_of(now)
        off_m = float("nan") if one.fit is None else one.fit.residual_m
        followed.append(_Followed(pose, covariance + bank.statistics.floor(now), off_m, probability))
    best = followed[0] if followed else _Followed(Pose(0.0, 0.0, 0.0), ANYWHERE, float("nan"), 1.0)
    return Believed(*best[:3], partial(_others, followed, end_probability))


def _others(followed: Sequence[_Followed], end_probability: float) -> tuple[Hypothesis, ...]:
    """All but the likeliest, which is the first, and the twins of all where the end of the field is not certain."""
    found: list[Hypothesis] = []
    for k, (pose, covariance, off_m, probability) in enumerate(followed):
        if k:
            found.append(Hypothesis(pose, off_m, probability * end_probability, covariance))
        if end_probability < 1.0:
            twin = probability * (1.0 - end_probability)
            found.append(Hypothesis(pose.mirrored(), off_m, twin, mirrored_covariance(covariance)))
    return tuple(found)
