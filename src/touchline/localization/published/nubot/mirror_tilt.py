"""How the mirror differs from its camera.yaml, from how the lines bend: measured in every frame, so that a vibrating
head does no harm.

A mirror tilted or displaced by a little, and ranges that are too long, move ground points as `mirror_fit` says. Lines
that should be straight, parallel and in their known places show these errors next to the pose. How much error is
expected before the first image is what camera.yaml states; what later images leave open shifts every pose alike, and no
number of images averages it out.
"""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field

from touchline.camera import Camera, OmniCamera
from touchline.camera.uncertainty import USUAL_TILT_DEG
from touchline.config import Settings, added
from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose
from touchline.localization.published.nubot.mirror_fit import (
    ERRORS,
    SCALE_STEP_M,
    Expected,
    FitPlan,
    Known,
    Mirror,
    MirrorFit,
    fit_mirror,
    moved,
)
from touchline.types import LinePoints

MAX_ERROR = 0.1  # mean error of most points above which the lines are too uncertain to tell a tilt
MAX_POINTS = 0.75  # of the points, the nearest to lines, are those; the others may be nets, or lines of a field beside
VIBRATION_PER_M = 0.003  # standard deviation of g about its mean from frame to frame, at first: 0.06 degrees
MIN_VIBRATION_PER_M, MAX_VIBRATION_PER_M = 0.002, 0.02  # limits of what is learned of it
VIBRATION_GAIN = 0.05  # share of a new image in it
# a mirror turns about its apex: by how much that displaces its image, as a share of its outer radius, per 1/m of g
APEX_RATIO_M = 0.35
# what a mirror that turns about its apex does beyond these errors: shift (m²) and turn (m) of the pose per 1/m of g
MISFIT_M2, MISFIT_M = 0.65, 0.08
DRIFT = 0.003  # drift of the mean errors per frame, as a share of what was unknown at first: a loosening mount
WIDTH_M = 0.1  # distance to the line from which a point loses influence; the pose is already matched
FIRST_WIDTH_M = 0.25  # the same in the first steps: 0.3 degrees move a line 7 m off by so much; Lauer's c
MIN_NOISE_M = 0.01  # standard deviation that no point falls below: carpet, calibration
# how far the pose may move meanwhile (m, m, rad): what unknown errors may have shifted it
LOOSE = np.array([0.2, 0.2, 0.1])
FIRST_ITERATIONS = 3  # Gauss-Newton steps per frame with the first width: from the mean of the frames before
ITERATIONS = 2  # those after them
REPEATED_POINTS, REPEATED_IMAGES = 2.0, 3.0  # so many err together: neighbours on a line, and the same place seen again
MIN_NOISE, MAX_NOISE, NOISE_GAIN = 0.2, 25.0, 0.05  # limits of what is learned of the noise; share of a new image
MAX_M = 20.0  # of the table of scales


class MirrorTiltPaper(Settings):
    """Switches to the papers' exact form."""

    enabled: bool = added(
        True,
        paper=False,
        description="estimate the tilt; without it, as in the papers, a mirror 0.2 degrees off costs 5 cm",
    )
    displacement: bool = added(
        True,
        paper=False,
        description="estimate the mirror's displacement and the scale of the ranges, too; without it a mirror 0.3 mm "
        "off costs 4 cm",
    )


class MirrorTiltSettings(Settings):
    """How much tilt is expected, and how fast it may change. None of this is in the paper."""

    height_m: float = Field(0.75, ge=0, description="height of the mirror (m): MSL robots may be 0.8 m high")
    paper: MirrorTiltPaper = MirrorTiltPaper()


class MirrorTilt:
    """`mean` (5,): the mirror's errors as learned so far, see `mirror_fit`; `covariance` (5, 5). `believed` (5,): what

    is taken off the points, which is nothing until the lines contradict camera.yaml beyond doubt.
    """

    def __init__(
        self, field: FieldModel, settings: MirrorTiltSettings | None = None, camera: Camera | None = None
    ) -> None:
        """camera: without one a displacement is not looked for."""
        self.settings = settings or MirrorTiltSettings()
        self._field, self._lines = field, field.line_tables
        omni = camera if isinstance(camera, OmniCamera) else None
        shown = omni if self.settings.paper.displacement else None
        self._mirror = Mirror(self.settings.height_m, np.zeros((0, 2)) if shown is None else ground_scales(shown))
        self._unknown = _unknown(omni, shown is not None, self.settings.height_m)
        self._open = np.outer(self._unknown > 0.0, self._unknown > 0.0).astype(np.float64)
        self._apex_px_m = 0.0 if shown is None else APEX_RATIO_M * shown.outer_radius_px
        self.reset()

    def reset(self) -> None:
        """Nothing has been seen yet."""
        self.mean: FloatArray = np.zeros(ERRORS)
        self.believed: FloatArray = np.zeros(ERRORS)
        self.covariance: FloatArray = np.diag(self._unknown * self._unknown)
        self.vibration_per_m = VIBRATION_PER_M
        self.noise = 1.0
        self.fit: MirrorFit | None = None

    @property
    def mean_per_m(self) -> FloatArray:
        """The tilt g (2,) of the mean."""
        return self.mean[:2]

    def corrected(self, positions_m: FloatArray, errors: FloatArray | None = None) -> FloatArray:
        """Points (N, 2) as a perfect mirror would have seen them; without what is believed, or errors (5,) given."""
        points: FloatArray = moved(
            np.ascontiguousarray(positions_m), self.believed if errors is None else errors, self._mirror
        )
        return points

    @property
    def is_unknown(self) -> bool:
        """Whether hardly any frame has told the mean yet."""
        return float(np.trace(self.covariance[:2, :2])) > 0.1 * 2.0 * 0.015**2

    def settles(self, positions_m: FloatArray, pose: FloatArray) -> bool:
        """Whether points (N, 2), robot frame, with their frame's errors taken out lie so near the lines at a pose (3,)
        that the errors are those of the mirror.
        """
        squares = np.square(self._field.line_distances(Pose(*pose.tolist()).transform(positions_m)))
        nearest = np.sort(squares)[: max(int(MAX_POINTS * len(squares)), 1)]
        return float(np.mean(nearest / (nearest + FIRST_WIDTH_M**2))) < MAX_ERROR

    @property
    def unseen(self) -> FloatArray:
        """Covariance (3, 3) of what the errors do to every pose alike, in (m, m, rad): no number of images shows it."""
        if self.fit is None:
            return np.zeros((3, 3))
        left = self.mean - self.believed
        shared: FloatArray = self.fit.lever @ (self.covariance + np.outer(left, left)) @ self.fit.lever.T
        askew2 = float(self.believed[:2] @ self.believed[:2])
        return shared + np.diag([MISFIT_M2**2 * askew2, MISFIT_M2**2 * askew2, MISFIT_M**2 * askew2])

    @property
    def shaken(self) -> FloatArray:
        """Covariance (3, 3) of what a shaking head leaves in the pose of one image, as `unseen`."""
        if self.fit is None:
            return np.zeros((3, 3))
        own: FloatArray = self.fit.lever @ self.fit.image @ self.fit.lever.T
        return own

    def fit_to(self, points: LinePoints, pose: FloatArray, expected: Expected | None = None) -> MirrorFit | None:
        """A frame's pose and errors, from points as seen and a pose (3,) that fits them but for the errors.

        expected: where the robot should be; what the lines leave open between pose and errors is decided by it.
        """
        plan = FitPlan(
            np.array([FIRST_WIDTH_M] * FIRST_ITERATIONS + [WIDTH_M] * ITERATIONS),
            MIN_NOISE_M,
            REPEATED_POINTS * self.noise,
            LOOSE,
            REPEATED_IMAGES,
        )
        known = Known(self.mean, self.believed, self.covariance, self._swing)
        fit: MirrorFit = fit_mirror(
            np.ascontiguousarray(points.positions_m), np.ascontiguousarray(points.covariances_m2), pose,
            expected or Expected(pose, np.diag(np.square(LOOSE))), known, self._mirror, plan, self._lines,
        )  # fmt: skip
        return fit if math.isfinite(fit.pose.sum() + fit.errors.sum() + fit.covariance.sum()) else None

    def learn(self, fit: MirrorFit) -> None:
        """What a frame has told of the head's errors, of its shaking and of the points' noise."""
        self.noise += NOISE_GAIN * (min(max(fit.noise, MIN_NOISE), MAX_NOISE) - self.noise)
        deviation = fit.errors[:2] - self.believed[:2]
        self.vibration_per_m = vibration_after(self.vibration_per_m, deviation, fit.image)
        drift: FloatArray = np.diag(np.square(DRIFT * self._unknown))
        self.mean, self.covariance, self.fit = fit.mean, (fit.covariance + drift) * self._open, fit
        self.believed = self._ratio_wrong() * self.mean

    def _ratio_wrong(self) -> float:
        """How probable it is that the camera is wrong, as far as is stated, rather than right: Bayes factor of both.

        A camera.yaml that is exact would else be spoilt by what the detector errs by.
        """
        which = self._unknown > 0.0
        if not which.any():
            return 0.0
        mean, spread = self.mean[which], self.covariance[np.ix_(which, which)]
        narrower = 2.0 * float(np.log(self._unknown[which]).sum()) - float(np.linalg.slogdet(spread)[1])
        odds = 0.5 * (narrower - float(mean @ np.linalg.solve(spread, mean)))
        return 1.0 / (1.0 + math.exp(min(odds, 50.0)))

    def leave_open(self, fit: MirrorFit) -> None:
        """A frame that tells nothing of its errors: they may be as large as the head's shaking makes them."""
        self.fit = fit._replace(image=self._swing)

    def update(self, points: LinePoints, pose: Pose) -> MirrorFit | None:
        """`fit_to`, and `learn` if there is a fit."""
        fit = self.fit_to(points, pose.as_array())
        if fit is not None:
            self.learn(fit)
        return fit

    @property
    def _swing(self) -> FloatArray:
        return swing_of(self.vibration_per_m, self._apex_px_m)


def swing_of(vibration_per_m: float, apex_px_m: float) -> FloatArray:
    """Covariance (5, 5) of what a head that shakes about its apex adds to the errors in each image.

    vibration_per_m: standard deviation of g per axis. apex_px_m: by how much 1/m of it displaces the mirror's image.
    """
    axis = np.zeros((ERRORS, 2))
    axis[0, 0] = axis[1, 1] = vibration_per_m
    axis[2, 0] = axis[3, 1] = apex_px_m * vibration_per_m
    swing: FloatArray = axis @ axis.T
    return swing


def vibration_after(vibration_per_m: float, deviation: FloatArray, image: FloatArray) -> float:
    """Standard deviation of g per axis (1/m) once an image has shown how far g (2,) is off its mean.

    image (5, 5): covariance of what the image leaves open of it.
    """
    seen = 0.5 * (float(deviation @ deviation) + image[0, 0] + image[1, 1])
    variance = vibration_per_m**2 + VIBRATION_GAIN * (seen - vibration_per_m**2)
    return min(max(math.sqrt(variance), MIN_VIBRATION_PER_M), MAX_VIBRATION_PER_M)


def ground_scales(camera: OmniCamera) -> FloatArray:
    """(K, 2) of `mirror_fit.Mirror.scales`: the mean of all directions."""
    ranges_m = np.exp(np.log(np.maximum(camera.range_m, 1e-3)).mean(axis=0))
    places = SCALE_STEP_M * np.arange(int(MAX_M / SCALE_STEP_M) + 1)
    inside = np.clip(places, max(ranges_m[0], 0.05), ranges_m[-1] - 0.1)
    radii = np.interp(inside, ranges_m, camera.radius_px)
    ahead, behind = (np.interp(inside + step, ranges_m, camera.radius_px) for step in (0.05, -0.05))
    return np.ascontiguousarray(
        np.column_stack((0.1 / np.maximum(ahead - behind, 1e-3), inside / np.maximum(radii, 1.0)))
    )


def _unknown(camera: OmniCamera | None, displaced: bool, height_m: float) -> FloatArray:
    """Standard deviations (5,) of the errors before the first image; displaced: more than the tilt is looked for."""
    tilt_deg = USUAL_TILT_DEG if camera is None else camera.uncertainty.tilt_deg
    per_m = 2.0 * math.radians(tilt_deg) / max(height_m, 0.1)
    if camera is None or not displaced:
        return np.array([per_m, per_m, 0.0, 0.0, 0.0])
    stated = camera.uncertainty
    shift_px = math.hypot(stated.center_px, APEX_RATIO_M * camera.outer_radius_px * per_m)
    return np.array([per_m, per_m, shift_px, shift_px, stated.range_ratio])
