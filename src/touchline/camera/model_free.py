"""Calibration without a model of the mirror: range and bearing tables from edges seen at known places on the ground.

After Voigtländer et al., as section 3.2 of Lu et al. (2013) uses it: the edges seen in one direction are its support
vectors; Lagrange interpolation gives range and bearing between them, first along the radius, then around the centre.
"""

from typing import NamedTuple

import numpy as np

from touchline.camera.omni import OmniCamera
from touchline.camera.uncertainty import CameraUncertainty
from touchline.errors import InputError
from touchline.geometry import FloatArray

SUPPORT = 4  # nearest support vectors of an interpolation: one polynomial through 15 amplifies their noise 277-fold
ROWS = 72  # directions of the written table: linear interpolation between rows 5° apart adds 0.1 % of a tilt's effect
BEYOND = 2.0  # beyond the last edge the range is continued to so many times that edge's range, and radius at most ...
WITHIN = 0.5  # ... and inside the first one to so many times that
# what a calibration is never surer of: a mount that settles, a strip that is misread by millimetres
MIN_UNCERTAINTY = CameraUncertainty(0.02, 0.05, 0.002)
_HARMONICS = 3  # of the radii around the mirror, per edge: what a mirror askew shows; the rest is noise
_HEIGHT_M = 0.75


def lagrange(x: FloatArray, y: FloatArray, at: FloatArray, support: int = SUPPORT) -> FloatArray:
    """Lagrange interpolation (M, ...) at (M,) through the `support` nearest of the points x (N,) ascending, y (N, ...).

    Nearest: as many on one side as on the other, as far as there are any. support 0: one polynomial through all points.
    """
    n = min(support, len(x)) or len(x)
    first = np.clip(np.searchsorted(x, at) - n // 2, 0, len(x) - n)
    if n % 2:  # an odd number leans to the side of the nearer point
        first = np.clip(np.argmin(np.abs(x[:, np.newaxis] - at), axis=0) - n // 2, 0, len(x) - n)
    chosen = first[:, np.newaxis] + np.arange(n)
    xs = x[chosen]
    weights = np.ones_like(xs)
    for j in range(n):
        for m in range(n):
            if m != j:
                weights[:, j] *= (at - xs[:, m]) / (xs[:, j] - xs[:, m])
    return np.einsum("mj,mj...->m...", weights, y[chosen])


def periodic_lagrange(angles_rad: FloatArray, y: FloatArray, at_rad: FloatArray, support: int = SUPPORT) -> FloatArray:
    """The same around a circle: angles (N,) in any order, no two alike; y (N, ...); at (M,) any angles."""
    turn = 2.0 * np.pi
    wrapped = np.mod(angles_rad, turn)
    order = np.argsort(wrapped)
    x, rows = wrapped[order], y[order]
    around = np.concatenate((x - turn, x, x + turn))
    return lagrange(around, np.concatenate((rows, rows, rows)), np.mod(at_rad, turn), support)


def table_radii(radii_px: FloatArray, ranges_m: FloatArray) -> FloatArray:
    """The radii (R,) of a table for edges at radii (B, E), whole pixels: from the first edge of any direction to the
    last of any, and further as far as every direction can be continued. Raises InputError where an edge is not seen.
    """
    inner, outer = _ends(radii_px, ranges_m)
    first = min(float(radii_px[:, 0].min()) - 1.0, float(inner.max()))
    last = max(float(radii_px[:, -1].max()) + 1.0, float(outer.min()))
    if not np.isfinite((first, last)).all():
        raise InputError("edges of the strip lie where the mirror shows no ground: it is tilted too far to calibrate")
    return np.arange(max(np.floor(first), 0.0), np.ceil(last) + 1.0)


def ranges_along(radii_px: FloatArray, ranges_m: FloatArray, at_px: FloatArray, support: int = SUPPORT) -> FloatArray:
    """Ranges (B, R) at radii (R,) in each direction, from its edges at radii (B, E) and ranges (E,).

    Between the edges the logarithm of the range is interpolated: relative errors count. Inside the first edge the
    range goes on along the chord of the first interval down to half of the first range, from there on it shrinks
    exponentially. Beyond the last edge the reciprocal range goes on along the chord of the last interval, for it falls
    evenly towards the horizon, where it is 0; from twice the last range on the range grows linearly.
    """
    rows = []
    inner, outer = _ends(radii_px, ranges_m)
    near, far = _first_slopes(radii_px, ranges_m), _last_slopes(radii_px, ranges_m)
    start, end = WITHIN * ranges_m[0], BEYOND * ranges_m[-1]
    for d, edges in enumerate(radii_px):
        row = np.exp(lagrange(edges, np.log(ranges_m), np.clip(at_px, edges[0], edges[-1]), support))
        inside, past = at_px < edges[0], at_px > edges[-1]
        row[inside] = ranges_m[0] + near[d] * (at_px[inside] - edges[0])
        row[past] = 1.0 / np.maximum(1.0 / ranges_m[-1] + far[d] * (at_px[past] - edges[-1]), 1.0 / end)
        innermost, outermost = at_px < inner[d], at_px > outer[d]
        row[innermost] = start * np.exp((at_px[innermost] - inner[d]) * near[d] / start)
        row[outermost] = end - far[d] * end**2 * (at_px[outermost] - outer[d])
        rows.append(row)
    return np.array(rows)


def offsets_along(
    radii_px: FloatArray, offsets_rad: FloatArray, at_px: FloatArray, support: int = SUPPORT
) -> FloatArray:
    """Bearing offsets (B, R) at radii (R,) in each direction, from those at its edges (B, E) at radii (B, E); inside
    the first and beyond the last edge as there.
    """
    clipped = [np.clip(at_px, edges[0], edges[-1]) for edges in radii_px]
    rows = zip(radii_px, offsets_rad, clipped, strict=True)
    return np.array([lagrange(edges, row, at, support) for edges, row, at in rows])


class Edges(NamedTuple):
    """Edges at ground ranges ranges_m (E,) as seen in directions of bearings_rad (B,) (base frame).

    radii_px (B, E): where they are seen. offsets_rad (B, E): by how much the true bearing is more than the camera's
    formula with its mount_yaw has it there.
    """

    bearings_rad: FloatArray
    offsets_rad: FloatArray
    radii_px: FloatArray
    ranges_m: FloatArray


def calibrated_camera(
    edges: Edges,
    *,
    size: tuple[int, int],
    center: tuple[float, float],
    handedness: int,
    mount_yaw_rad: float,
    inner_radius_px: float,
    support: int = SUPPORT,
) -> OmniCamera:
    """The camera whose tables agree with the edges.

    size: width, height. inner_radius_px: where the robot's own body ends; the field is seen from there on, or from
    the table's first radius if that is larger, up to the table's last radius. support: edges of a direction that each
    polynomial along it goes through; 0 for all of them.
    """
    radii = table_radii(edges.radii_px, edges.ranges_m)
    logs = np.log(ranges_along(edges.radii_px, edges.ranges_m, radii, support))
    offsets = offsets_along(edges.radii_px, edges.offsets_rad, radii, support)
    rows = np.arange(ROWS) * (2.0 * np.pi / ROWS)
    table = np.empty((ROWS, len(radii), 2))
    for k in range(len(radii)):  # at each radius the strips are seen in slightly other directions
        pairs = np.column_stack((logs[:, k], offsets[:, k]))
        table[:, k] = periodic_lagrange(edges.bearings_rad - offsets[:, k], pairs, rows)
    inner = max(inner_radius_px, float(radii[0]))
    return OmniCamera(
        *size, center, inner, float(radii[-1]), handedness, mount_yaw_rad, radii, rows,
        np.exp(table[..., 0]), table[..., 1], stated_uncertainty=edges_uncertainty(edges),
    )  # fmt: skip


def edges_uncertainty(edges: Edges) -> CameraUncertainty:
    """How sure a calibration from edges is: from how far those of one range scatter about a smooth curve around the
    mirror, what tilt, centre and scale would take up of it.
    """
    turns = edges.bearings_rad[:, np.newaxis] * np.arange(1, _HARMONICS + 1)
    around = np.column_stack((np.ones(len(turns)), np.cos(turns), np.sin(turns)))
    free = max(len(around) - around.shape[1], 1)
    smooth = around @ np.linalg.lstsq(around, edges.radii_px, rcond=None)[0]
    noise_px = float(np.sqrt(np.mean(np.square(edges.radii_px - smooth)) * len(around) / free))
    ranges, radii = edges.ranges_m, edges.radii_px.mean(axis=0)
    m_per_px = np.gradient(ranges, radii)
    askew = np.column_stack(((ranges**2 + _HEIGHT_M**2) / m_per_px, np.ones(len(ranges))))  # px per 1/m of g, and of c
    variances = np.diag(np.linalg.inv(askew.T @ askew)) * 2.0 * noise_px**2 / len(turns)
    tilt_deg = float(np.degrees(0.5 * _HEIGHT_M * np.sqrt(variances[0])))
    scale = noise_px / np.sqrt(len(turns) * np.sum((ranges / m_per_px) ** 2))
    found = (tilt_deg, float(np.sqrt(variances[1])), float(scale))
    return CameraUncertainty(*(float(np.hypot(*pair)) for pair in zip(found, MIN_UNCERTAINTY, strict=True)))


def range_image(camera: OmniCamera) -> FloatArray:
    """The distance map: the ground range (H, W) of every pixel (m); NaN where the table has none."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float64)
    ground = camera.ground_from_image(np.column_stack((u.ravel(), v.ravel())))
    return np.hypot(*ground.T).reshape(camera.height, camera.width)


def _first_slopes(radii_px: FloatArray, ranges_m: FloatArray) -> FloatArray:
    """Range by radius (m/px) between the first two edges, (B,)."""
    return (ranges_m[1] - ranges_m[0]) / (radii_px[:, 1] - radii_px[:, 0])


def _last_slopes(radii_px: FloatArray, ranges_m: FloatArray) -> FloatArray:
    """Reciprocal range by radius (1/(m px)) between the last two edges, (B,)."""
    return (1.0 / ranges_m[-1] - 1.0 / ranges_m[-2]) / (radii_px[:, -1] - radii_px[:, -2])


def _ends(radii_px: FloatArray, ranges_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Radii (B,) at which half of the first range and twice the last one are reached, or twice the last radius."""
    flattest = (1.0 / BEYOND - 1.0) / ranges_m[-1] / ((BEYOND - 1.0) * radii_px[:, -1])
    inner = radii_px[:, 0] - (1.0 - WITHIN) * ranges_m[0] / _first_slopes(radii_px, ranges_m)
    outer = radii_px[:, -1] - (1.0 - 1.0 / BEYOND) / ranges_m[-1] / np.minimum(
        _last_slopes(radii_px, ranges_m), flattest
    )
    return inner, outer
