"""The pixel-to-centimetre regression: a polynomial from the radius in the image to the range on the ground.

M. A. Ismail, D. Purwanto, A. Arifin: Soccer robot localization based on sensor fusion from odometry and omnivision,
section II.B and figure 14, which leave the form of the regression open.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import Polynomial

from touchline.camera import OmniCamera
from touchline.camera.model_free import ranges_along, table_radii
from touchline.camera.uncertainty import CameraUncertainty, usual_uncertainty
from touchline.errors import InputError, NoFitError
from touchline.geometry import FloatArray
from touchline.published.iris_fusion.range_pairs import RangePairs

USUAL_DEGREE = 6  # of the strip's 15 edges: within 0.5 % from 0.6 to 6.5 m
MAX_DEGREE = 12
_CHORDS = 12  # the slope beyond the first and the last pair is that of the outermost of so many equal parts
_MARKED_PX = 0.5  # a mark is no surer than this
_MIN_STEP_PX = 0.1  # between radii of the table, which are written with six digits
_SAME_PX = 1.0  # pairs nearer to each other than this tell of the same distance
_MIN_RANGE_RATIO = 0.01  # marks measured with a tape, about a robot's centre that nobody can see
_WRONG_SIGMAS = 8.0
_LONE_LEVERAGE = 0.7  # of a pair: above, the polynomial there hangs on it alone, and the others can't judge it
_WRONG_SHARE = 0.05  # of the range: a pair that is less off than this is never called wrong


@dataclass(frozen=True, eq=False)
class RangeRegression:
    """range_m = polynomial(radius_px), rising from the first pair's radius to the last one's; valid nowhere else."""

    polynomial: Polynomial
    pairs: RangePairs

    @property
    def degree(self) -> int:
        """Degree of the polynomial."""
        return len(self.polynomial.coef) - 1

    @property
    def first_px(self) -> float:
        """Radius of the nearest pair."""
        return float(self.pairs.radius_px.min())

    @property
    def last_px(self) -> float:
        """Radius of the farthest pair."""
        return float(self.pairs.radius_px.max())

    @cached_property
    def residuals_m(self) -> FloatArray:
        """(N,) measured range less that of the polynomial."""
        return self.pairs.range_m - self.polynomial(self.pairs.radius_px)

    def center_offset_px(self) -> FloatArray:
        """(2,) u, v by which the centre seems to be off: a wrong one makes the radii err like a cosine of the angle."""
        stretched_px = self.residuals_m / self.polynomial.deriv()(self.pairs.radius_px)
        return np.linalg.lstsq(self._center_design, stretched_px, rcond=None)[0][:2]

    @property
    def _center_design(self) -> FloatArray:
        """(N, 3) how the radii change with the centre's u and v and with all ranges together."""
        angles = self.pairs.angle_rad
        return np.column_stack((-np.cos(angles), -np.sin(angles), np.ones_like(angles)))

    def center_deviation_px(self) -> float:
        """How unsure `center_offset_px` is in its worst direction; infinite for pairs in one direction."""
        design = self._center_design
        stretched_px = self.residuals_m / self.polynomial.deriv()(self.pairs.radius_px)
        rest = stretched_px - design @ np.linalg.lstsq(design, stretched_px, rcond=None)[0]
        noise_px = max(float(np.sqrt(np.mean(rest**2))), _MARKED_PX)
        values = np.linalg.eigvalsh(design.T @ design)
        if values[0] < 1e-9 * values[-1]:
            return math.inf
        return noise_px * math.sqrt(float(np.linalg.eigvalsh(np.linalg.inv(design.T @ design)[:2, :2])[-1]))

    def camera(self, continued: bool = False) -> OmniCamera:
        """A camera whose range table is the polynomial at every pixel of its range.

        continued: beyond the last pair the range goes on to twice that pair's, and inside the first one to half of it
        if it is known where the robot ends, as `camera.model_free` continues a mirror; else such points have no place.
        """
        optics, first, last = self.pairs.optics, self.first_px, self.last_px
        inside = np.arange(np.ceil(first + _MIN_STEP_PX), last - _MIN_STEP_PX)
        radii = np.concatenate(([first], inside, [last]))
        ranges = self.polynomial(radii)
        if continued:
            edges = np.linspace(first, last, _CHORDS)
            around = table_radii(edges[np.newaxis], self.polynomial(edges))
            nearer, farther = around[around < first - _MIN_STEP_PX], around[around > last + _MIN_STEP_PX]
            nearer, farther = nearer[nearer >= optics.inner_px - 1.0], farther[farther <= optics.outer_px + 1.0]
            nearer = nearer if optics.inner_px else nearer[:0]
            beyond = [ranges_along(edges[np.newaxis], self.polynomial(edges), part)[0] for part in (nearer, farther)]
            radii = np.concatenate((nearer, radii, farther))
            ranges = np.concatenate((beyond[0], ranges, beyond[1]))
        return OmniCamera(
            optics.width,
            optics.height,
            optics.center,
            max(optics.inner_px, float(radii[0])),
            float(radii[-1]),
            optics.handedness,
            optics.mount_yaw_rad,
            radii,
            np.zeros(1),
            ranges[np.newaxis],
            stated_uncertainty=self.uncertainty(),
        )

    def uncertainty(self) -> CameraUncertainty:
        """How sure the ranges are: one table for all directions knows neither how the mirror leans nor its centre."""
        relative = self.residuals_m / self.pairs.range_m
        scatter = float(np.sqrt(np.mean(np.square(relative)) / _distinct(self.pairs.radius_px)))
        return usual_uncertainty(self.last_px)._replace(range_ratio=float(np.hypot(scatter, _MIN_RANGE_RATIO)))

    def formula(self) -> str:
        """The polynomial as text, highest power last."""
        middle, half = 0.5 * (self.first_px + self.last_px), 0.5 * (self.last_px - self.first_px)
        terms = " ".join(f"{c:+.6g}·x^{k}" if k else f"{c:.6g}" for k, c in enumerate(self.polynomial.coef))
        return f"range_m = {terms}, x = (radius_px - {middle:.3f}) / {half:.3f}"


def fit_range(pairs: RangePairs, degree: int | None = None) -> RangeRegression:
    """Least squares of relative errors. degree: none, the highest up to the usual one that rises all the way.

    Raises InputError for too few distances and for pairs that contradict all others, NoFitError if the polynomial does
    not rise all the way from the first to the last pair.
    """
    distances = _distinct(pairs.radius_px)
    if distances < 2:
        raise InputError(f"{pairs.origin}: all lie at one distance from the centre; mark points at several")
    if degree is not None and not 1 <= degree <= MAX_DEGREE:
        raise InputError(f"degree {degree}: expected 1 to {MAX_DEGREE}")
    if degree is not None and distances < degree + 1:
        raise InputError(
            f"{pairs.origin}: show {distances} different distances, but a polynomial of degree {degree} needs "
            f"{degree + 1} at least: mark more, or choose --degree {distances - 1}"
        )
    highest = min(USUAL_DEGREE, max(distances - 2, 1))
    _refuse_wrong_pairs(pairs, min(highest, degree or highest), distances)
    tried = range(highest, 0, -1) if degree is None else (degree,)
    for each in tried:
        polynomial = _fit(pairs.radius_px, pairs.range_m, each)
        falls_px = _falls_at(polynomial, pairs.radius_px)
        if falls_px is None:
            return RangeRegression(polynomial, pairs)
    others = range(1, min(distances - 1, MAX_DEGREE) + 1)
    rising = [d for d in others if _falls_at(_fit(pairs.radius_px, pairs.range_m, d), pairs.radius_px) is None]
    advice = f"degrees that rise: {', '.join(map(str, rising))}" if rising else "no degree rises all the way"
    raise NoFitError(
        f"{pairs.origin}: the polynomial of degree {tried[0]} does not rise at a radius of {falls_px:.0f} px "
        f"(between {pairs.radius_px.min():.0f} and {pairs.radius_px.max():.0f} px it has to): {advice}"
    )


def _fit(radius_px: FloatArray, range_m: FloatArray, degree: int) -> Polynomial:
    return Polynomial.fit(radius_px, range_m, degree, w=1.0 / range_m)


def _falls_at(polynomial: Polynomial, radius_px: FloatArray) -> float | None:
    """The first radius between the pairs where the polynomial doesn't rise, or isn't positive; None if it does."""
    radii = np.linspace(radius_px.min(), radius_px.max(), 4000)
    bad = np.flatnonzero((polynomial.deriv()(radii) <= 0.0) | (polynomial(radii) <= 0.0))
    return float(radii[bad[0]]) if len(bad) else None


def _distinct(radius_px: FloatArray) -> int:
    """How many different distances the pairs show."""
    return 1 + int(np.count_nonzero(np.diff(np.sort(radius_px)) > _SAME_PX))


def _refuse_wrong_pairs(pairs: RangePairs, degree: int, distances: int) -> None:
    """InputError naming the pair that is farthest from what all others say, if it is far off."""
    if distances < degree + 2:  # the polynomial goes through every distance: nothing contradicts anything
        return
    scaled = Polynomial.fit(pairs.radius_px, pairs.range_m, degree, w=1.0 / pairs.range_m)
    x = scaled.mapparms()[0] + scaled.mapparms()[1] * pairs.radius_px
    design = np.vander(x, degree + 1, increasing=True) / pairs.range_m[:, np.newaxis]
    leverage = np.sum(np.linalg.qr(design)[0] ** 2, axis=1)
    judged = leverage < _LONE_LEVERAGE
    if not judged.any():
        return
    leverage = np.where(judged, leverage, 0.0)
    relative = (1.0 - scaled(pairs.radius_px) / pairs.range_m) / (1.0 - leverage)  # against the fit without the pair
    size = np.where(judged, np.abs(relative), 0.0)
    worst = int(np.argmax(size))
    if size[worst] > max(_WRONG_SIGMAS * 1.4826 * float(np.median(size[judged])), _WRONG_SHARE):
        raise InputError(
            f"{pairs.places[worst]}: is seen at {pairs.radius_px[worst]:.1f} px and said to be "
            f"{pairs.range_m[worst]:.2f} m away, {abs(relative[worst]) * pairs.range_m[worst]:.2f} m from what the "
            "other pairs say: correct it or leave it out"
        )
