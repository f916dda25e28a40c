"""From images: the mirror's circle, line points through a generic mirror, a calibration, and both once again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np

from touchline.calibration.lines.calibration import LineCalibration, calibrate_points, refined_again
from touchline.calibration.lines.equations import HEIGHT_M, WIDTHS
from touchline.camera import OmniCamera
from touchline.camera.uncertainty import CameraUncertainty
from touchline.errors import NoFitError
from touchline.field import FieldModel
from touchline.geometry import FloatArray
from touchline.perception.colour import NoCarpetError
from touchline.perception.line_points import LinePointDetector
from touchline.types import ImageArray

_FARTHER = 2.0  # how far beyond the last point the mirror is continued, as a ratio of ranges
_UNKNOWN = 0.05  # standard deviation of a range, as a share, from which it is none
_MIN_POINTS = 8  # of an image that takes part: its pose has three unknowns
_SAME_PX = 4.0  # a point of the first look this near to one of the second is the same
_SIDE_PX = 240  # images are shrunk to this for the circle
_DIRECTIONS = 120
_STEEP = 12.0  # grey levels per pixel from which an edge counts no more: a few strong ones must not decide
_RADII = (0.3, 0.56)  # of the image's smaller side
_ASIDE = 0.12  # how far the circle's middle may be from the image's, as a share of that side
_GENERIC_M, _GENERIC_RAD = 1.6, 1.3  # r = 1.6 tan(1.3 rho / R): near most teams' mirrors
_INNER, _OUTER = 0.14, 0.97  # of the circle's radius: where most robots' bodies end, and the rim


@dataclass(frozen=True, eq=False)
class ImageCalibration:
    """A calibration from images: the mirror's circle, the generic camera it began with, the camera that it gives, and
    which of the images show enough points to take part.
    """

    circle: Circle
    before: OmniCamera
    camera: OmniCamera
    lines: LineCalibration
    used: tuple[int, ...]


def calibrate_images(
    images: Sequence[ImageArray], field: FieldModel, handedness: int = 1, mount_yaw_rad: float = 0.0, seed: int = 0
) -> ImageCalibration:
    """Calibrate from images (H, W, 3), B, G, R, all of one size, of one robot.

    Raises NoFitError where they don't tell, with the reason.
    """
    circle = mirror_circle(images)
    size = (images[0].shape[1], images[0].shape[0])
    before = generic_camera(circle, size)
    try:
        found = points_through(before, images, field.line_width)
        used = tuple(k for k, one in enumerate(found) if len(one) >= _MIN_POINTS)
        if not used:
            raise NoFitError(f"no image shows {_MIN_POINTS} line points: is there light enough, and the view free?")
        pixels = [found[k] for k in used]
        lines = calibrate_points(pixels, circle.center, circle.radius_px, field, handedness, seed)
        rough = camera_of(lines, size, _INNER * circle.radius_px, circle.radius_px)
        again = points_through(rough, [images[k] for k in used], field.line_width)
    except NoCarpetError as error:
        raise NoFitError(f"no line points can be found: {error}") from None
    pixels = merged_looks(lines, again)
    lines = refined_again(lines, pixels, circle.center, circle.radius_px, field)
    camera = known_camera(lines, size, _INNER * circle.radius_px, circle.radius_px, mount_yaw_rad)
    return ImageCalibration(circle, before, camera, lines, used)


def merged_looks(lines: LineCalibration, again: Sequence[FloatArray]) -> list[FloatArray]:
    """The points of the second look, and those that the calibration used, lay on lines and are not among them.

    Where the paint is not as wide as the field says, each look misses some.
    """
    ends = np.cumsum([len(one) for one in lines.pixels])  # fewer than were found: those on penalty marks are left out
    on_line = np.split(lines.certainty.residuals < WIDTHS[-1], ends[:-1])
    merged = []
    for old, good, new in zip(lines.pixels, on_line, again, strict=True):
        kept = old[good]
        if len(new):
            gaps = np.hypot(*np.moveaxis(kept[:, np.newaxis] - new, -1, 0)).min(axis=1)
            kept = kept[gaps > _SAME_PX]
        merged.append(np.concatenate((new, kept)))
    return merged


def camera_of(
    lines: LineCalibration, size: tuple[int, int], inner_px: float, rim_px: float, mount_yaw_rad: float = 0.0
) -> OmniCamera:
    """The camera of a calibration, continued from the last point to twice its range, or to the mirror's rim."""
    radii = np.arange(lines.last_px, max(rim_px, lines.last_px) + 0.5, 0.5)
    ranges = lines.shape.range_m(radii)
    outer = float(radii[ranges <= _FARTHER * ranges[0]][-1])
    camera = lines.shape.camera(size, inner_px, outer, mount_yaw_rad)
    return replace(camera, stated_uncertainty=_uncertainty(lines))


def known_camera(
    lines: LineCalibration, size: tuple[int, int], inner_px: float, rim_px: float, mount_yaw_rad: float = 0.0
) -> OmniCamera:
    """That camera, as far inwards and outwards as ranges are known: a kink where no point lies may be anything."""
    camera = camera_of(lines, size, inner_px, rim_px, mount_yaw_rad)
    radii = np.arange(camera.inner_radius_px, camera.outer_radius_px, 1.0)
    unknown = radii[lines.certainty.range_ratio(lines.shape, radii) > _UNKNOWN]
    first = float(np.max(unknown[unknown < lines.first_px], initial=camera.inner_radius_px))
    last = float(np.min(unknown[unknown > lines.last_px], initial=camera.outer_radius_px))
    return replace(camera, inner_radius_px=first, outer_radius_px=last)


def _uncertainty(lines: LineCalibration) -> CameraUncertainty:
    """How sure a calibration is between its nearest and farthest points.

    Lean and axis are uncertain together, and one makes up for most of the other: the lean's deviation covers both, and
    the centre's is that of an upright mirror.
    """
    sure = lines.certainty
    leans_deg = float(np.degrees(0.5 * HEIGHT_M * sure.bend_per_m.max()))
    return CameraUncertainty(leans_deg, float(sure.center_px.max()), min(lines.range_ratio, 0.5))


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
    outwards = np.column_stack((np.cos(angles), np.sin(angles)))
    u, v = (part.ravel() for part in np.meshgrid(us, vs))
    columns = np.rint(u[:, np.newaxis] + radius * outwards[:, 0]).astype(int)
    rows = np.rint(v[:, np.newaxis] + radius * outwards[:, 1]).astype(int)
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    found = slopes[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)]
    darker = np.clip(-np.sum(found * outwards, axis=-1), -1.0, _STEEP) * inside
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
