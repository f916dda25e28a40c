"""Kalman filter of the pose, the odometry's scales, how late images are stamped, and the errors of the camera's mirror,
which are the same in every image of a head.

What comes again in every image is no noise: no number of images averages it out of the pose. As states, with their
correlations, such errors are learned where the lines show them, and leave the pose as unsure as they are where the
lines don't (consider states: Schmidt 1966).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.localization.estimator.joint_kernels import carried, correction_of, expected_information, innovation_of
from touchline.localization.published.nubot.mirror_fit import ERRORS
from touchline.localization.registration.mirror_kernels import StateFit, StatePrior
from touchline.motion.delayed import Delayed
from touchline.motion.driven import SCALE_DRIFT, Scales, driven
from touchline.types import OdometryScales

ERROR_DRIFT = 0.003  # drift of the errors per image, as a share of what was unknown at first: a loosening mount
DELAY_DRIFT_S = 0.0003  # change of the delay from image to image: other loads of the computer
MIN_DELAY_S, MAX_DELAY_S = -0.1, 0.4  # that are looked for
_STATES = 7 + ERRORS
_SCALES = np.arange(3, 6)
_DELAY = 6
_ERRORS = np.arange(7, _STATES)
_SEEN = np.array([0, 1, 2, *_ERRORS])  # the states that a fit measures


class Unknown(NamedTuple):
    """At first: standard deviations of the odometry's scales, and covariance (5, 5) of the mirror's errors.

    learned: share of its step by an image that the errors take. With 1 it is a Kalman filter; with 0 they only leave
    the pose unsure (consider states); between, points that err together image after image teach less of what isn't
    there (Brink 2017, Partial-update Schmidt-Kalman filter). delay_s: standard deviation of how late images are
    stamped.
    """

    scales: Scales
    errors: FloatArray
    learned: float
    delay_s: float = 0.0


class JointFilter:
    """`pose`, where the last image was taken; `scales` (3,), relative errors of the odometry; `late_s`: how much later
    images are stamped than taken; `errors` (5,) of the mirror, see `mirror_fit`.
    """

    def __init__(self, pose: Pose, covariance: FloatArray, unknown: Unknown) -> None:
        """covariance (3, 3) of the pose, (m, m, rad), field frame."""
        self.pose = pose
        self.unknown = unknown
        self.scales, self.late_s, self.errors = np.zeros(3), 0.0, np.zeros(ERRORS)
        self._joint = np.zeros((_STATES, _STATES))
        self._joint[:3, :3] = covariance
        self._joint[_SCALES, _SCALES] = np.square(unknown.scales)
        self._joint[_DELAY, _DELAY] = unknown.delay_s**2
        self._joint[7:, 7:] = unknown.errors
        self._drift = np.zeros(_STATES)
        self._drift[_SCALES] = [SCALE_DRIFT**2 if scale > 0.0 else 0.0 for scale in unknown.scales]
        self._drift[_DELAY] = DELAY_DRIFT_S**2 if unknown.delay_s > 0.0 else 0.0
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
        return self._joint[7:, 7:]

    @property
    def odometry(self) -> OdometryScales:
        """What it has learned of the odometry."""
        ahead, aside, turn = self.scales.tolist()
        deviations = [math.sqrt(variance) for variance in np.diagonal(self._joint)[3:6].tolist()]
        return OdometryScales((ahead, aside, turn), (deviations[0], deviations[1], deviations[2]))

    @property
    def delay_deviation_s(self) -> float:
        """Standard deviation of `late_s`."""
        return math.sqrt(self._joint[_DELAY, _DELAY])

    @property
    def error_crossed(self) -> FloatArray:
        """(3, 5) of the pose with the mirror's errors."""
        return self._joint[:3, 7:]

    def placed(self, pose: Pose, covariance: FloatArray) -> JointFilter:
        """A filter that starts at another pose, and still knows scales, delay and errors."""
        other = JointFilter(pose, covariance, self.unknown)
        other.scales, other.late_s, other.errors = self.scales.copy(), self.late_s, self.errors.copy()
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

    def predict(self, moved: Delayed) -> None:
        """Move by the odometry."""
        step, more = driven(self.pose, self.scales, moved.motion.pose), moved.motion.covariance
        by_state = np.eye(7)
        by_state[:6, :6] = step.by_state
        by_state[:3, _DELAY] = step.by_motion @ moved.by_delay
        x, y, turn = ((self.late_s - moved.late_s) * by_state[:3, _DELAY]).tolist()
        self.pose = Pose(step.pose.x + x, step.pose.y + y, wrap_angle(step.pose.heading + turn))
        self._joint = carried(self._joint, by_state, step.by_motion @ more @ step.by_motion.T, self._drift)

    def ahead(self, moved: Delayed) -> JointFilter:
        """A copy after a motion."""
        other = self.placed(self.pose, self.covariance)
        other._joint = self._joint
        other.predict(moved)
        return other

    def prior(self, swing: FloatArray, wander: FloatArray | None = None) -> StatePrior:
        """What it expects of an image's pose and errors; swing (5, 5): covariance of what shaking adds; wander (3,):
        standard deviation of how far the image's pose lies off, field frame.
        """
        joint = self._joint
        if wander is not None:
            joint = joint.copy()
            joint[:3, :3] += np.outer(wander, wander)
        return StatePrior(self._seen(), expected_information(joint, _SEEN, swing))

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
        self.late_s = min(max(self.late_s + float(step[_DELAY]), MIN_DELAY_S), MAX_DELAY_S)

    def _seen(self) -> FloatArray:
        return np.array([*self.pose, *self.errors.tolist()])

    def _away(self, fit: StateFit) -> FloatArray:
        """(8,) from what is expected to a fit."""
        away = fit.state - self._seen()
        away[2] = wrap_angle(float(away[2]))
        return away
