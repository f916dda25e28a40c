"""How sure a calibration from lines is, and whether each image alone shows the mirror that all show together."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from touchline.calibration.bundle import SINGULAR
from touchline.calibration.lines.equations import BEND_X, SHAPE, WIDTHS, Lines, Seen
from touchline.calibration.lines.joint import HELD, STRAIGHT_M, fit_in_steps, linearise
from touchline.calibration.lines.mirror_shape import MirrorShape
from touchline.calibration.lines.range_curve import CurveFit, curve_weights
from touchline.errors import NoFitError
from touchline.geometry import FloatArray, IntArray

_SEEN = (5.0, 95.0)  # percentiles of the radii of points on lines, between which ranges count as seen
_CELL_M = 2.0  # pieces of the field's lines that err together: tape measures and paint
_SECTORS = 18  # ... and of the mirror
_UPRIGHT = 0.001  # of the range: what a mirror that leans does beyond a bend
_BENT_PER_M = 6e-4  # of the bend: 0.013 degrees of lean
_WITHIN = 1.84  # times its scale: within it lie 68 % of Cauchy's distribution
# of a range's logarithm nearer than the first points, and past the last: mirrors of other shapes part from a tangent by
# so much, 0 to 0.08 and 0 to 0.2
_NEARER, _BEYOND = 0.05, 0.1
_KINKS = 0.15  # of the jump of the curve's second differences: how far a kink between knots is rounded off
# how far an image may be off beside SURELY standard deviations: a head that shakes by 0.3 degrees moves the centre by a
# pixel or two
APART_PX, APART_RATIO = 2.0, 0.03
SURELY = 4.0


class Certainty(NamedTuple):
    """What a fit says of itself.

    covariances (3, Q, Q): of the mirror's parameters, if points scatter as the fit supposes, if neighbours on the field
    err together, if neighbours in the image do. Of each quantity that which says most counts: bend_per_m (2,), of the
    bend; center_px (2,), of an upright mirror's centre. residuals, distances: of all points, in standard deviations
    (about pixels) and m. kinks (J, Q): what one kink more at each of the curve's knots would do to the
    mirror's parameters. seen_px: radii between which most points on lines lie. edge_m: how far all lines lie towards
    their outer edges, beside where the field has them, and its standard deviation.
    """

    covariances: FloatArray
    center_px: FloatArray
    bend_per_m: FloatArray
    residuals: FloatArray
    distances_m: FloatArray
    kinks: FloatArray
    seen_px: tuple[float, float]
    edge_m: tuple[float, float]

    @property
    def on_lines(self) -> float:
        """Share of the points that lie on lines."""
        return float(np.mean(self.residuals < WIDTHS[-1]))

    def range_ratio(self, shape: MirrorShape, radius_px: FloatArray) -> FloatArray:
        """Standard deviation (N,) of the ranges at radii (N,), as a share of them. It grows where no point lies, and

        outside of the points with the distance from them.
        """
        step = 1e-4 * np.sqrt(np.maximum(np.diag(self.covariances[0]), 1e-18))
        base = np.log(shape.range_m(radius_px))
        slopes = np.zeros((len(radius_px), len(step)))
        for k in range(len(step)):
            moved = shape.parameters.copy()
            moved[k] += step[k]
            other = replace(shape, parameters=moved)
            slopes[:, k] = (np.log(other.range_m(radius_px)) - base) / step[k]
        variance = np.einsum("nk,skl,nl->sn", slopes, self.covariances, slopes).max(axis=0)
        more = np.abs(slopes @ self.kinks.T).sum(axis=1)  # scales of Cauchy's distribution add up as they are
        first, last = np.log(shape.range_m(np.array(self.seen_px)))
        outside = _NEARER * np.maximum(first - base, 0.0) + _BEYOND * np.maximum(base - last, 0.0)
        return np.sqrt(variance + more**2 + outside**2 + _rounded(shape, radius_px) ** 2 + _UPRIGHT**2)


def certainty_of(found: CurveFit, seen: Sequence[Seen], lines: Lines) -> Certainty:
    """The certainty of a fit, whose points scatter as it supposes or in groups that err together (Huber's sandwich),

    whichever says more. What no point tells is as uncertain as was supposed. Raises NoFitError where the matrix is
    singular or a variance is not positive.
    """
    fit, expected, _ = found
    size = len(fit.mirror)
    points = linearise(seen, fit, lines)
    residuals = np.abs(points.residuals)
    sigmas_m = points.sigmas_m if expected.wider is None else points.sigmas_m * expected.wider
    shares = 1.0 / (1.0 + (points.distances_m / (WIDTHS[-1] * sigmas_m)) ** 2)
    added = points.rows * (points.distances_m * (shares / sigmas_m) ** 2 / expected.noise)[:, np.newaxis]
    offset = np.concatenate([one.pixels for one in seen]) - fit.mirror[:2]
    sectors = np.floor(np.arctan2(offset[:, 1], offset[:, 0]) / (2.0 * np.pi) * _SECTORS).astype(np.int64)
    inverse = _inverse(fit.matrix)
    measured = (points.rows * ((shares / sigmas_m) ** 2 / expected.noise)[:, np.newaxis]).T @ points.rows
    supposed = fit.matrix - measured
    scatters = [measured, *(_scatter(added, groups) for groups in (_cells(points.places), sectors))]
    whole = np.array([inverse @ (scatter + supposed) @ inverse for scatter in scatters])
    variances = np.diagonal(whole, axis1=1, axis2=2).max(axis=0)
    if not np.all((variances > 0.0) & np.isfinite(variances)):
        raise NoFitError(SINGULAR)
    deviations = np.sqrt(variances)
    radii = np.hypot(*offset.T)[residuals < WIDTHS[-1]]
    first, last = np.percentile(radii, _SEEN).tolist() if len(radii) else (0.0, 0.0)
    return Certainty(
        whole[:, :size, :size],
        deviations[:2],
        np.hypot(deviations[4:SHAPE], _BENT_PER_M),
        residuals,
        np.abs(points.distances_m),
        _kinks(found, inverse),
        (first, last),
        (fit.edge_m, float(deviations[-1])),
    )


def _inverse(matrix: FloatArray) -> FloatArray:
    try:
        return np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        raise NoFitError(SINGULAR) from None


def _rounded(shape: MirrorShape, radius_px: FloatArray) -> FloatArray:
    """How far (N,), as a share of the range, kinks near radii (N,) may be rounded off between the knots."""
    second = np.diff(shape.parameters[SHAPE:], n=2)
    if not len(second):
        return np.zeros(len(radius_px))
    first = np.clip((radius_px / shape.knot_px).astype(np.intp), 0, len(second) - 1)
    near = second[np.clip(first[:, np.newaxis] + np.arange(-2, 4), 0, len(second) - 1)]
    return _KINKS * (near.max(axis=1) - near.min(axis=1))


def _kinks(found: CurveFit, inverse: FloatArray) -> FloatArray:
    """What one kink more at each knot would do (J, Q), as large as Cauchy's distribution has one with 68 %."""
    fit, _, curvature = found
    size = len(fit.mirror)
    curve = fit.mirror[SHAPE:]
    second = np.diff(np.eye(len(curve)), n=2, axis=0)
    weights, doubled = curve_weights(curve, curvature), second @ inverse[SHAPE:size, :size]
    variances = np.sum(doubled[:, SHAPE:] * second, axis=1)
    information = np.maximum(1.0 / variances - weights, 0.0)  # by the points, of each
    sizes = (information + (_WITHIN * curvature) ** -2.0) ** -0.5
    return (sizes * weights)[:, np.newaxis] * doubled


def _scatter(rows: FloatArray, groups: IntArray) -> FloatArray:
    _, index = np.unique(groups, return_inverse=True)
    sums = np.zeros((index.max() + 1, rows.shape[1]))
    np.add.at(sums, index, rows)
    count = len(sums)
    few = count / max(count - 1.0, 1.0)
    return few * sums.T @ sums


def _cells(points: FloatArray) -> IntArray:
    cells = np.clip(np.floor(points / _CELL_M), -500, 500).astype(np.int64)
    return cells[:, 0] * 1001 + cells[:, 1]


class Alone(NamedTuple):
    """How far an image alone has the centre (2,) from where all have it (px) and, as a share, the range in the middle
    of its points; with standard deviations.
    """

    offset_px: FloatArray
    sigma_px: FloatArray
    range_ratio: float
    range_sigma: float

    def __str__(self) -> str:
        off_px, sigma_px = float(np.hypot(*self.offset_px)), float(self.sigma_px.max())
        return (
            f"alone has the mirror's centre {off_px:.1f} px (± {sigma_px:.1f}) from where all images have it, and its "
            f"ranges {100 * self.range_ratio:+.1f} % (± {100 * self.range_sigma:.1f})"
        )

    @property
    def is_another(self) -> bool:
        """Whether that is more than chance, and than one robot's head does from image to image."""
        off_px = np.abs(self.offset_px) > np.maximum(SURELY * self.sigma_px, APART_PX)
        return bool(off_px.any()) or abs(self.range_ratio) > max(SURELY * self.range_sigma, APART_RATIO)


def each_alone(found: CurveFit, seen: Sequence[Seen], lines: Lines) -> tuple[Alone, ...]:
    """Each image's own centre and ranges beside those of a fit to all, which bend and curve are taken from."""
    return tuple(_alone(found, k, one, lines) for k, one in enumerate(seen)) if len(seen) > 1 else ()


def _alone(found: CurveFit, k: int, one: Seen, lines: Lines) -> Alone:
    together = found.fit
    held = np.diag(np.where(np.arange(len(together.mirror)) >= BEND_X, HELD, 0.0))
    # a line in the tail of Cauchy's distribution would take up another range
    expected = found.expected._replace(
        mean=together.mirror, information=held, wider=None, edge_m=STRAIGHT_M, together=together
    )
    fit = fit_in_steps([one], together._replace(poses=together.poses[k : k + 1]), expected, lines)
    try:
        certainty = certainty_of(CurveFit(fit, expected, found.curvature), [one], lines)
    except NoFitError:  # alone it tells nothing
        return Alone(np.zeros(2), np.full(2, np.inf), 0.0, np.inf)
    own, all_of_them = (MirrorShape(each.mirror, 1, one.knot_px, np.zeros(2)) for each in (fit, together))
    radii, good = np.hypot(*(one.pixels - own.axis).T), certainty.residuals < WIDTHS[-1]
    middle = np.array([np.median(radii[good] if good.any() else radii)])
    ratio = float(own.range_m(middle)[0] / all_of_them.range_m(middle)[0]) - 1.0
    sigma = float(certainty.range_ratio(own, middle)[0])
    return Alone(own.axis - all_of_them.axis, certainty.center_px, ratio, sigma)
