"""What the camera's calibration leaves, learned from the lines: how the mirror leans and lies, how long the ranges are.

`mirror_fit.py` says how they move the ground points: g (1/m) is the tilt, c (px) the displacement, s the share by which
ranges are too short. They are the same in every image of a head, so no number of images averages them out of
the pose, but lines that should be straight and in their known places show them next to it. Until they are known the
pose is as unsure as they leave it. Ismail et al. 2021 know no such errors; this is ours.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.camera import Camera, OmniCamera
from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.localization.published.nubot.mirror_fit import (
    ERRORS,
    SCALE_STEP_M,
    STATE,
    FitPlan,
    Mirror,
    moved,
    normal_equations,
)
from touchline.localization.published.nubot.mirror_tilt import (
    APEX_RATIO_M,
    MISFIT_M2,
    VIBRATION_PER_M,
    ground_scales,
    swing_of,
    vibration_after,
)
from touchline.localization.registration.covariance import widest_m
from touchline.matrices import inverse
from touchline.types import LinePoints

HEIGHT_M = 0.75  # of the mirror; MSL robots may be 0.8 m high
UNKNOWN_PER_M = 0.015  # standard deviation of g before the first image: a mirror 0.3 degrees off
UNKNOWN_SCALE = 0.02  # the same of s: two marks of a strip misread by a centimetre
# drift of the errors' mean from image to image (root of their number), as a share of what is unknown at first: a mount
# loosens. A head that shakes does not move it: that is new in every image, and no part of what the next one will show
DRIFT = 0.005
WIDTH_M = 0.12  # distance from the line at which a point loses influence; the pose is close already
FIRST_WIDTH_M = 0.25  # the same in the first steps while the errors are unknown
FLOOR_M = 0.01  # standard deviation of a point beside what the detector says: the carpet, the field's own errors
MIN_NOISE, MAX_NOISE, NOISE_GAIN = 0.05, 25.0, 0.05  # limits of what is learned of the noise; share of a new image
LOOSE_M = 0.2  # how far the pose may be off the particles' mean: what an unknown tilt may have shifted it
LOOSE_RAD = 0.1  # the same of its heading
REPEATED = 2.0  # so many points or images err together: neighbours on a line, and the same place seen again
# how unsure the shift is that goes with g (m² per unit of g), which no image shows: h² g if the mirror turns about its
# focus, two or three times that about its apex. Where a displacement is looked for, MISFIT_M2 is left of it
SHIFT_M2 = 1.0
CENTER_AT_M = 2.0  # where most line points are that tell the position
LEFT_M = 0.02  # deviation that the lines leave the position, up to which an image tells of the camera
# how far the pose that an image wants may be off the expected one for its own errors to be believed: more than wheels
# and gyro miss from image to image
CLOSE_M, CLOSE_RAD = 0.05, 0.005
EXACT = 1e-6  # standard deviation (1/m, px, 1) of an error that is taken for known
STEPS = 2  # Gauss-Newton steps; one more while the errors are unknown, each with the wide width
MIN_POINTS = 15  # fewer tell nothing but the pose


class CameraFit(NamedTuple):
    """Pose and camera errors that suit one image best.

    errors (5,): g (1/m), c (px), s. covariance (8, 8): of x, y (m), heading (rad) and the errors, with what was known
    of these before. information (5, 5): what this image alone says of the errors; of_pose (3, 3): what it says of the
    pose, where the errors are as unsure as they were before. unshown (3, 3): of the pose, what no image shows, part of
    the covariance. residuals_m (N,): distances of all
    points from the lines. left_m: standard deviation of the position along its least known direction, if the errors are
    right.
    """

    pose: Pose
    errors: FloatArray
    covariance: FloatArray
    information: FloatArray
    of_pose: FloatArray
    unshown: FloatArray
    residuals_m: FloatArray
    noise: float
    left_m: float


class CameraErrors:
    """`mean` (5,): g (1/m, robot frame), c (px, robot frame) and s, as learned so far; `covariance` (5, 5) of them.

    `noise`: how much larger the points' variances are than the detector says, learned, too; and `vibration_per_m`: how
    far a shaking head turns g from its mean in each image, standard deviation.
    """

    def __init__(
        self, field: FieldModel, enabled: bool = True, camera: Camera | None = None, displacement: bool = True
    ) -> None:
        """enabled: False leaves all points as they are seen, and takes the camera for what it is said to be.

        camera: without one with a mirror no displacement is looked for; nor without displacement, but how sure the
        camera is of its centre is part of `unseen` then.
        """
        self._field = field
        self.enabled = enabled
        omni = camera if isinstance(camera, OmniCamera) and enabled else None
        shown = omni if displacement else None
        self._mirror = Mirror(HEIGHT_M, np.zeros((0, 2)) if shown is None else ground_scales(shown))
        self._unknown = _unknown(shown) if enabled else np.full(ERRORS, EXACT)
        self._apex_px_m = 0.0 if shown is None else APEX_RATIO_M * shown.outer_radius_px
        self._shift_m2 = SHIFT_M2 if shown is None else MISFIT_M2
        self._shift_m = 0.0 if omni is None or displacement else _shift_m(omni)
        self.reset()

    def reset(self) -> None:
        """Nothing has been seen yet."""
        self.mean = np.zeros(ERRORS)
        self.noise = 1.0
        self.vibration_per_m = VIBRATION_PER_M if self.enabled else 0.0
        self.covariance: FloatArray = np.diag(np.square(self._unknown))

    def corrected(self, positions_m: FloatArray, errors: FloatArray | None = None) -> FloatArray:
        """Points (N, 2) in the robot frame (m) as a perfect camera would have seen them; by other errors, if given."""
        ground: FloatArray = moved(
            np.ascontiguousarray(positions_m), self.mean if errors is None else errors, self._mirror
        )
        return ground

    @property
    def unseen(self) -> FloatArray:
        """Covariance (3, 3) of what a mirror beside its centre does to every pose alike, in (m, m, rad)."""
        shift2: float = self._shift_m**2
        return np.diag([shift2, shift2, 0.0])

    @property
    def settled(self) -> bool:
        """Whether so much is known that points can be judged without fitting the errors to them."""
        return float(np.trace(self.covariance[:2, :2])) < 0.2 * UNKNOWN_PER_M**2

    def of_image(self, points: LinePoints, pose: Pose) -> FloatArray:
        """Errors (5,) of one image, its head's shaking included, from points as seen and a pose that is close.

        The mean, if the lines don't fix the pose: a lone line bends by a tilt as by a step aside and a turn. Nor is an
        image believed that wants the pose elsewhere: the robot was shoved, and a pose that is off bends lines, too.
        """
        fit = self.fit(points, pose) if self.enabled and self.settled else None
        if fit is None or fit.left_m > LEFT_M or fit.pose.distance_to(pose) > CLOSE_M:
            return self.mean
        return fit.errors if abs(wrap_angle(fit.pose.heading - pose.heading)) <= CLOSE_RAD else self.mean

    def fit(self, points: LinePoints, pose: Pose) -> CameraFit | None:
        """Pose and errors for points as seen (robot frame, m), from a pose that is close; None if nothing suits."""
        seen = np.ascontiguousarray(points.positions_m)
        loose = np.diag(1.0 / np.array([LOOSE_M, LOOSE_M, LOOSE_RAD]) ** 2)
        prior = np.zeros((STATE, STATE))
        prior[:3, :3], prior[3:, 3:] = loose, np.linalg.inv(self.covariance + self._swing)
        widths_m = np.array((FIRST_WIDTH_M,) * (0 if self.settled else 3) + (WIDTH_M,) * (STEPS + 1))
        plan = FitPlan(widths_m, FLOOR_M, REPEATED * self.noise, np.zeros(3), 1.0)
        start = np.array([*pose, *self.mean])
        state, matrix, noise = _steps(
            seen, np.ascontiguousarray(points.covariances_m2), start, prior, self._mirror, plan, self._field.line_tables
        )
        if not np.all(np.isfinite(state)):
            return None
        found = Pose(*state[:3].tolist())
        residuals_m = self._field.line_distances(found.transform(self.corrected(seen, state[3:])))
        own = np.linalg.inv(matrix[:3, :3] + loose)
        alone = matrix[3:, 3:] - matrix[3:, :3] @ own @ matrix[:3, 3:]
        covariance = np.linalg.inv(matrix + prior)
        unsure = np.linalg.inv(matrix[3:, 3:] + prior[3:, 3:])
        of_pose = matrix[:3, :3] - matrix[:3, 3:] @ unsure @ matrix[3:, :3]
        cosine, sine = math.cos(state[2]), math.sin(state[2])
        bend = np.array([[cosine, -sine], [sine, cosine]]) @ state[3:5]
        unshown = np.zeros((3, 3))
        unshown[:2, :2] = self._shift_m2**2 * (
            np.outer(bend, bend) + 0.5 * np.trace(self.covariance[:2, :2]) * np.eye(2)
        )
        covariance[:3, :3] += unshown
        return CameraFit(found, state[3:], covariance, alone, of_pose, unshown, residuals_m, noise, widest_m(own))

    def learn(self, fit: CameraFit) -> None:
        """Kalman update of the mean by what one image alone has said of the errors, if its lines fix the pose.

        A lone line tells nothing of it, see `of_image`.
        """
        self.noise += NOISE_GAIN * (min(max(fit.noise, MIN_NOISE), MAX_NOISE) - self.noise)
        if not self.enabled or fit.left_m > LEFT_M:
            return
        swing = self._swing
        known = np.linalg.inv(self.covariance + swing)
        # the fit's errors are the mean of both by their information; what the image said of it follows
        said = fit.errors @ (known + fit.information) - known @ self.mean
        own = swing @ np.linalg.inv(np.eye(ERRORS) + fit.information @ swing)  # what the image leaves open of its own
        self.vibration_per_m = vibration_after(self.vibration_per_m, fit.errors[:2] - self.mean[:2], own)
        share = np.linalg.inv(REPEATED * np.eye(ERRORS) + fit.information @ swing)
        known = np.linalg.inv(self.covariance)
        self.covariance = np.linalg.inv(known + share @ fit.information)
        self.mean = self.covariance @ (known @ self.mean + share @ said)
        self.covariance = self.covariance + np.diag(np.square(DRIFT * self._unknown))

    @property
    def _swing(self) -> FloatArray:
        return swing_of(self.vibration_per_m, self._apex_px_m)


@njit(cache=True)
def _steps(points, covariances, start, prior, mirror, plan, lines):  # type: ignore[no-untyped-def]
    """Gauss-Newton from a start (8,) with what is known of it, prior (8, 8): a step for each width but the last, whose
    equations tell what the points say there: state (8,), matrix (8, 8), noise in the unit of the points' variances."""
    state, matrix, noise = start.copy(), np.zeros((STATE, STATE)), 1.0
    for k in range(len(plan.widths_m)):
        matrix, vector, noise = normal_equations(points, covariances, state, mirror, plan, plan.widths_m[k], lines)
        if k == len(plan.widths_m) - 1:
            break
        keep = inverse(matrix + prior)
        step = np.zeros(STATE)
        for a in range(STATE):
            for b in range(STATE):
                pull = vector[b]
                for c in range(STATE):
                    pull += prior[b, c] * (start[c] - state[c])
                step[a] += keep[a, b] * pull
        state = state + step
    return state, matrix, noise


def _unknown(camera: OmniCamera | None) -> FloatArray:
    """Standard deviations (5,) of the errors before the first image; camera: None if no displacement is looked for."""
    shift_px = EXACT
    if camera is not None:
        # what the camera states, and what a mirror that leans about its apex displaces
        leans_px = APEX_RATIO_M * camera.outer_radius_px * UNKNOWN_PER_M
        shift_px = math.hypot(camera.uncertainty.center_px, leans_px)
    return np.array([UNKNOWN_PER_M, UNKNOWN_PER_M, shift_px, shift_px, UNKNOWN_SCALE])


def _shift_m(camera: OmniCamera) -> float:
    """Standard deviation of how far the ground about the robot is moved as the image's centre is not where it is said
    to be: between what that does along and across the direction of a point CENTER_AT_M away.
    """
    return float(camera.uncertainty.center_px * ground_scales(camera)[round(CENTER_AT_M / SCALE_STEP_M)].mean())
