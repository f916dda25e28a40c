"""A camera head as it is found out in play: what its mirror's errors may be, and how much it shakes.

The errors themselves are states of each hypothesis (`JointFilter`); what all hypotheses share is here.
"""

from __future__ import annotations

import math

import numpy as np

from touchline.camera import Camera, OmniCamera
from touchline.camera.uncertainty import USUAL_RANGE_RATIO, USUAL_TILT_DEG, CameraUncertainty
from touchline.field.distance_map import MapTable
from touchline.geometry import FloatArray, Pose
from touchline.localization.camera_errors.mirror_response import HEIGHT_M, mirror_response
from touchline.localization.estimator.joint_filter import JointFilter
from touchline.localization.estimator.joint_kernels import shown_of
from touchline.localization.registration.kernels import Plan
from touchline.localization.registration.mirror_kernels import StateFit, StatePrior, mean_distance, upright_points
from touchline.localization.registration.registration import SETTLED, SHAKEN, UNSETTLED, USUAL_NOISE, Head

VIBRATION_PER_M = 0.003  # standard deviation of g about its mean from image to image, at first: 0.06 degrees
MIN_VIBRATION_PER_M, MAX_VIBRATION_PER_M = 0.002, 0.02  # limits of what is learned of it
GAIN = 0.05  # share of a new image in what is learned
# by how much mirrors shift the ground about the robot beyond these errors, median of five shapes: per 1/m of g, per px
MISFIT_M2, MISFIT_M_PER_PX = 0.08, 0.0003
SETTLED_PER_M = 0.007  # standard deviation of an image's g below which its tilt is known beforehand: 0.15 degrees
MIN_NOISE, MAX_NOISE = 0.2, 10.0  # limits of what is learned of the points' noise
REPEATED = 2.6  # so many points err together: neighbours on a line, and the same place in the next image
UNTOLD = CameraUncertainty(USUAL_TILT_DEG, 0.0, USUAL_RANGE_RATIO)  # of a camera that nobody tells of
FEW = 20  # of so few points twice as many: the ends of a lone line tell most, and may be none


class MirrorHead:
    """`mirror`: what errors do to points. `unknown` (5, 5): covariance of the errors before the first image.

    shakes: whether each image leans anew, as it does in every robot that drives.
    """

    def __init__(self, camera: Camera | None) -> None:
        """camera: none where a detector of the robot's own says where points lie: its camera leans and shakes, too."""
        omni = camera if isinstance(camera, OmniCamera) else None
        self.shakes = True
        self.mirror = mirror_response(omni)
        self.unknown = self.stated(UNTOLD if omni is None else omni.uncertainty)
        self.reset()

    def reset(self) -> None:
        """Nothing has been seen yet."""
        self._shake(VIBRATION_PER_M if self.shakes else 0.0)
        self.noise = 1.0

    def _shake(self, per_m: float) -> None:
        """It shakes so much; `swing` (5, 5): covariance of what that adds to an image's errors."""
        self.vibration_per_m, self.swing = per_m, self._leaning(per_m)

    @staticmethod
    def _leaning(per_m: float) -> FloatArray:
        """Covariance (5, 5) of a lean of so much about the mirror's apex."""
        return np.diag(np.square([per_m, per_m, 0.0, 0.0, 0.0]))

    def stated(self, stated: CameraUncertainty) -> FloatArray:
        """Covariance (5, 5) of the errors as far as a camera.yaml is unsure."""
        aside, scale = stated.center_px**2, stated.range_ratio**2
        return self._leaning(2.0 * math.radians(stated.tilt_deg) / HEIGHT_M) + np.diag([0.0, 0.0, aside, aside, scale])

    def seeing(self, count: int) -> Head:
        """What fits of so many points are told of it."""
        return Head(self.mirror, self.noise * self._repeated(count))

    def plan_of(self, one: JointFilter) -> Plan:
        """How widely a hypothesis looks for the lines: lines far off lie near their places once the tilt is known."""
        if 2.0 * self.vibration_per_m**2 > SETTLED_PER_M**2:
            return SHAKEN
        tilt2 = float(np.trace(one.error_covariance[:2, :2] + self.swing[:2, :2]))
        return SETTLED if tilt2 < SETTLED_PER_M**2 else UNSETTLED

    def upright(self, positions_m: FloatArray, one: JointFilter) -> FloatArray:
        """Points (N, 2) without the errors that a hypothesis has found."""
        points: FloatArray = upright_points(np.ascontiguousarray(positions_m), one.errors, self.mirror)
        return points

    def mean_distance_m(self, positions_m: FloatArray, one: JointFilter, lines: MapTable, pose: Pose) -> float:
        """Of points (N, 2) from the lines at a pose (m), without the errors that a hypothesis has found."""
        return float(mean_distance(np.ascontiguousarray(positions_m), one.errors, self.mirror, lines, pose))

    def unseen(self, one: JointFilter) -> FloatArray:
        """Covariance (3, 3) of what a mirror does to every pose alike beyond these errors, in (m, m, rad)."""
        lean_x, lean_y, aside_u, aside_v, _ = one.errors.tolist()
        shift2 = MISFIT_M2**2 * (lean_x**2 + lean_y**2) + MISFIT_M_PER_PX**2 * (aside_u**2 + aside_v**2)
        covariance = np.zeros((3, 3))
        covariance[0, 0] = covariance[1, 1] = 0.5 * shift2
        return covariance

    @property
    def unforeseen(self) -> float:
        """By how much more it shakes than was assumed at first (>= 1): so much less the first images were worth."""
        return max(self.vibration_per_m / VIBRATION_PER_M, 1.0)

    def learn(self, fit: StateFit, expected: StatePrior, count: int) -> None:
        """What an image of so many points has told of the head's shaking and of the points' noise.

        expected: what the fit was given. Expectation maximisation: what this image's own lean is, and how unsure it
        still is, where the lines say little of it.
        """
        told, lean2 = shown_of(self.swing, expected.information, fit.information, fit.state - expected.mean)
        free = max(count / self._repeated(count), 1.0)
        free /= max(free - told, 0.25 * free)
        noise = min(max(free * fit.noise / USUAL_NOISE, MIN_NOISE), MAX_NOISE)
        self.noise += GAIN * (noise - self.noise)
        if self.shakes:
            variance = self.vibration_per_m**2 + GAIN * (lean2 - self.vibration_per_m**2)
            self._shake(min(max(math.sqrt(variance), MIN_VIBRATION_PER_M), MAX_VIBRATION_PER_M))

    @staticmethod
    def _repeated(count: int) -> float:
        """Of so many points one counts, where they err as they say."""
        return REPEATED * (1.0 + FEW / max(count, 1))
