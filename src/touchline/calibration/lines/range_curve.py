"""How the range differs from a tangent: a curve as stiff as the points ask for, and no stiffer.

The curve's second differences from knot to knot follow Cauchy's distribution: mostly small, with a few large ones where
a mirror of several parts has kinks. How small is what makes the points most probable (their evidence, by Laplace's
approximation). So where the points follow a tangent, the range goes on as one beyond them; else nobody knows.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from touchline.calibration.lines.equations import BEND_X, BEND_Y, SHAPE, WIDTHS, Lines, Seen
from touchline.calibration.lines.joint import HELD, Expected, JointFit, crowding, fit_in_steps, fit_jointly, linearise
from touchline.calibration.lines.mirror_shape import MirrorShape, spline_rows
from touchline.geometry import FloatArray

KNOTS = 48  # intervals of the spline between the centre and the outermost point
CURVATURES = (0.0001, 0.0003, 0.001, 0.003, 0.01, 0.03)  # usual size of a second difference between knots
LINE_M = 0.01  # half of all lines lie this near to where the rules say, by tape; the tails are long
_PINNED, _PIN = (20.0, 80.0), 1e-3  # percentiles of the points' radii where the curve is nought: there a and b say all
_ROUNDS = 2  # of weights for Cauchy's distribution
WORTH = 30.0  # by how much the evidence must fall for a looser curve: what else errs looks like one
_INSIDE = 0.7  # of the radius of the innermost points: so far a mirror must be one
_GROWTH = 4.0  # by what factor ranges may grow faster or slower with the radius than those of a tangent
_PATCH = 3.5  # side of the patches of an image (knots) in which points of a line err together
_NOISE = (0.02, 30.0)  # bounds of a point's squared residual


class CurveFit(NamedTuple):
    """A fit with a curve, what was expected in it, and the usual size of the curve's second differences."""

    fit: JointFit
    expected: Expected
    curvature: float


def fit_curve(seen: Sequence[Seen], tangent: JointFit, expected: Expected, lines: Lines, edge_m: float) -> CurveFit:
    """The fit with the curve and the lines' places that the points make most probable, from a fit without either.

    edge_m: how far all lines may usually lie towards their outer edges.
    """
    mirror = np.concatenate((tangent.mirror[:SHAPE], np.zeros(KNOTS + 3)))
    mean = np.concatenate((expected.mean, np.zeros(KNOTS + 3)))
    information = np.zeros((len(mean), len(mean)))
    information[:SHAPE, :SHAPE] = expected.information
    information[SHAPE:, SHAPE:] = _pinned(seen, mirror)
    whole = Expected(mean, information, LINE_M, edge_m)
    path = _path(seen, tangent._replace(mirror=mirror), whole, lines)
    for _ in range(_ROUNDS):
        loosest = path[-1]
        whole = whole._replace(wider=crowding(seen, loosest, lines))
        whole = whole._replace(noise=_noise(seen, loosest, whole, lines))
        path[-1] = _settled(seen, loosest, whole, CURVATURES[len(path) - 1], lines)
    best, evidence = CurveFit(path[0], whole, CURVATURES[0]), np.inf
    for start, curvature in zip(path, CURVATURES, strict=False):
        fit = _settled(seen, start, whole, curvature, lines)
        found = _evidence(fit, whole, curvature)
        if found < evidence - WORTH:
            best, evidence = CurveFit(fit, whole, curvature), found
    return best


def held_upright(found: CurveFit, level: JointFit, seen: Sequence[Seen], lines: Lines) -> CurveFit:
    """The fit with a curve as stiff as `found` has it, of an upright mirror; level: an upright tangent's."""
    information = found.expected.information.copy()
    information[BEND_X, BEND_X] = information[BEND_Y, BEND_Y] = HELD
    expected = found.expected._replace(information=information)
    mirror = np.concatenate((level.mirror[:SHAPE], found.fit.mirror[SHAPE:]))
    return found._replace(
        fit=_settled(seen, level._replace(mirror=mirror), expected, found.curvature, lines), expected=expected
    )


def _path(seen: Sequence[Seen], start: JointFit, whole: Expected, lines: Lines) -> list[JointFit]:
    """Fits ever looser, as long as they are mirrors: a loose curve may put points on lines they don't belong to."""
    path: list[JointFit] = []
    fit = start
    for curvature in CURVATURES:
        fit = fit_in_steps(seen, fit, _stiff(whole, fit.mirror, curvature), lines)
        fit = _settled(seen, fit, whole, curvature, lines)
        if path and not _plausible(seen, fit):
            break
        path.append(fit)
        whole = whole._replace(noise=_noise(seen, fit, whole, lines))
    return path


def _settled(seen: Sequence[Seen], fit: JointFit, expected: Expected, curvature: float, lines: Lines) -> JointFit:
    for _ in range(_ROUNDS):
        fit = fit_jointly(seen, fit, _stiff(expected, fit.mirror, curvature), lines, WIDTHS[-1])
    return fit


def _plausible(seen: Sequence[Seen], fit: JointFit) -> bool:
    """Whether ranges grow with the radius about as the tangent does, where there are points and a way inside."""
    shape = MirrorShape(fit.mirror, 1, seen[0].knot_px, np.zeros(2))
    level = MirrorShape(fit.mirror[:SHAPE], 1, seen[0].knot_px, np.zeros(2))
    radii = np.concatenate([np.hypot(*(one.pixels - shape.center).T) for one in seen])
    first, last = np.percentile(radii, (2.0, 98.0))
    steps = np.arange(_INSIDE * first, last, seen[0].knot_px)
    growth, usual = (np.diff(np.log(one.range_m(steps))) for one in (shape, level))
    return bool(np.all((growth > usual / _GROWTH) & (growth < usual * _GROWTH)))


def _stiff(expected: Expected, mirror: FloatArray, curvature: float) -> Expected:
    """With what is expected of the curve, its second differences weighed as they are in a mirror (Q,)."""
    second = np.diff(np.eye(len(mirror) - SHAPE), n=2, axis=0)
    weights = curve_weights(mirror[SHAPE:], curvature)
    information = expected.information.copy()
    information[SHAPE:, SHAPE:] += second.T @ (weights[:, np.newaxis] * second)
    return expected._replace(information=information)


def curve_weights(curve: FloatArray, curvature: float) -> FloatArray:
    """The weight (K - 2,) of each second difference of a curve (K,), as Cauchy's distribution has it at that size."""
    return 2.0 / (curvature**2 + np.diff(curve, n=2) ** 2)


def _pinned(seen: Sequence[Seen], mirror: FloatArray) -> FloatArray:
    """The information (K, K) that the curve of a mirror (Q,) is nought at two radii."""
    radii = np.concatenate([np.hypot(*(one.pixels - mirror[:2]).T) for one in seen])
    rows = spline_rows(np.percentile(radii, _PINNED), seen[0].knot_px, len(mirror) - SHAPE)
    return rows.T @ rows / _PIN**2


def _evidence(fit: JointFit, expected: Expected, curvature: float) -> float:
    """Minus twice the logarithm of the points' probability, but for what all fits have in common."""
    off = (fit.mirror - expected.mean)[:SHAPE]
    curve, count = fit.mirror[SHAPE:], len(fit.aside_m)
    kinks = np.diff(curve, n=2) / curvature
    cost = fit.cost + off @ expected.information[:SHAPE, :SHAPE] @ off  # of center and bend
    cost += 2.0 * np.sum(np.log1p(kinks**2))
    cost += 2.0 * np.sum(np.log1p((fit.aside_m / expected.line_m) ** 2)) + (fit.edge_m / expected.edge_m) ** 2
    volume = 2.0 * len(kinks) * np.log(curvature) + 2.0 * count * np.log(expected.line_m)
    return float(cost + volume + np.linalg.slogdet(fit.matrix)[1])


def _noise(seen: Sequence[Seen], fit: JointFit, expected: Expected, lines: Lines) -> float:
    """The square of a point's residual, in standard deviations, where points of a line that err together are one."""
    points = linearise(seen, fit, lines)
    residuals = points.residuals if expected.wider is None else points.residuals / expected.wider
    good = np.abs(residuals) < WIDTHS[-1]
    if expected.wider is not None:
        good &= expected.wider < 2.0
    patch = _PATCH * seen[0].knot_px
    cells = np.floor(np.concatenate([one.pixels for one in seen]) / patch)
    keys = np.column_stack((points.image, points.line, cells))[good]
    _, group = np.unique(keys, axis=0, return_inverse=True)
    sums = np.bincount(group.ravel(), residuals[good])
    noise = float(np.sum(sums**2)) / max(int(good.sum()), 1)
    return float(np.clip(noise, *_NOISE))
