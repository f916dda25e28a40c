"""What the bank believes, as it is published: the likeliest pose and the other hypotheses, twins among them."""

from collections.abc import Callable
from typing import NamedTuple

from touchline.geometry import FloatArray, Pose, mirrored_covariance
from touchline.localization.estimator.bank import Bank
from touchline.localization.estimator.exact_camera import ExactCamera
from touchline.localization.estimator.filter import Filter
from touchline.localization.registration.covariance import ANYWHERE
from touchline.types import Hypothesis


class Believed(NamedTuple):
    """The likeliest pose, its covariance (3, 3) in (m, m, rad), field frame, the residual of its last fit (m; nan
    without one), and the other hypotheses.
    """

    pose: Pose
    covariance: FloatArray
    residual_m: float
    others: list[Hypothesis]


def believed(bank: Bank, end_probability: float, exact: ExactCamera, at_stamp: Callable[[Filter], Filter]) -> Believed:
    """Of a bank whose pose is at its end of the field, not at its twin's, with a probability. at_stamp: propagates."""
    found = Believed(Pose(0.0, 0.0, 0.0), ANYWHERE, float("nan"), [])
    for one, probability in zip(bank.members, bank.probabilities, strict=True):
        now = at_stamp(one.filter)
        pose, covariance = exact.pose_of(now) if one is bank.best else (now.pose, now.covariance)
        covariance = covariance + bank.statistics.floor(now)
        off_m = float("nan") if one.fit is None else float(one.fit.residual_m)
        if one is bank.best:
            found = Believed(pose, covariance, off_m, found.others)
        else:
            found.others.append(Hypothesis(pose, off_m, probability * end_probability, covariance))
        if end_probability < 1.0:
            twin = probability * (1.0 - end_probability)
            found.others.append(Hypothesis(pose.mirrored(), off_m, twin, mirrored_covariance(covariance)))
    return found
