"""What a mirror differs by from its camera.yaml, learned beside a pose that a system finds in its own way.

The errors g (1/m: lean), c (px: displacement) and s (ranges too short by a share) are those of `camera_errors`. They
are the same in every image of a camera, so no number of images averages them out of the pose; but lines that should be
straight, parallel and in their places show them next to it. Each image's lean differs from the head's, too, as the head
shakes. Pose and errors are registered jointly; a Kalman filter keeps the mean of the errors over the images.
"""

import math
from typing import NamedTuple

import numpy as np

from touchline.camera import Camera
from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose
from touchline.localization.camera_errors.base import placed_points
from touchline.localization.camera_errors.mirror import mirror_errors
from touchline.localization.camera_errors.mirror_response import HEIGHT_M
from touchline.localization.registration.covariance import widest_m
from touchline.localization.registration.joint import StatePrior
from touchline.localization.registration.kernels import Plan
from touchline.localization.registration.registration import SETTLED, SHAKEN, UNSETTLED, USUAL_NOISE, Registration
from touchline.localization.registration.seen import seen_points
from touchline.types import LinePoints

ERRORS = 5
UNKNOWN_PER_M = 0.015  # standard deviation of g of a mirror 0.3 degrees off: what is known better is settled
DRIFT = 0.003  # drift of the mean per image, as a share of what was unknown at first: a loosening mount
MIN_NOISE, MAX_NOISE = 0.2, 25.0  # limits of what is learned of the points' noise
GAIN = 0.05  # share of a new image in either
REPEATED_POINTS, REPEATED_IMAGES = 2.0, 3.0  # so many err together: neighbours on a line, and the same place seen again
LOOSE = np.array([0.2, 0.2, 0.1])  # how far the pose may be off (m, m, rad): what unknown errors may have shifted it
SETTLED_PER_M = 0.007  # standard deviation of an image's g below which its tilt is known beforehand: 0.15 degrees
_EXACT2 = 1e-14  # variance of an error that is known exactly


class Expected(NamedTuple):
    """Where the robot should be by what is known beside the image: pose (3,) and covariance (3, 3) (m, m, rad)."""

    pose: FloatArray
    covariance: FloatArray


class ImageFit(NamedTuple):
    """Pose and mirror errors that suit one image best.

    pose (3,): by the lines alone, these errors (5,) taken out. covariance (8, 8): of both, with what was known before.
    information (5, 5), vector (5,): what the image alone shows of the errors. lever (3, 5): derivative of the pose by
    errors that are not taken out, field frame. own (5, 5): how unsure the image's own errors are where the head's are
    known. of_pose (3, 3): what the image shows of the pose, the errors as unsure as before. noise: mean square of
    the residuals in units of the points' noise. left_m: standard deviation of the position along its least known
    direction if the errors are right.
    """

    pose: FloatArray
    errors: FloatArray
    covariance: FloatArray
    information: FloatArray
    vector: FloatArray
    lever: FloatArray
    own: FloatArray
    of_pose: FloatArray
    noise: float
    left_m: float


class LearnedMirror:
    """`mean` (5,): errors of the mirror as learned so far; `covariance` (5, 5). `correction` (5,): those that are taken
    off the points, none until the lines contradict camera.yaml beyond doubt.

    `noise`: how much larger the points' variances are than stated; `vibration_per_m`: by how much (standard deviation)
    a shaking head turns g in each image; `fit`: the last one learned from.
    """

    def __init__(
        self,
        field: FieldModel,
        camera: Camera | None = None,
        enabled: bool = True,
        looked_for: tuple[bool, bool] = (True, True),
        height_m: float = HEIGHT_M,
    ) -> None:
        """enabled: False takes camera.yaml for exact. looked_for: displacement, and scale of the ranges,
        beside the tilt. height_m: of the mirror.
        """
        self.enabled, self.field = enabled, field
        self._registration = Registration(field.distance_map())
        self.errors = mirror_errors(camera)
        self._mirror, self._unknown = self.errors.response()._replace(height_m=height_m), self.errors.prior
        displaced, scaled = looked_for
        which = np.array([True, True, displaced, displaced, scaled]) & enabled
        self._which = which & (np.diag(self._unknown) > 0.0)
        self._open = np.outer(self._which, self._which).astype(np.float64)
        self._not_looked_for = self._unknown * (1.0 - self._open) * enabled
        self.reset()

    def reset(self) -> None:
        """Nothing has been seen yet."""
        self.mean, self.correction = np.zeros(ERRORS), np.zeros(ERRORS)
        self.covariance: FloatArray = self._unknown * self._open
        self.vibration_per_m, self.noise = self.errors.lean.first if self.enabled else 0.0, 1.0
        self.fit: ImageFit | None = None

    @property
    def settled(self) -> bool:
        """Whether so much is known that points can be judged without fitting the errors to them."""
        return float(np.trace(self.covariance[:2, :2])) < 0.2 * UNKNOWN_PER_M**2

    @property
    def per_image(self) -> FloatArray:
        """Covariance (5, 5) of what one image's errors differ by from the camera's: its head shakes."""
        return np.diag([self.vibration_per_m**2, self.vibration_per_m**2, 0.0, 0.0, 0.0])

    def corrected(self, positions_m: FloatArray, errors: FloatArray | None = None) -> FloatArray:
        """Points (N, 2) as a perfect mirror would have seen them; without `correction`, or errors (5,) given."""
        if errors is None and not self.enabled:
            return np.ascontiguousarray(positions_m)
        chosen = self.correction if errors is None else errors
        return placed_points(np.ascontiguousarray(positions_m), chosen, self._mirror)

    @property
    def misfit(self) -> FloatArray:
        """Covariance (3, 3) of what a mirror does to every pose alike beyond the errors looked for, in (m, m, rad)."""
        shift2 = 0.5 * float(((np.array(self.errors.misfit) * self.correction) ** 2).sum())
        shift = np.diag([shift2, shift2, 0.0])
        return shift if self.fit is None else shift + self.fit.lever @ self._not_looked_for @ self.fit.lever.T

    @property
    def unseen(self) -> FloatArray:
        """Covariance (3, 3) of what the errors do to every pose alike, in (m, m, rad): no number of images shows it."""
        if self.fit is None:
            return np.zeros((3, 3))
        left = self.mean - self.correction
        shared: FloatArray = self.fit.lever @ (self.covariance + np.outer(left, left)) @ self.fit.lever.T
        return shared + self.misfit

    @property
    def shaken(self) -> FloatArray:
        """Covariance (3, 3) of what a shaking head leaves in the pose of one image, as `unseen`."""
        if self.fit is None:
            return np.zeros((3, 3))
        return self.fit.lever @ self.fit.own @ self.fit.lever.T

    def fit_to(self, points: LinePoints, pose: FloatArray, expected: Expected | None = None) -> ImageFit | None:
        """An image's pose and errors, from points as seen and a pose (3,) that is close; None if nothing suits.

        expected: where the robot should be; what the lines leave open between pose and errors is decided by it.
        """
        place = expected or Expected(pose, np.diag(np.square(LOOSE)))
        spread, mean = self.covariance + self.per_image, np.array([*place.pose, *self.correction])
        information = np.zeros((8, 8))
        information[:3, :3] = np.linalg.inv(place.covariance)
        information[3:, 3:] = np.linalg.inv(spread + _EXACT2 * np.eye(ERRORS))
        start = np.array([*pose, *self.correction])
        seen, prior = seen_points(points, 1.0 / (REPEATED_POINTS * self.noise)), StatePrior(mean, information)
        found = self._registration.fit_state(seen, start, prior, self._plan(spread), self._mirror)
        if not math.isfinite(found.state.sum() + found.information.sum()):
            return None
        state, said, matrix, loose = found.state, found.gradient, found.information, np.diag(LOOSE**-2.0)
        own = np.linalg.inv(matrix[:3, :3] + loose)
        lever = -own @ matrix[:3, 3:]
        pull = said[:3] + loose @ (pose - state[:3])
        alone = matrix[3:, 3:] + matrix[3:, :3] @ lever
        vector = said[3:] + lever.T @ pull + alone @ state[3:]
        unsure = np.linalg.inv(matrix[3:, 3:] + information[3:, 3:])
        of_pose = matrix[:3, :3] - matrix[:3, 3:] @ unsure @ matrix[3:, :3]
        shaking = self.per_image @ np.linalg.inv(np.eye(ERRORS) + alone @ self.per_image)
        covariance = np.linalg.inv(matrix + information)
        free = state[:3] + own @ pull  # the pose that the lines want with these errors, whatever is expected
        return ImageFit(
            free,
            state[3:],
            covariance,
            alone,
            vector,
            lever,
            shaking,
            of_pose,
            found.noise / USUAL_NOISE,
            widest_m(own),
        )

    def _plan(self, spread: FloatArray) -> Plan:
        if 2.0 * self.vibration_per_m**2 > SETTLED_PER_M**2:
            return SHAKEN
        return SETTLED if float(np.trace(spread[:2, :2])) < SETTLED_PER_M**2 else UNSETTLED

    def learn(self, fit: ImageFit) -> None:
        """Learn the camera's errors, its shaking and the points' noise from an image."""
        self.noise += GAIN * (min(max(fit.noise, MIN_NOISE), MAX_NOISE) - self.noise)
        self.fit = fit
        if not self.enabled:
            return
        deviation = fit.errors[:2] - self.correction[:2]
        seen = 0.5 * (float(deviation @ deviation) + fit.own[0, 0] + fit.own[1, 1])
        variance = self.vibration_per_m**2 + GAIN * (seen - self.vibration_per_m**2)
        share = np.linalg.inv(REPEATED_IMAGES * np.eye(ERRORS) + fit.information @ self.per_image)
        self.vibration_per_m = min(max(math.sqrt(variance), self.errors.lean.min), self.errors.lean.max)
        gain = self.covariance @ np.linalg.inv(np.eye(ERRORS) + share @ fit.information @ self.covariance)
        self.mean = self.mean + gain @ (share @ (fit.vector - fit.information @ self.mean))
        drift = np.diag(np.square(DRIFT) * np.diag(self._unknown))
        self.covariance = (0.5 * (gain + gain.T) + drift) * self._open
        self.correction = self._ratio_wrong() * self.mean

    def leave_open(self, fit: ImageFit) -> None:
        """An image that shows nothing of its errors: they may be as large as the head's shaking makes them."""
        self.fit = fit._replace(own=self.per_image)

    def update(self, points: LinePoints, pose: Pose) -> ImageFit | None:
        """`fit_to`, and `learn` if there is a fit."""
        fit = self.fit_to(points, pose.as_array())
        if fit is not None:
            self.learn(fit)
        return fit

    def _ratio_wrong(self) -> float:
        """How probable it is that the camera is wrong, as far as is stated, rather than right: Bayes factor of both.

        A camera.yaml that is exact would else be spoilt by what the detector errs by.
        """
        which = self._which
        if not which.any():
            return 0.0
        mean, spread = self.mean[which], self.covariance[np.ix_(which, which)]
        stated = self._unknown[np.ix_(which, which)]
        narrower = float(np.linalg.slogdet(stated)[1] - np.linalg.slogdet(spread)[1])
        odds = 0.5 * (narrower - float(mean @ np.linalg.solve(spread, mean)))
        return 1.0 / (1.0 + math.exp(min(odds, 50.0)))
