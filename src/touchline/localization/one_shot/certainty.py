"""How sure the pose of one observation is: what the points leave, and what the camera may be off by.

One observation can't average anything out, and a mirror that is 3 pixels off its centre moves the pose by decimetres
while the lines still fit to centimetres. So the pose is fitted once more together with what a camera is usually wrong
by (`learned_mirror`): how unsure that fit is, and how far it lies from the pose, are both part of the covariance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from touchline.camera import Camera, OmniCamera
from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.localization.one_shot.point_search import C_M, PointSearch
from touchline.localization.one_shot.thinning import thinned_to
from touchline.localization.registration.covariance import (
    UNKNOWN_POSITION_M,
    UncertaintySettings,
    principal_information,
    visual_covariance,
)
from touchline.localization.registration.learned_mirror import ImageFit, LearnedMirror
from touchline.localization.registration.weights import RANGE_NOISE_M
from touchline.types import LinePoints

MAX_POINTS = 500  # points, evenly over the ground, that tell of the camera: neighbours tell the same
RANGE_NOISE_RATIO = 0.02  # generic noise of a point, of its range, beside RANGE_NOISE_M
SCALE_RATIO = 0.03  # standard deviation of a scale error of all ranges: marks that a tape has put wrong
BEND_PER_M = 0.015  # the same of the bend: a mirror 0.3 degrees askew, or 3 pixels off its centre
ASKEW_DEG, CENTER_RATIO = 0.3, 0.015  # of the mirror, and of its outer radius, that BEND_PER_M stands for
MIN_RATIO = 1e-4  # of what a camera that is said to be exact may be wrong by
# how far a bend may move the ground beside what it shows (m² per unit of bend): a mirror beside its centre moves all
# ground by a² of its range function r = a tan(b rho), 2 to 4 m², one that leans by its height squared
SHIFT_M2 = 2.0
FITS = 4  # each starts where the one before has ended
BY_CHANCE = 0.2  # probability that a point which fixes a direction alone is clutter that the pose was fitted to


class CameraDoubt(NamedTuple):
    """What the lines say against the camera at a pose.

    moved_m: how far the pose moves if the camera may be wrong. scale, scale_deviation: by what share ranges are too
    short. bend_per_m, bend_deviation: by how much (1/m) lines bend, as by a mirror that leans or is off its centre.
    """

    moved_m: float
    scale: float
    scale_deviation: float
    bend_per_m: float
    bend_deviation: float


class Spread(NamedTuple):
    """What a camera may be wrong by, standard deviations: the scale of its ranges, and the bend (1/m)."""

    scale: float = SCALE_RATIO
    bend_per_m: float = BEND_PER_M

    @classmethod
    def stated_by(cls, camera: Camera | None) -> Spread:
        """That of a camera with a mirror as its camera.yaml states it; the usual one of any other, or of none."""
        if not isinstance(camera, OmniCamera):
            return cls()
        stated = camera.uncertainty
        askew = stated.tilt_deg / ASKEW_DEG, stated.center_px / (CENTER_RATIO * camera.outer_radius_px)
        return cls(max(stated.range_ratio, MIN_RATIO), BEND_PER_M * max(float(np.hypot(*askew)), MIN_RATIO))


USUAL = Spread()


def with_camera(
    field: FieldModel, points: FloatArray, pose: Pose, covariance: FloatArray, spread: Spread = USUAL
) -> tuple[FloatArray, CameraDoubt]:
    """Covariance (3, 3) in (m, m, rad) of a matched pose, from what the points (N, 2) leave, and what they say.

    points: m, robot frame. covariance (3, 3): of the pose if the camera is right. spread: what it may be wrong by,
    believed unless the lines contradict it.
    """
    usual, doubt = _with_spread(field, points, pose, covariance, USUAL)
    says_less = spread.scale < USUAL.scale or spread.bend_per_m < USUAL.bend_per_m
    contradicted = abs(doubt.scale) > np.hypot(2.0 * doubt.scale_deviation, 2.0 * spread.scale)
    contradicted |= doubt.bend_per_m > np.hypot(3.0 * doubt.bend_deviation, 3.0 * spread.bend_per_m)
    if spread == USUAL or (says_less and contradicted):
        return usual, doubt
    return _with_spread(field, points, pose, covariance, spread)[0], doubt


def _with_spread(
    field: FieldModel, points: FloatArray, pose: Pose, covariance: FloatArray, spread: Spread
) -> tuple[FloatArray, CameraDoubt]:
    fit = camera_fit(field, points, pose, spread)
    if fit is None:
        return covariance, CameraDoubt(0.0, 0.0, spread.scale, 0.0, spread.bend_per_m)
    x, y, heading = fit.pose.tolist()
    off = np.array([x - pose.x, y - pose.y, wrap_angle(heading - pose.heading)])
    c, s = np.cos(heading), np.sin(heading)
    bend = np.array([[c, -s], [s, c]]) @ fit.errors[:2]
    covariance = covariance + fit.covariance[:3, :3] + np.outer(off, off)
    covariance[:2, :2] += SHIFT_M2**2 * (np.outer(bend, bend) + spread.bend_per_m**2 * np.eye(2))
    deviations = np.sqrt(np.diag(fit.covariance)[3:])
    size = float(np.hypot(*fit.errors[:2]))
    doubt = CameraDoubt(
        float(np.hypot(*off[:2])), float(fit.errors[4]), float(deviations[4]), size, float(deviations[:2].max())
    )
    return covariance, doubt


def camera_fit(field: FieldModel, points: FloatArray, pose: Pose, spread: Spread = USUAL) -> ImageFit | None:
    """Pose and camera errors that suit points (N, 2) in m, robot frame, from a pose that is close; None for none.

    spread: what the camera may be wrong by.
    """
    few = thinned_to(points, MAX_POINTS)
    variances = (RANGE_NOISE_M + RANGE_NOISE_RATIO * np.hypot(few[:, 0], few[:, 1])) ** 2
    noise = np.eye(2) * variances[:, np.newaxis, np.newaxis]
    seen = LinePoints(few, noise, np.ones(len(few)), np.full_like(few, np.nan))
    mirror, at = LearnedMirror(field), pose.as_array()
    deviations = [spread.bend_per_m, spread.bend_per_m, 0.0, 0.0, spread.scale]
    mirror.covariance, mirror.vibration_per_m = np.diag(deviations) ** 2, 0.0  # one image: its shaking is in the spread
    for _ in range(FITS):
        fit = mirror.fit_to(seen, at)
        if fit is None:
            return None
        at = fit.pose
    return fit


def points_covariance(search: PointSearch, points: FloatArray, weights: FloatArray, pose: Pose) -> FloatArray:
    """Covariance (3, 3) in (m, m, rad) that the points leave a pose, as `visual_covariance`, but without its cliff.

    That one leaves out as many of the points that help most as may be clutter; of few points, nothing may be left of a
    direction that four of them fix. Here the k that help most are clutter with a probability of BY_CHANCE^k, and the
    variance is the mean over k. The surer of both counts.
    """
    found, settings = search.moments(points, weights, pose), UncertaintySettings()
    told = principal_information(points, weights, found, C_M)
    if told is None:
        return settings.unknown
    strict = visual_covariance(points, weights, found, C_M, settings)
    chances = (1.0 - BY_CHANCE) * BY_CHANCE ** np.arange(min(len(points), 12))
    rest = np.sort(told.helps, axis=0).cumsum(axis=0)[::-1][: len(chances)] * told.unit
    variances = chances @ (1.0 / (rest + UNKNOWN_POSITION_M**-2)) / chances.sum()
    mixed = told.covariance(1.0 / variances, settings)
    return min((strict, mixed), key=lambda one: float(np.trace(one[:2, :2])))
