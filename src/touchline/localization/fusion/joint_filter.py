"""Kalman filter of the pose, the odometry's scales and the errors of the camera's mirror, which are the same in every
image of a head.

What comes again in every image is no noise: no number of images averages it out of the pose. As states, with their
correlations, such errors are learned where the lines show them, and leave the pose as unsure as they are where the
lines don't (consider states: Schmidt 1966).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.localization.fusion.joint_kernels import carried, correction_of, expected_information, innovation_of
from touchline.localization.fusion.pose_filter import SCALE_DRIFT, Scales, driven
from touchline.localization.matching.mirror_fit import ERRORS
from touchline.localization.registration.mirror_kernels import StateFit, StatePrior

ERROR_DRIFT = 0.003  # drift of the errors per image, as a share of what was unknown at first: a loosening mount
_STATES = 6 + ERRORS
_SCALES = np.arange(3, 6)
_ERRORS = np.arange(6, _STATES)
_SEEN = np.array([0, 1, 2, *_ERRORS])  # the states that a fit measures


class Unknown(NamedTuple):
    """At first: standard deviations of the odometry's scales, and covariance (5, 5) of the mirror's errors.

    learned: share of its step by an image that the errors take. With 1 it is a Kalman filter; with 0 they only leave
    the pose unsure (consider states); between, points that err together image after image teach less of what isn't
    there (Brink 2017, Partial-update Schmidt-Kalman filter).
    """

    scales: Scales
    errors: FloatArray
    learned: float


class JointFilter:
    """`pose`; `scales` (3,), relative errors of the odometry; `errors` (5,) of the mirror, see `mirror_fit`."""

    def __init__(self, pose: Pose, covariance: FloatArray, unknown: Unknown) -> None:
        """covariance (3, 3) of the pose, (m, m, rad), field frame."""
        self.pose = pose
        self.unknown = unknown
        self.scales, self.errors = np.zeros(3), np.zeros(ERRORS)
        self._joint = np.zeros((_STATES, _STATES))
        self._joint[:3, :3] = covariance
        self._joint[_SCALES, _SCALES] = np.square(unknown.scales)
        self._joint[6:, 6:] = unknown.errors
        self._drift = np.zeros(_STATES)
        self._drift[_SCALES] = [SCALE_DRIFT**2 if scale > 0.0 else 0.0 for scale in unknown.scales]
        self._drift[_ERRORS] = ERROR_DRIFT**2 * np.diag(unknown.errors)
        self._moving = np.ones(_STATES)
        self._moving[_ERRORS] = unknown.learned

    @property
    def covariance(self) -> FloatArray:
        """(3, 3) of the pose."""
        return self._joint[:3, :3]

    @property
    def error_covariance(self) -> FloatArray:
        """(5, 5) of the mirror's errors."""
        return self._joint[6:, 6:]

    @property
    def error_crossed(self) -> FloatArray:
        """(3, 5) of the pose with the mirror's errors."""
        return self._joint[:3, 6:]

    def placed(self, pose: Pose, covariance: FloatArray) -> JointFilter:
        """A filter that starts at another pose, and still knows scales and errors."""
        other = JointFilter(pose, covariance, self.unknown)
        other.scales, other.errors = self.scales.copy(), self.errors.copy()
        other._joint[3:, 3:] = self._joint[3:, 3:]
        return other

    def mirrored(self) -> JointFilter:
        """The filter of the other end of a symmetric field."""
        other = self.placed(self.pose.mirrored(), self.covariance)
        turn = np.ones(_STATES)
        turn[:2] = -1.0
        other._joint = self._joint * np.outer(turn, turn)
        return other

    def loosened(self, more: FloatArray) -> JointFilter:
        """A copy whose pose is less sure by a covariance (3, 3)."""
        other = self.placed(self.pose, self.covariance)
        other._joint = self._joint.copy()
        other._joint[:3, :3] += more
        return other

    def predict(self, motion: Pose, motion_covariance: FloatArray) -> None:
        """Move by the odometry: motion is `before_from_after`, its covariance (3, 3) in the robot frame before it."""
        step = driven(self.pose, self.scales, motion)
        self.pose = step.pose
        more = step.by_motion @ motion_covariance @ step.by_motion.T
        self._joint = carried(self._joint, step.by_state, more, self._drift)

    def prior(self, swing: FloatArray) -> StatePrior:
        """What it expects of an image's pose and errors; swing (5, 5): covariance of what shaking adds."""
        return StatePrior(self._seen(), expected_information(self._joint, _SEEN, swing))

    def innovation(self, fit: StateFit, swing: FloatArray) -> tuple[FloatArray, float]:
        """How far the pose by the lines alone lies from the prediction (3,), and its squared Mahalanobis distance."""
        away, distance2 = innovation_of(self._joint, _SEEN, swing, fit.information, fit.gradient, self._away(fit))
        return away, distance2

    def correct(self, fit: StateFit, swing: FloatArray) -> None:
        """Kalman update by a fit whose prior it was: the fit's points as information about all that it measures."""
        step, self._joint = correction_of(
            self._joint, _SEEN, swing, fit.information, fit.gradient, self._away(fit), self._moving
        )
        x, y, heading = step[:3].tolist()
        self.pose = Pose(self.pose.x + x, self.pose.y + y, wrap_angle(self.pose.heading + heading))
        self.scales, self.errors = self.scales + step[_SCALES], self.errors + step[_ERRORS]

    def _seen(self) -> FloatArray:
        return np.array([*self.pose, *self.errors.tolist()])

    def _away(self, fit: StateFit) -> FloatArray:
        """(8,) from what is expected to a fit."""
        away = fit.state - self._seen()
        away[2] = wrap_angle(float(away[2]))
        return away
