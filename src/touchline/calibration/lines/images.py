"""From images: line points through a generic mirror, a first calibration, and points and calibration again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from touchline.calibration.lines.calibration import LineCalibration, calibrate_points, refined_again
from touchline.calibration.lines.equations import HEIGHT_M
from touchline.calibration.lines.image_points import Circle, generic_camera, mirror_circle, points_through
from touchline.calibration.lines.search import WIDTHS
from touchline.camera import OmniCamera
from touchline.camera.uncertainty import CameraUncertainty
from touchline.errors import NoFitError
from touchline.field import FieldModel
from touchline.geometry import FloatArray
from touchline.perception.colour import NoCarpetError
from touchline.types import ImageArray

_FARTHER = 2.0  # how far beyond the last point the mirror is continued, as a ratio of ranges
_UNKNOWN = 0.05  # standard deviation of a range, as a share, from which it is none
_MIN_POINTS = 8  # of an image that takes part: its pose has three unknowns
_SAME_PX = 4.0  # a point of the first look this near to one of the second is the same
_INNER = 0.14  # of the circle's radius: where the robot's body ends on most robots


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
