"""Line points of images whose camera is not known: the mirror's circle, and a generic mirror to begin with."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from touchline.camera import OmniCamera
from touchline.errors import NoFitError
from touchline.geometry import FloatArray
from touchline.perception.line_points import LinePointDetector
from touchline.types import ImageArray

_SIDE_PX = 240  # images are shrunk to this for the circle
_DIRECTIONS = 120
_STEEP = 12.0  # grey levels per pixel from which an edge counts no more: a few strong ones must not decide
_RADII = (0.3, 0.56)  # of the image's smaller side
_ASIDE = 0.12  # how far the circle's middle may be from the image's, as a share of that side
_GENERIC_M, _GENERIC_RAD = 1.6, 1.3  # r = 1.6 tan(1.3 rho / R): near most teams' mirrors
_INNER, _OUTER = 0.14, 0.97  # of the circle's radius: the robot's body, and the rim


class Circle(NamedTuple):
    """The mirror's circle in the image: middle (2,) u, v and radius, px."""

    center: FloatArray
    radius_px: float


def mirror_circle(images: Sequence[ImageArray]) -> Circle:
    """The circle along which images (H, W, 3) turn darkest from the inside out. It need not be whole in the image.

    Raises NoFitError where no circle gets darker.
    """
    brightest = np.max([image.max(axis=2) for image in images], axis=0).astype(np.float32)
    shrink = max(1.0, min(brightest.shape) / _SIDE_PX)
    small = cv2.resize(brightest, None, fx=1.0 / shrink, fy=1.0 / shrink, interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), 1.5)
    slopes = np.stack([cv2.Sobel(small, cv2.CV_32F, *axes, scale=0.125) for axes in ((1, 0), (0, 1))], axis=-1)
    height, width = small.shape
    side = min(small.shape)
    aside = np.arange(-_ASIDE * side, _ASIDE * side + 1.0, 4.0)
    best: FloatArray = np.zeros(4)
    for radius in np.arange(_RADII[0] * side, _RADII[1] * side, 3.0):
        best = _best_circle(slopes, 0.5 * width + aside, 0.5 * height + aside, radius, best)
    if not best[0] > 0.0:
        raise NoFitError(
            "no mirror's circle is found: nowhere does the image get darker around its middle. Is it an image of a "
            "mirror camera?"
        )
    for step in (2.0, 1.0, 0.5):
        _, u, v, radius = best
        near = step * np.arange(-2.0, 3.0)
        for offset in near:
            best = _best_circle(slopes, u + near, v + near, radius + offset, best)
    _, u, v, radius = best * shrink
    return Circle(np.array([u + 0.5 * shrink - 0.5, v + 0.5 * shrink - 0.5]), float(radius))


def _best_circle(slopes: FloatArray, us: FloatArray, vs: FloatArray, radius: float, best: FloatArray) -> FloatArray:
    """The best of circles of one radius about all pairs of us and vs: score, u, v, radius; `best` if none is better."""
    height, width = slopes.shape[:2]
    angles = 2.0 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    away = np.column_stack((np.cos(angles), np.sin(angles)))
    u, v = (part.ravel() for part in np.meshgrid(us, vs))
    columns = np.rint(u[:, np.newaxis] + radius * away[:, 0]).astype(int)
    rows = np.rint(v[:, np.newaxis] + radius * away[:, 1]).astype(int)
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    found = slopes[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)]
    darker = np.clip(-np.sum(found * away, axis=-1), -1.0, _STEEP) * inside
    scores = darker.sum(axis=1) / _DIRECTIONS / np.sqrt(np.maximum(inside.mean(axis=1), 0.5))
    k = int(np.argmax(scores))
    return np.array([scores[k], u[k], v[k], radius]) if scores[k] > best[0] else best


def generic_camera(circle: Circle, size: tuple[int, int]) -> OmniCamera:
    """A usual mirror in a circle of images of a size (width, height)."""
    radii = np.linspace(0.0, circle.radius_px, 64)
    ranges = _GENERIC_M * np.tan(_GENERIC_RAD * radii / circle.radius_px)
    center = (float(circle.center[0]), float(circle.center[1]))
    inner, outer = _INNER * circle.radius_px, _OUTER * circle.radius_px
    return OmniCamera(*size, center, inner, outer, 1, 0.0, radii, np.zeros(1), ranges[np.newaxis])


def points_through(camera: OmniCamera, images: Sequence[ImageArray], line_width_m: float) -> list[FloatArray]:
    """Pixels (N, 2) of line points of each image (H, W, 3), found with a camera that need only be roughly right.

    Raises NoCarpetError where no green carpet is seen.
    """
    detector = LinePointDetector(camera, line_width_m=line_width_m)
    detector.learn(images)
    return [detector.detect(image).pixels for image in images]
