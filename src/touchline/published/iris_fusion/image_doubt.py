"""What one image says of the mirror, and how unsure the particles' pose is beside what they agree on.

Ismail et al. 2021 know no errors of the camera and no covariance of an image; both are ours.
"""

from typing import NamedTuple

import numpy as np

from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.localization.registration.learned_mirror import ImageFit, LearnedMirror
from touchline.types import LinePoints

LEFT_M = 0.02  # deviation that the lines leave the position, up to which an image tells of the camera
# how far the pose that an image wants may be off the expected one for its own errors to be believed: more than wheels
# and gyro miss from image to image
CLOSE_M, CLOSE_RAD = 0.05, 0.01


class ImageDoubt(NamedTuple):
    """How unsure the pose is that the particles say of an image.

    covariance (3, 3): of it, in (m, m, rad), where no pose was known before. information (3, 3): what the image's lines
    alone say of it. beside (3, 3): covariance of what no line shows.
    """

    covariance: FloatArray
    information: FloatArray
    beside: FloatArray

    def after(self, covariance: FloatArray, spread: FloatArray) -> FloatArray:
        """Covariance (3, 3) where the odometry's pose has a covariance (3, 3) and the particles a spread (3, 3).

        What lines leave open, particles have from the odometry: along a lone line they err as it does.
        """
        weighed = np.linalg.inv(np.eye(3) + spread @ self.information)  # share of the odometry
        return weighed @ (covariance + spread @ self.information @ spread) @ weighed.T + self.beside


class ImageMirror:
    """The mirror in one image after the other. `fit`: of the last one; None if nothing suited."""

    def __init__(self, mirror: LearnedMirror) -> None:
        self.mirror = mirror
        self.reset()

    def reset(self) -> None:
        """Nothing has been seen yet."""
        self.mirror.reset()
        self.fit: ImageFit | None = None
        self.residuals_m: FloatArray = np.zeros(0)

    @property
    def pose(self) -> Pose | None:
        """That the last image wants once its errors are taken out."""
        return None if self.fit is None else Pose(*self.fit.pose.tolist())

    def errors_of(self, points: LinePoints, pose: Pose) -> FloatArray | None:
        """Errors (5,) of one image, its head's shaking included, from points as seen and a pose that is close.

        None for the head's own, if the lines don't fix the pose: a lone line bends by a tilt as by a step aside and a
        turn. Nor is an image believed that wants the pose elsewhere: the robot was shoved, and a pose that is off bends
        lines, too.
        """
        fit = self.mirror.fit_to(points, pose.as_array()) if self.mirror.enabled and self.mirror.settled else None
        if fit is None or fit.left_m > LEFT_M or pose.distance_to(Pose(*fit.pose.tolist())) > CLOSE_M:
            return None
        return fit.errors if abs(wrap_angle(float(fit.pose[2]) - pose.heading)) <= CLOSE_RAD else None

    def see(self, points: LinePoints, pose: Pose) -> None:
        """Fit points as seen, from the particles' pose."""
        self.fit = self.mirror.fit_to(points, pose.as_array())
        if self.fit is not None and self.pose is not None:
            ground = self.mirror.corrected(points.positions_m, self.fit.errors)
            self.residuals_m = self.mirror.field.line_distances(self.pose.transform(ground))

    def learn(self) -> None:
        """Of the last image, if its lines fix the pose; a lone line teaches nothing."""
        if self.fit is not None and self.fit.left_m <= LEFT_M:
            self.mirror.learn(self.fit)

    def doubt(self, pose: Pose) -> ImageDoubt | None:
        """Of a pose that the particles say: what points and mirror leave open, and how far off them it is."""
        if self.fit is None or self.pose is None:
            return None
        beside = shared_out(pose.minus(self.pose)) + self.mirror.misfit
        return ImageDoubt(self.fit.covariance[:3, :3] + beside, self.fit.of_pose, beside)


def shared_out(apart: FloatArray) -> FloatArray:
    """Covariance (3, 3) by which a difference (3,) is as far off as a pose errs on average."""
    return np.outer(apart, apart) / len(apart)
