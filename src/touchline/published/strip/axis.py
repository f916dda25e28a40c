"""The strip's axis in the image: the curve along which the middle of the strip is seen.

On the ground it is a straight ray from the robot. A mirror that leans or sits aside bends it by some pixels: seen from
the centre of all axes its angle changes with the radius, by a share for the lean (1, radius) and one for a centre that
is not this axis's own (1 / radius). That describes the simulated mirrors to 0.06 px (0.2 px at the kinks of a composed
one), the lean 1°, the shift 2 mm.
"""

import itertools
from dataclasses import dataclass

import numpy as np

from touchline.geometry import BoolArray, FloatArray, circular_mean, wrap_angles
from touchline.published.strip.strip import Strip, View

FINE_PX = 0.25
_WIDTH_TOLERANCE = 0.1  # of half the strip's width, and in pixels: what it may be seen wider or narrower ...
_WIDTH_TOLERANCE_PX = 1.0
_ASIDE_TOLERANCE = 0.2  # ... and how far the axis may be from where it is looked for
_ASIDE_PX = 4.0
_BESIDE_PX = (1.5, 3.0)  # from a long side: what lies beside it, and no longer blurred into it
_SCALE_PX = 100.0  # of the radius in the curve's three terms, so that these are of one size
_CURVED_FROM = 8  # points that it takes to tell a curve; below it the axis is straight
_ROUNDS = 4


@dataclass(frozen=True, eq=False, slots=True)
class StripAxis:
    """A strip's axis about a centre (2,) u, v. terms: (3,) rad; ends_px: between which radii it was seen; outside of
    them the angle stays as at the end.
    """

    center: FloatArray
    terms: FloatArray
    ends_px: tuple[float, float]

    def angles(self, radii_px: FloatArray) -> FloatArray:
        """Directions (N,) in the image, atan2(v, u), at radii (N,)."""
        return _terms(np.clip(radii_px, *self.ends_px)) @ self.terms

    @property
    def angle_rad(self) -> float:
        """Its direction as a whole: half way between its ends."""
        return float(wrap_angles(self.angles(np.array([0.5 * sum(self.ends_px)])))[0])

    def pixels(self, radii_px: FloatArray, beside_px: FloatArray | float = 0.0) -> tuple[FloatArray, FloatArray]:
        """u, v at radii, and at right angles to the ray from the centre beside it (shapes as NumPy broadcasts)."""
        angles = self.angles(np.atleast_1d(radii_px))
        cosine, sine = np.cos(angles), np.sin(angles)
        return (
            self.center[0] + radii_px * cosine - beside_px * sine,
            self.center[1] + radii_px * sine + beside_px * cosine,
        )


def straight_axis(center: FloatArray, angle_rad: float, radii_px: FloatArray) -> StripAxis:
    """The axis before anything is known but its direction; radii_px: (E,) of the strip's edges."""
    return StripAxis(center, np.array([angle_rad, 0.0, 0.0]), (float(radii_px[0]), float(radii_px[-1])))


def fit_axis(points: FloatArray, center: FloatArray, radii_px: FloatArray) -> StripAxis:
    """The axis through points (N, 2) u, v on it, as pixels count; what lies off it is left out.

    radii_px: (E,) of the strip's edges. Fewer than eight points tell no more than a direction.
    """
    offsets = points - center
    radii, angles = np.hypot(*offsets.T), np.arctan2(offsets[:, 1], offsets[:, 0])
    middle = circular_mean(angles)
    if len(points) < _CURVED_FROM:
        return straight_axis(center, middle, radii_px)
    lateral, terms = wrap_angles(angles - middle) * radii, _terms(radii) * radii[:, np.newaxis]
    solution, keep = trimmed_lstsq(terms, lateral, 0.3)
    if keep.sum() < _CURVED_FROM:
        return straight_axis(center, middle, radii_px)
    seen = radii[keep]
    return StripAxis(center, solution + np.array([middle, 0.0, 0.0]), (float(seen.min()), float(seen.max())))


def axis_points(view: View, axis: StripAxis, radii_px: FloatArray, strip: Strip) -> FloatArray:
    """Middles (N, 2) u, v of the strip's rectangles, N <= E - 1, between their two long sides; found on arcs.

    axis: where to look. A rectangle whose width in the image is not that of the strip is left out, for a rod or a field
    line lies at one of its sides. Where few are left, the sides of the others tell their middles one by one.
    """
    pairs: list[tuple[float, float]] = []
    singles: list[tuple[float, float]] = []
    for k, (near, far) in enumerate(itertools.pairwise(radii_px)):
        radius, range_m = 0.5 * (near + far), 0.5 * (strip.edges_m[k] + strip.edges_m[k + 1])
        angle = float(axis.angles(np.array([radius]))[0])
        half = float(np.arctan2(strip.half_width_m, range_m))
        offsets = np.arange(-2.0 * half - 4.0 / radius, 2.0 * half + 4.0 / radius, FINE_PX / radius)
        light = np.zeros(len(offsets))
        for share in (-0.2, 0.0, 0.2):
            r = radius + share * (far - near)
            u, v = axis.center[0] + r * np.cos(angle + offsets), axis.center[1] + r * np.sin(angle + offsets)
            light += view.sample(u[np.newaxis], v[np.newaxis])[0] / 3.0
        inside = float(np.median(light[np.abs(offsets) < 0.5 * half]))
        sides = [_long_side(side * offsets[::side], light[::side], inside, half, radius) for side in (-1, 1)]
        middles = [angle - (sides[0] - half), angle + (sides[1] - half)]
        if abs(sides[0] + sides[1] - 2.0 * half) < _WIDTH_TOLERANCE * half + _WIDTH_TOLERANCE_PX / radius:
            middles, of_kind = [0.5 * sum(middles)], pairs
        else:
            of_kind = singles
        of_kind += [
            (axis.center[0] + radius * np.cos(middle), axis.center[1] + radius * np.sin(middle))
            for middle in middles
            if abs(middle - angle) < _ASIDE_TOLERANCE * half + _ASIDE_PX / radius  # NaN isn't
        ]
    return np.array(pairs if len(pairs) >= _CURVED_FROM else pairs + singles).reshape(-1, 2)


def _long_side(offsets: FloatArray, light: FloatArray, inside: float, half: float, radius_px: float) -> float:
    """Where a rectangle ends on one side (rad, positive), on an arc: light (N,) at offsets (N,), ascending.

    Half way between the light inside and that right beside it, be it carpet or a field line. NaN if it isn't found.
    """
    outside = float(np.median(light[(offsets > 1.3 * half) & (offsets < 1.9 * half + 3.0 / radius_px)]))
    side = float("nan")
    for _ in range(3):
        crossed = crossings(offsets, light, 0.5 * (inside + outside))
        crossed = crossed[crossed > 0.0]
        if len(crossed) == 0:
            return float("nan")
        side = float(crossed[np.argmin(np.abs(crossed - half))])
        beside = light[(offsets > side + _BESIDE_PX[0] / radius_px) & (offsets < side + _BESIDE_PX[1] / radius_px)]
        outside = float(np.median(beside)) if len(beside) else outside
    return side


def common_center(axes: list[FloatArray]) -> FloatArray:
    """The point (2,) u, v nearest to all axes, each given by points (N, 2) on it (least squares, outliers trimmed)."""
    origins, normals = [], []
    for points in axes:
        middle = points.mean(axis=0)
        direction = np.linalg.svd(points - middle)[2][0]
        origins.append(middle)
        normals.append((-direction[1], direction[0]))
    return trimmed_lstsq(np.array(normals), np.einsum("ij,ij->i", normals, origins), 0.5)[0]


def trimmed_lstsq(
    rows: FloatArray, values: FloatArray, least: float, keep: BoolArray | None = None
) -> tuple[FloatArray, BoolArray]:
    """Least squares of rows (N, K) @ solution (K,) = values (N,) without what lies far off, and what was kept (N,).

    least: deviation that is never far. keep: (N,), what may count at first. NaN never counts.
    """
    keep = np.isfinite(values) if keep is None else keep
    for _ in range(_ROUNDS):
        solution: FloatArray = np.linalg.lstsq(rows[keep], values[keep], rcond=None)[0]
        off = np.abs(rows @ solution - values)
        keep = off <= max(3.0 * 1.4826 * float(np.nanmedian(off)), least)
    return solution, keep


def crossings(x: FloatArray, y: FloatArray, level: float) -> FloatArray:
    """Where y crosses a level, by linear interpolation."""
    above = y > level
    k = np.flatnonzero(above[1:] != above[:-1])
    return x[k] + (level - y[k]) / (y[k + 1] - y[k]) * (x[k + 1] - x[k])


def _terms(radii_px: FloatArray) -> FloatArray:
    return np.stack((np.ones_like(radii_px), radii_px / _SCALE_PX, _SCALE_PX / np.maximum(radii_px, 1.0)), axis=-1)
