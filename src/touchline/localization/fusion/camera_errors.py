"""What the camera's calibration leaves: a tilted mirror and ranges that are too long, learned from the lines.

A mirror tilted by a little moves a ground point p, seen from the height h, to first order by (g·p) p + h² g, with g
(1/m) towards the side that is seen too near (`matching/mirror_tilt.py`); ranges that are too short by a share s move it
by s p. Both are the same in every image of a head, so no number of images averages them out of the pose, but lines that
should be straight and in their known places show them next to it. Until they are known the pose is as unsure as they
leave it. Ismail et al. 2021 know no such errors; this is ours.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from touchline.camera import Camera, OmniCamera
from touchline.field import FieldModel
from touchline.field.distances import nearest_line_points
from touchline.geometry import FloatArray, Pose
from touchline.localization.matching.covariance import widest_m
from touchline.localization.matching.mirror_fit import SCALE_STEP_M
from touchline.localization.matching.mirror_tilt import ground_scales
from touchline.types import LinePoints

HEIGHT_M = 0.75  # of the mirror; MSL robots may be 0.8 m high
UNKNOWN_PER_M = 0.015  # standard deviation of g before the first image: a mirror 0.3 degrees off
UNKNOWN_SCALE = 0.02  # the same of s: two marks of a strip misread by a centimetre
DRIFT_PER_M = 0.0002  # drift of g from image to image (root of their number): a mount that loosens, a head that shakes
DRIFT_SCALE = 0.0001  # drift of s from image to image
WIDTH_M = 0.12  # distance from the line at which a point loses influence; the pose is close already
FIRST_WIDTH_M = 0.25  # the same in the first steps while the errors are unknown
FLOOR_M = 0.01  # standard deviation of a point beside what the detector says: the carpet, the field's own errors
MIN_NOISE, MAX_NOISE, NOISE_GAIN = 0.05, 25.0, 0.05  # limits of what is learned of the noise; share of a new image
LOOSE_M = 0.2  # how far the pose may be off the particles' mean: what an unknown tilt may have shifted it
LOOSE_RAD = 0.1  # the same of its heading
REPEATED = 2.0  # so many points or images err together: neighbours on a line, and the same place seen again
# how unsure the shift is that goes with g (m² per unit of g), which no image shows: h² g if the mirror turns about its
# focus, two or three times that about its apex
SHIFT_M2 = 1.0
CENTER_AT_M = 2.0  # where most line points are that tell the position
LEFT_M = 0.02  # deviation that the lines leave the position, up to which an image tells of the camera
STEPS = 2  # Gauss-Newton steps; one more while the errors are unknown, each with the wide width
MIN_POINTS = 15  # fewer tell nothing but the pose


class CameraFit(NamedTuple):
    """Pose and camera errors that suit one image best.

    errors (3,): g (1/m), s. covariance (6, 6): of x, y (m), heading (rad), g and s, with what was known of g and s
    before. information (3, 3): what this image alone says of g and s. residuals_m (N,): distances of all points from
    the lines. left_m: standard deviation of the position along its least known direction, if g and s are right.
    """

    pose: Pose
    errors: FloatArray
    covariance: FloatArray
    information: FloatArray
    residuals_m: FloatArray
    noise: float
    left_m: float


class CameraErrors:
    """`mean` (3,): g (1/m, robot frame) and s, as learned so far; `covariance` (3, 3) of both.

    `noise`: how much larger the points' variances are than the detector says, learned, too.
    """

    def __init__(self, field: FieldModel, enabled: bool = True, camera: Camera | None = None) -> None:
        """enabled: False leaves all points as they are seen, and takes the camera for what it is said to be.

        camera: how sure it is of its centre is part of `unseen`.
        """
        self._lines = field.line_tables
        self.enabled = enabled
        self._shift_m = _shift_m(camera) if enabled and isinstance(camera, OmniCamera) else 0.0
        self.reset()

    def reset(self) -> None:
        """Nothing has been seen yet."""
        self.mean = np.zeros(3)
        self.noise = 1.0
        unknown = np.diag([UNKNOWN_PER_M, UNKNOWN_PER_M, UNKNOWN_SCALE]) ** 2
        self.covariance: FloatArray = unknown if self.enabled else 1e-9 * unknown

    def corrected(self, positions_m: FloatArray, errors: FloatArray | None = None) -> FloatArray:
        """Points (N, 2) in the robot frame (m) as a perfect camera would have seen them; by other errors, if given."""
        return corrected(positions_m, self.mean if errors is None else errors)

    @property
    def unseen(self) -> FloatArray:
        """Covariance (3, 3) of what a mirror beside its centre does to every pose alike, in (m, m, rad)."""
        shift2: float = self._shift_m**2
        return np.diag([shift2, shift2, 0.0])

    @property
    def settled(self) -> bool:
        """Whether so much is known that points can be judged without fitting the errors to them."""
        return float(np.trace(self.covariance[:2, :2])) < 0.2 * UNKNOWN_PER_M**2

    def fit(self, points: LinePoints, pose: Pose) -> CameraFit | None:
        """Pose and errors for points as seen (robot frame, m), from a pose that is close; None if nothing suits."""
        widths = (FIRST_WIDTH_M,) * (0 if self.settled else 3) + (WIDTH_M,) * STEPS
        loose = np.zeros((6, 6))
        loose[:3, :3] = np.diag(1.0 / np.array([LOOSE_M, LOOSE_M, LOOSE_RAD]) ** 2)
        prior = loose.copy()
        prior[3:, 3:] = np.linalg.inv(self.covariance)
        start = np.array([*pose, *self.mean])
        state = start.copy()
        for width_m in widths:
            matrix, vector, _, _ = self._equations(points, state, width_m)
            state = state + np.linalg.solve(matrix + prior, vector + prior @ (start - state))
        matrix, _, residuals_m, noise = self._equations(points, state, WIDTH_M)
        if not np.all(np.isfinite(state)):
            return None
        own = matrix + loose
        alone = own[3:, 3:] - own[3:, :3] @ np.linalg.solve(own[:3, :3], own[:3, 3:])
        covariance = np.linalg.inv(matrix + prior)
        cosine, sine = np.cos(state[2]), np.sin(state[2])
        bend = np.array([[cosine, -sine], [sine, cosine]]) @ state[3:5]
        covariance[:2, :2] += SHIFT_M2**2 * (np.outer(bend, bend) + 0.5 * np.trace(self.covariance[:2, :2]) * np.eye(2))
        left_m = widest_m(np.linalg.inv(own[:3, :3]))
        return CameraFit(Pose(*state[:3].tolist()), state[3:], covariance, alone, residuals_m, noise, left_m)

    def learn(self, fit: CameraFit) -> None:
        """Kalman update of the mean by what one image alone has said of the errors, if its lines fix the pose.

        A lone line bends by a tilt as by a step aside and a turn.
        """
        self.noise += NOISE_GAIN * (min(max(fit.noise, MIN_NOISE), MAX_NOISE) - self.noise)
        if not self.enabled or fit.left_m > LEFT_M:
            return
        drift = np.diag([DRIFT_PER_M, DRIFT_PER_M, DRIFT_SCALE]) ** 2
        known = np.linalg.inv(self.covariance)
        # the fit's errors are the mean of both by their information; what the image said of it follows
        said = fit.errors @ (known + fit.information) - known @ self.mean
        share = fit.information / REPEATED
        self.covariance = np.linalg.inv(known + share)
        self.mean = self.covariance @ (known @ self.mean + said / REPEATED)
        self.covariance = self.covariance + drift

    def _equations(
        self, points: LinePoints, state: FloatArray, width_m: float
    ) -> tuple[FloatArray, FloatArray, FloatArray, float]:
        """Normal equations (6, 6), (6,) of a step of all six; the distances (N,) before it; `CameraFit.noise`."""
        seen = points.positions_m
        ground = corrected(seen, state[3:])
        cosine, sine = np.cos(state[2]), np.sin(state[2])
        turn = np.array([[cosine, -sine], [sine, cosine]])
        placed = np.ascontiguousarray(state[:2] + ground @ turn.T)
        away = placed - nearest_line_points(self._lines, placed)
        distances_m = np.hypot(away[:, 0], away[:, 1])
        normals = away / np.maximum(distances_m, 1e-9)[:, np.newaxis]
        own = normals @ turn  # in the robot frame
        radial = (own * seen).sum(axis=1)
        rows = np.column_stack((
            normals, own[:, 1] * ground[:, 0] - own[:, 0] * ground[:, 1],
            radial[:, np.newaxis] * seen + HEIGHT_M**2 * own, radial,
        ))  # fmt: skip
        variances = FLOOR_M**2 + np.einsum("ni,nij,nj->n", own, points.covariances_m2, own)
        influence = (width_m**2 / (width_m**2 + distances_m**2)) ** 2
        weighted = rows * (influence / (REPEATED * self.noise * variances))[:, np.newaxis]
        noise = float(influence @ (distances_m**2 / variances) / influence.sum())
        return weighted.T @ rows, -weighted.T @ distances_m, distances_m, noise


def corrected(positions_m: FloatArray, errors: FloatArray) -> FloatArray:
    """Points (N, 2) in the robot frame (m) without errors (3,): g (1/m) and s."""
    stretch = 1.0 + errors[2] + positions_m @ errors[:2]
    moved: FloatArray = positions_m * stretch[:, np.newaxis] + HEIGHT_M**2 * errors[:2]
    return moved


def _shift_m(camera: OmniCamera) -> float:
    """Standard deviation of how far the ground about the robot is moved as the image's centre is not where it is said
    to be: between what that does along and across the direction of a point CENTER_AT_M away.
    """
    return float(camera.uncertainty.center_px * ground_scales(camera)[round(CENTER_AT_M / SCALE_STEP_M)].mean())
