"""The strip, measured below the pixel: its axis in the image and the radii of its edges along it."""

from __future__ import annotations

import itertools

import numpy as np

from touchline.calibration.strip import Strip, View
from touchline.errors import InputError
from touchline.geometry import FloatArray

_FINE_PX = 0.25
_BESIDE_PX = (-2.0, -1.0, 0.0, 1.0, 2.0)  # parallel profiles that are averaged: all on the strip, at 6.5 m too
_WIDTH_TOLERANCE = 0.25


def axis_points(view: View, center: FloatArray, angle: float, radii_px: FloatArray, strip: Strip) -> FloatArray:
    """Middles (N, 2) u, v of the strip's rectangles, N <= E - 1, from their two long sides; found on arcs.

    A rectangle whose width in the image is not that of the strip (a rod lies across it) is left out.
    """
    points = []
    for k, (near, far) in enumerate(itertools.pairwise(radii_px)):
        radius, range_m = 0.5 * (near + far), 0.5 * (strip.edges_m[k] + strip.edges_m[k + 1])
        half = np.arctan2(strip.half_width_m, range_m)
        offsets = np.arange(-2.0 * half - 4.0 / radius, 2.0 * half + 4.0 / radius, _FINE_PX / radius)
        light = np.zeros(len(offsets))
        for share in (-0.2, 0.0, 0.2):
            r = radius + share * (far - near)
            u, v = center[0] + r * np.cos(angle + offsets), center[1] + r * np.sin(angle + offsets)
            light += view.sample(u[np.newaxis], v[np.newaxis])[0] / 3.0
        inside = np.median(light[np.abs(offsets) < 0.5 * half])
        sides = []
        for side in (-1, 1):
            beyond = light[(side * offsets > 1.3 * half) & (side * offsets < 1.9 * half + 3.0 / radius)]
            level = 0.5 * (inside + np.median(beyond))
            crossed = _crossings(offsets, light, level)
            crossed = crossed[side * crossed > 0]
            if len(crossed):
                sides.append(crossed[np.argmin(np.abs(np.abs(crossed) - half))])
        if len(sides) == 2 and abs((sides[1] - sides[0]) / (2.0 * half) - 1.0) < _WIDTH_TOLERANCE:
            middle = angle + 0.5 * (sides[0] + sides[1])
            points.append((center[0] + radius * np.cos(middle), center[1] + radius * np.sin(middle)))
    return np.array(points).reshape(-1, 2)


def common_center(axes: list[FloatArray]) -> FloatArray:
    """The point (2,) u, v nearest to all axes, each given by points (N, 2) on it (least squares, outliers trimmed)."""
    origins, normals = [], []
    for points in axes:
        middle = points.mean(axis=0)
        direction = np.linalg.svd(points - middle)[2][0]
        origins.append(middle)
        normals.append((-direction[1], direction[0]))
    normal, along = np.array(normals), np.einsum("ij,ij->i", normals, origins)
    keep = np.ones(len(along), dtype=np.bool_)
    center = np.zeros(2)
    for _ in range(3):
        center = np.linalg.lstsq(normal[keep], along[keep], rcond=None)[0]
        off = np.abs(normal @ center - along)
        keep = off <= max(3.0 * 1.4826 * float(np.median(off)), 0.5)
    return center


def measure_edges(view: View, center: FloatArray, angle: float, rough_px: FloatArray, strip: Strip) -> FloatArray:
    """Radii (E,) px of the edges along an angle, where the light is half way between the two sides' levels.

    rough_px: (E,) where to look. Raises InputError, without the image's name, if an edge is not where it should be.
    """
    gaps = np.diff(rough_px)
    lengths = np.concatenate(([min(gaps[0], 10.0)], gaps, [min(gaps[-1], 10.0)]))
    r = np.arange(rough_px[0] - lengths[0], rough_px[-1] + lengths[-1], _FINE_PX)
    beside = np.array(_BESIDE_PX)[:, np.newaxis]
    cosine, sine = np.cos(angle), np.sin(angle)
    light = view.sample(center[0] + r * cosine - beside * sine, center[1] + r * sine + beside * cosine).mean(axis=0)
    bounds = np.concatenate(([rough_px[0] - lengths[0]], rough_px, [rough_px[-1] + lengths[-1]]))
    levels = []
    for a, b in itertools.pairwise(bounds):
        levels.append(np.median(light[(r > a + 0.3 * (b - a)) & (r < b - 0.3 * (b - a))]))
    levels[0] = _carpet_beside(view, center, angle, rough_px, strip, 0, levels[0])
    levels[-1] = _carpet_beside(view, center, angle, rough_px, strip, len(rough_px) - 2, levels[-1])
    edges = np.empty(len(rough_px))
    for k, rough in enumerate(rough_px):
        if np.sign(levels[k + 1] - levels[k]) != strip.signs[k]:
            raise InputError(f"{edge_name(strip, k)} is out of order: it should get {_tone(strip, k)} there")
        crossed = _crossings(r, light, 0.5 * (levels[k] + levels[k + 1]))
        near = crossed[np.abs(crossed - rough) < 0.5 * min(lengths[k], lengths[k + 1])]
        if len(near) == 0:
            raise InputError(f"{edge_name(strip, k)} is not found near {rough:.0f} px from the centre")
        edges[k] = near[np.argmin(np.abs(near - rough))]
    return edges


def _carpet_beside(
    view: View, center: FloatArray, angle: float, edges_px: FloatArray, strip: Strip, k: int, ahead: float
) -> float:
    """Brightness of the ground around the strip's first or last rectangle k: the middle one of what lies on its left,
    on its right and ahead (given). A line or wall right behind the strip leaves too little of the ground to be seen.
    """
    radius = 0.5 * (edges_px[k] + edges_px[k + 1])
    half = np.arctan2(strip.half_width_m, 0.5 * (strip.edges_m[k] + strip.edges_m[k + 1]))
    offsets = np.linspace(1.4, 2.0, 9) * half + 1.5 / radius
    candidates = [ahead]
    for side in (-1.0, 1.0):
        at = angle + side * offsets
        u, v = center[0] + radius * np.cos(at), center[1] + radius * np.sin(at)
        candidates.append(float(np.median(view.sample(u[np.newaxis], v[np.newaxis]))))
    return float(np.median(candidates))


def edge_name(strip: Strip, k: int) -> str:
    """An edge as messages name it."""
    return f"edge {k + 1} of {len(strip.edges_m)} ({strip.edges_m[k]:g} m)"


def _tone(strip: Strip, k: int) -> str:
    return "brighter outwards" if strip.signs[k] > 0 else "darker outwards"


def _crossings(x: FloatArray, y: FloatArray, level: float) -> FloatArray:
    """Where y crosses a level, by linear interpolation."""
    above = y > level
    k = np.flatnonzero(above[1:] != above[:-1])
    crossings: FloatArray = x[k] + (level - y[k]) / (y[k + 1] - y[k]) * (x[k + 1] - x[k])
    return crossings
