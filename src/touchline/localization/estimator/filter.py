"""Our filter: pose ⊕ odometry scales ⊕ image delay ⊕ camera errors, an error-state Kalman filter.

What comes again in every image is no noise: no number of images averages it out of the pose. As states, with their
correlations, such errors are learned where the lines show them, and leave the pose as unsure as they are where the
lines don't (consider states: Schmidt 1966).
"""

from __future__ import annotations

import math
from copy import copy
from typing import NamedTuple

import numpy as np

from touchline.errors import InputError
from touchline.geometry import FloatArray, IndexArray, Pose
from touchline.localization.estimator.filter_kernels import (
    DELAY,
    ERRORS,
    YAW_RATE,
    correct,
    expect,
    pose_innovation,
    predict,
    step_squares,
)
from touchline.localization.estimator.measurement import PoseEvidence
from touchline.localization.registration.joint import StateFit, StatePrior
from touchline.motion.delayed import Delayed
from touchline.motion.driven import Scales
from touchline.types import OdometryScales

SCALE_DRIFT = 0.001  # change of the odometry's scales in the root of a second: another carpet, wheels that wear
YAW_RATE_DRIFT = 0.0001  # of the odometry's drift of heading (rad/s) in the root of a second, as of a gyro's bias
DELAY_DRIFT_S = 0.001  # change of the delay in the root of a second: other loads of the computer
MAX_RECALLED_Z = 5.0  # standard deviations of its prior from which a recalled error is of another camera
_POSE, _SCALES = np.arange(3), np.arange(3, 6)
_NO_ERRORS = np.zeros((0, 0))


class InitialUncertainty(NamedTuple):
    """At first: standard deviations of the odometry's scales, of its drift of heading (rad/s), of how late images are
    stamped (s), and covariance (K, K) of the camera's errors; error_drift (K,) of these in the root of a second.

    learned: share of its step by an image that the errors take. With 1 it is a Kalman filter; with 0 they only leave
    the pose unsure (consider states); between, points that err together image after image teach less of what isn't
    there (Brink 2017, Partial-update Schmidt-Kalman filter).
    """

    scales: Scales
    errors: FloatArray
    error_drift: FloatArray
    learned: float
    yaw_rate_rad_s: float = 0.0
    delay_s: float = 0.0


class Filter:
    """`mean` (N,): the pose, where the last image was taken; three relative errors of the odometry's scales; its drift
    of heading (rad/s); how much later images are stamped than taken (s); errors (K,) of the camera. `joint` (N, N):
    their covariance. Both are new ones with every correction; a prediction moves the pose in `mean` in place.
    """

    def __init__(self, pose: Pose, covariance: FloatArray, initial: InitialUncertainty) -> None:
        """covariance (3, 3) of the pose, (m, m, rad), field frame."""
        count = ERRORS + len(initial.errors)
        self.pose, self.initial = pose, initial
        self.mean: FloatArray = np.zeros(count)
        self.mean[:3] = pose
        self.joint: FloatArray = np.zeros((count, count))
        self.joint[:3, :3] = covariance
        self.joint[_SCALES, _SCALES] = np.square(initial.scales)
        self.joint[YAW_RATE, YAW_RATE] = initial.yaw_rate_rad_s**2
        self.joint[DELAY, DELAY] = initial.delay_s**2
        self.joint[ERRORS:, ERRORS:] = initial.errors
        drift = np.array([*3 * [0.0], *3 * [SCALE_DRIFT], YAW_RATE_DRIFT, DELAY_DRIFT_S, *initial.error_drift])
        self._drift2 = np.where(np.diag(self.joint) > 0.0, drift, 0.0) ** 2
        self._learned = np.ones(count)
        self._learned[ERRORS:] = initial.learned
        self._measured = np.array([0, 1, 2, *range(ERRORS, count)])  # the states that a fit measures
        self._motion_noise = np.zeros((3, 3))  # that the motion since the last image has added

    @property
    def errors(self) -> FloatArray:
        """(K,) of the camera."""
        return self.mean[ERRORS:]

    @property
    def delay_s(self) -> float:
        """How much later images are stamped than taken."""
        return float(self.mean[DELAY])

    @property
    def covariance(self) -> FloatArray:
        """(3, 3) of the pose."""
        return self.joint[:3, :3]

    @property
    def error_covariance(self) -> FloatArray:
        """(K, K) of the camera's errors."""
        return self.joint[ERRORS:, ERRORS:]

    @property
    def odometry(self) -> OdometryScales:
        """What it has learned of the odometry."""
        return scales_of(self.mean, self.joint)

    @property
    def delay_deviation_s(self) -> float:
        """Standard deviation of `delay_s`."""
        return math.sqrt(self.joint[DELAY, DELAY])

    def placed(self, pose: Pose, covariance: FloatArray) -> Filter:
        """A filter that starts at another pose and keeps scales, delay and errors."""
        other = self._copy(pose)
        other.joint[:3], other.joint[:, :3], other.joint[:3, :3] = 0.0, 0.0, covariance
        other._motion_noise = np.zeros((3, 3))
        return other

    def recall(self, errors: FloatArray, covariance: FloatArray) -> None:
        """Take errors (K,) of the camera with their covariance (K, K), learned before. Raises InputError for others."""
        prior = self.initial.errors
        if covariance.shape != prior.shape or errors.shape != prior.shape[:1] or not np.isfinite(covariance).all():
            raise InputError(f"{len(errors)} learned errors of a camera that has {len(prior)}")
        if len(errors) and (np.abs(errors) > MAX_RECALLED_Z * np.sqrt(np.diag(prior))).any():
            raise InputError("learned errors beyond what camera.yaml leaves open: of another camera")
        self.mean[ERRORS:], self.joint[ERRORS:, ERRORS:] = errors, covariance

    def mirrored(self) -> Filter:
        """The filter of the other end of a symmetric field."""
        other = self._copy(self.pose.mirrored())
        turn = np.ones(len(self.joint))
        turn[:2] = -1.0
        other.joint = self.joint * np.outer(turn, turn)
        return other

    def loosened(self, more: FloatArray) -> Filter:
        """A copy with a covariance (3, 3) added to that of its pose."""
        other = self._copy(self.pose)
        other.joint[:3, :3] += more
        return other

    def take_delay(self, delay_s: float, deviation_s: float) -> None:
        """Take a delay that another measurement than the odometry has given."""
        self.mean[DELAY] = delay_s
        self.joint[DELAY, :] = self.joint[:, DELAY] = 0.0
        self.joint[DELAY, DELAY] = deviation_s**2
        if self._drift2[DELAY]:
            self._drift2 = self._drift2.copy()  # that of others, too
            self._drift2[DELAY] = 0.0

    def _copy(self, pose: Pose) -> Filter:
        other = copy(self)
        other.pose, other.mean, other.joint = pose, self.mean.copy(), self.joint.copy()
        other.mean[:3], other._motion_noise = pose, self._motion_noise.copy()
        return other

    def predict(self, moved: Delayed, seconds: float, noise: FloatArray | None = None) -> None:
        """Move by the odometry over so many seconds. noise (3, 3): of the motion, robot frame before it; None: its
        own covariance.
        """
        motion, joint = moved.motion, np.empty_like(self.joint)
        noise = motion.covariance if noise is None else noise
        known, spans = (self.mean, self.joint, self._drift2), (seconds, moved.late_s)
        self.pose = Pose(*predict(known, motion.pose, moved.by_delay, noise, spans, self._motion_noise, joint))
        self.joint = joint

    def ahead(self, moved: Delayed) -> Filter:
        """A copy after a motion."""
        other = self._copy(self.pose)
        other.predict(moved, 0.0)
        return other

    def prior(self, per_image: FloatArray, stamp_shift: FloatArray | None = None) -> StatePrior:
        """What it expects of an image's pose and errors. per_image (K, K): covariance of what the image's own errors
        differ by; stamp_shift (3,): standard deviation of how far its pose lies off, field frame.
        """
        joint, size = self.joint, len(self._measured)
        if stamp_shift is not None:
            joint = joint.copy()
            joint[:3, :3] += np.outer(stamp_shift, stamp_shift)
        expected = StatePrior(np.empty(size), np.empty((size, size)))
        expect(self.mean, joint, self._measured, per_image, *expected)
        return expected

    def innovation(self, fit: StateFit, per_image: FloatArray) -> tuple[tuple[float, float, float], float]:
        """How far the pose by the image alone lies from the prediction, and its squared Mahalanobis distance."""
        return pose_innovation(self.mean, self.joint, self._measured, per_image, fit[:3])

    def correct(self, fit: StateFit, per_image: FloatArray) -> None:
        """Kalman update by a fit whose prior it was: information about all that it measures."""
        self._correct(self._measured, per_image, fit[:3])
        self._motion_noise = np.zeros((3, 3))

    def distance2_to(self, evidence: PoseEvidence) -> float:
        """Squared Mahalanobis distance of the pose by another measurement from the prediction."""
        return pose_innovation(self.mean, self.joint, _POSE, _NO_ERRORS, (self.mean[:3], *evidence[:2]))[1]

    def correct_pose(self, evidence: PoseEvidence) -> None:
        """Kalman update by another measurement than an image."""
        self._correct(_POSE, _NO_ERRORS, (self.mean[:3], *evidence[:2]))

    def _correct(
        self, measured: IndexArray, per_image: FloatArray, seen: tuple[FloatArray, FloatArray, FloatArray]
    ) -> None:
        out = np.empty_like(self.mean), np.empty_like(self.joint)
        self.pose = Pose(*correct(self.mean, self.joint, measured, per_image, seen, self._learned, out))
        self.mean, self.joint = out

    def motion_error(self, fit: StateFit, per_image: FloatArray) -> tuple[list[float], list[float]]:
        """Expected squared errors (x, y, heading) of the motion since the last image, by a fit before `correct`, and
        the variances that it was expected to have; field frame.
        """
        squares = step_squares(self.mean, self.joint, self._measured, per_image, fit[:3], self._motion_noise)
        return squares, self._motion_noise.diagonal().tolist()


def scales_of(mean: FloatArray, joint: FloatArray) -> OdometryScales:
    """What is known of the odometry by the mean and the covariance of a filter."""
    ahead, aside, turn = mean[3:6].tolist()
    deviations = [math.sqrt(variance) for variance in joint.diagonal()[3:6].tolist()]
    return OdometryScales((ahead, aside, turn), (deviations[0], deviations[1], deviations[2]))
