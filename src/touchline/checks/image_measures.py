"""What one image tells about its camera: brightness, sharpness, the rim of the mirror, which way it turns."""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from touchline.geometry import FloatArray
from touchline.types import ImageArray

_SATURATED = 250
_MIN_EDGE = 8.0  # a 98th percentile of the half-size Laplacian below this is no texture to judge sharpness by
_RAYS = 180
_TRIPLES = 300
_RIM_TOLERANCE_PX = 1.5
_BEARINGS = 360
_RINGS = 12

Mask = npt.NDArray[np.uint8]
GrayArray = npt.NDArray[Any]  # what OpenCV's type hints return for uint8


class Exposure(NamedTuple):
    """Of the green channel inside the mask: mean (0..255) and the fraction of saturated pixels."""

    mean: float
    saturated: float


class Rim(NamedTuple):
    """A circle fitted to the edge of the mirror's disc. support: fraction of the rays that agree within 1.5 px."""

    u: float
    v: float
    radius_px: float
    support: float


def ring_mask(width: int, height: int, center: tuple[float, float], inner_px: float, outer_px: float) -> Mask:
    """uint8 (H, W), 255 between the two radii."""
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    radius = np.hypot(u - center[0], v - center[1])
    return np.where((radius > inner_px) & (radius < outer_px), 255, 0).astype(np.uint8)


def measure_exposure(image: ImageArray, mask: Mask) -> Exposure:
    """Brightness of an image, uint8 (H, W, 3), where the mask is set."""
    counts = cv2.calcHist([image], [1], mask, [256], [0, 256]).ravel()
    total = max(float(counts.sum()), 1.0)
    return Exposure(float(counts @ np.arange(256)) / total, float(counts[_SATURATED:].sum()) / total)


def measure_sharpness(image: ImageArray, mask: Mask) -> float:
    """Strength of the strongest edges against the same edges at half the size; NaN without texture.

    The scene cancels out: about 0.6 to 1 for an image in focus, 0.4 for a blur of 1 px (sigma), 0.33 from 2 px on.
    """
    green = np.ascontiguousarray(image[:, :, 1])
    half = cv2.pyrDown(green)
    inside = cv2.erode(mask, np.ones((5, 5), np.uint8))
    half_inside = cv2.resize(inside, (half.shape[1], half.shape[0]), interpolation=cv2.INTER_NEAREST)
    fine, coarse = _strong_edge(green, inside), _strong_edge(half, half_inside)
    return fine / coarse if coarse >= _MIN_EDGE else float("nan")


def fit_rim(image: ImageArray, center: tuple[float, float], outer_px: float) -> Rim | None:
    """The edge of the mirror's disc near an expected circle; None if no three rays agree.

    On each ray the steepest fall of brightness outwards between 0.8 and 1.25 of the expected radius is taken; a circle
    is drawn through many triples of them, and the one that most rays agree with is refined by least squares (Kasa).
    """
    edges = _falls_along_rays(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), center, outer_px)
    if len(edges) < 3:
        return None
    draw = np.random.default_rng(0)
    triples = edges[draw.integers(0, len(edges), size=(_TRIPLES, 3))]
    centers = _circumcenters(triples)
    radii = np.hypot(*(triples[:, 0] - centers).T)
    distances = np.hypot(edges[None, :, 0] - centers[:, None, 0], edges[None, :, 1] - centers[:, None, 1])
    agree = np.abs(distances - radii[:, None]) < _RIM_TOLERANCE_PX  # NaN (three on a line) agrees with nothing
    members = agree[int(agree.sum(axis=1).argmax())]
    if members.sum() < 3:
        return None
    u, v, radius = _fit_circle(edges[members])
    return Rim(u, v, radius, float(members.sum()) / _RAYS)


class TurnGauge:
    """Tells which way the image of an omnidirectional camera turns when the robot does."""

    def __init__(self, center: tuple[float, float], outer_px: float) -> None:
        angle = np.arange(_BEARINGS) * (2.0 * np.pi / _BEARINGS)
        radius = np.linspace(0.75, 0.99, _RINGS) * outer_px
        self._u = (center[0] + np.outer(radius, np.cos(angle))).astype(np.float32)
        self._v = (center[1] + np.outer(radius, np.sin(angle))).astype(np.float32)
        self._before: FloatArray | None = None

    def preference(self, image: ImageArray | None, image_turn_rad: float) -> float:
        """How much better the image before fits this one when turned by `image_turn_rad` (u to v) than by its negative.

        In -1..1, the difference of two correlations; NaN for the first image and after a missing one.
        """
        if image is None:
            self._before = None
            return float("nan")
        rings = cv2.remap(image[:, :, 1], self._u, self._v, cv2.INTER_LINEAR).astype(np.float64)
        rings -= rings.mean(axis=1, keepdims=True)
        before, self._before = self._before, rings
        norm = 0.0 if before is None else float(np.linalg.norm(before) * np.linalg.norm(rings))
        if before is None or norm == 0.0:
            return float("nan")
        step = round(image_turn_rad * _BEARINGS / (2.0 * np.pi))
        along, against = np.roll(before, step, axis=1), np.roll(before, -step, axis=1)
        return float(np.sum((along - against) * rings)) / norm


def _strong_edge(channel: GrayArray, mask: GrayArray) -> float:
    """98th percentile of the absolute Laplacian inside the mask."""
    strength = cv2.convertScaleAbs(cv2.Laplacian(channel, cv2.CV_16S))
    counts = np.cumsum(cv2.calcHist([strength], [0], mask, [256], [0, 256]).ravel())
    return float(np.searchsorted(counts, 0.98 * counts[-1])) if counts[-1] > 0 else 0.0


def _falls_along_rays(gray: GrayArray, center: tuple[float, float], outer_px: float) -> FloatArray:
    """(N, 2) pixels where the brightness falls most, one for each ray that has the whole window inside the image."""
    window = 8  # samples of half a pixel on each side of an edge
    angle = np.arange(_RAYS) * (2.0 * np.pi / _RAYS)
    radius = np.arange(0.8 * outer_px, 1.25 * outer_px, 0.5)
    if len(radius) < 2 * window:
        return np.zeros((0, 2))
    u = center[0] + np.outer(np.cos(angle), radius)
    v = center[1] + np.outer(np.sin(angle), radius)
    height, width = gray.shape
    outside = (u < 0) | (u > width - 1) | (v < 0) | (v > height - 1)
    values = cv2.remap(gray, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR).astype(np.float64)
    values[outside] = np.nan
    sums = np.cumsum(np.pad(values, ((0, 0), (1, 0))), axis=1)
    means = (sums[:, window:] - sums[:, :-window]) / window
    fall = np.nan_to_num(means[:, :-window] - means[:, window:], nan=-np.inf)
    best = fall.argmax(axis=1)
    rows = np.flatnonzero(fall[np.arange(_RAYS), best] > 0.0)
    edge = radius[best[rows] + window] - 0.25
    return np.column_stack((center[0] + np.cos(angle[rows]) * edge, center[1] + np.sin(angle[rows]) * edge))


def _circumcenters(triples: FloatArray) -> FloatArray:
    """Centres (N, 2) of the circles through triples (N, 3, 2); NaN where the three lie on a line."""
    a, b = triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0]
    cross = 2.0 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    cross[np.abs(cross) < 1e-6] = np.nan
    aa, bb = np.sum(a * a, axis=1), np.sum(b * b, axis=1)
    offset = np.column_stack((b[:, 1] * aa - a[:, 1] * bb, a[:, 0] * bb - b[:, 0] * aa)) / cross[:, None]
    return triples[:, 0] + offset


def _fit_circle(points: FloatArray) -> tuple[float, float, float]:
    """u, v, radius of the algebraic least-squares circle."""
    system = np.column_stack((2.0 * points, np.ones(len(points))))
    u, v, rest = np.linalg.lstsq(system, np.sum(points**2, axis=1), rcond=None)[0]
    return float(u), float(v), float(np.sqrt(rest + u * u + v * v))
