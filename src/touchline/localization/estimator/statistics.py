"""Statistics of camera errors beside their mean: how much each image leans anew, and how much points err.

The errors themselves are states of each hypothesis (`Filter`); what all hypotheses share is here.
"""

import math

import numpy as np

from touchline.geometry import FloatArray
from touchline.localization.camera_errors.base import CameraErrors
from touchline.localization.estimator.filter import Filter
from touchline.localization.estimator.filter_kernels import degrees_of_freedom_and_lean
from touchline.localization.registration.joint import Seen, StateFit, StatePrior
from touchline.localization.registration.kernels import Plan
from touchline.localization.registration.registration import SETTLED, SHAKEN, UNSETTLED, USUAL_NOISE

GAIN = 0.05  # share of a new image in what is learned
SETTLED_PER_M = 0.007  # standard deviation of an image's lean below which it is known beforehand: 0.15° of a mirror
MAX_NOISE = 10.0  # of the points, as a multiple of the variances that they state


class CameraErrorStatistics:
    """`noise`: ratio of the variances of points to those that they state; `per_image` (K, K): covariance of what
    the errors of one image differ by from the camera's.
    """

    def __init__(self, errors: CameraErrors) -> None:
        self.errors, self._own = errors, np.zeros(errors.prior.shape)
        self._own[0, 0] = self._own[1, 1] = 1.0
        self.reset()

    def reset(self) -> None:
        """Nothing has been seen yet."""
        self.noise = 1.0
        self._lean(self.errors.lean.first)

    def _lean(self, deviation: float) -> None:
        self.lean, self.per_image = deviation, deviation**2 * self._own

    @property
    def lean_ratio(self) -> float:
        """By how much more it leans than was assumed at first (>= 1): so much less the first images were worth."""
        first = self.errors.lean.first
        return max(self.lean / first, 1.0) if first > 0.0 else 1.0

    def plan_of(self, one: Filter) -> Plan:
        """How widely a hypothesis looks for the lines: lines far off lie near their places once the lean is known."""
        per_m = self.errors.lean.per_m
        if 2.0 * (per_m * self.lean) ** 2 > SETTLED_PER_M**2:
            return SHAKEN
        errors, lean2 = one.error_covariance, self.lean**2
        tilt2 = per_m**2 * ((float(errors[0, 0]) + lean2) + (float(errors[1, 1]) + lean2))
        return SETTLED if tilt2 < SETTLED_PER_M**2 else UNSETTLED

    def floor(self, one: Filter) -> FloatArray:
        """Covariance (3, 3) of every pose that no image lowers, in (m, m, rad)."""
        x, y, heading = self.errors.floor
        shifts = [misfit * error for misfit, error in zip(self.errors.misfit, one.errors.tolist(), strict=True)]
        shift2, floor = 0.5 * sum([shift * shift for shift in shifts]), np.zeros((3, 3))
        floor[0, 0], floor[1, 1], floor[2, 2] = x * x + shift2, y * y + shift2, heading * heading
        return floor

    def learn(self, fit: StateFit, expected: StatePrior, seen: Seen) -> None:
        """Learn the lean of single images and the points' noise from an image. expected: the prior of its fit.

        Expectation maximisation: this image's own lean, and its remaining variance where the lines show little of it.
        """
        freedom, lean2 = degrees_of_freedom_and_lean(
            self.per_image, expected.information, fit.information, fit.state - expected.mean
        )
        # points, where they err as they state
        free = max(float(np.add.reduce(seen.shares)) * self.noise / seen.noise, 1.0)
        free /= max(free - freedom, 0.25 * free)
        noise = min(max(free * fit.noise / USUAL_NOISE, self.errors.trust.min_noise), MAX_NOISE)
        self.noise += GAIN * (noise - self.noise)
        lean = self.errors.lean
        if lean.max > 0.0:
            variance = self.lean**2 + GAIN * (lean2 - self.lean**2)
            self._lean(min(max(math.sqrt(variance), lean.min), lean.max))
