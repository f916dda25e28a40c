"""Pictures of calibrations. Of colours: an image, and what the table makes of it."""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from touchline.calibration.lines.calibration import LineCalibration
from touchline.calibration.lines.equations import WIDTHS
from touchline.calibration.lines.images import ImageCalibration
from touchline.calibration.perspective import PerspectiveCalibration
from touchline.calibration.self_calibration import SelfCalibration
from touchline.camera import GroundView, OmniCamera, PinholeCamera
from touchline.field import FieldModel
from touchline.field.drawing import draw_field, field_view
from touchline.geometry import BoolArray, FloatArray, Int32Array, Pose
from touchline.palette import BLUE, ORANGE, bgr
from touchline.perception.colour import GREEN as IS_GREEN
from touchline.perception.colour import WHITE as IS_WHITE
from touchline.perception.colour import ColourModel
from touchline.perception.line_graph.colour_classes import CLASSES, GREEN, WHITE, colour_codes
from touchline.perception.line_graph.pictures import SHADES, UNCLASSIFIED
from touchline.perception.stages import SHIFT, Paint, enlarged, fixed_point, titled, with_legend
from touchline.types import ImageArray
from touchline.view.overlay import LINE_COLOR, OFF_LINE_COLOR, ON_LINE_COLOR, draw_rated, projected_lines

_COLOUR_SIDE = 640


def colour_picture(colours: ColourModel, image: ImageArray) -> ImageArray:
    """(S + 40, 2 S, 3) BGR: the image (H, W, 3), and its classes."""
    panels = {
        "image": _fitted(image, cv2.INTER_AREA),
        "classes: green, white, black, coloured, other": _fitted(_painted(colours, image), cv2.INTER_NEAREST),
    }
    return np.hstack([titled(panel, title, _COLOUR_SIDE) for title, panel in panels.items()])


def _painted(colours: ColourModel, image: ImageArray) -> ImageArray:
    """An image (H, W, 3) with each pixel in the colour of its class."""
    codes = colour_codes(image.reshape(-1, 3).astype(np.float64), colours).reshape(image.shape[:2])
    plain = colours.classify(image)
    codes = np.where(plain == IS_GREEN, GREEN, np.where(plain == IS_WHITE, WHITE, codes))
    palette = np.array([*(SHADES[code][1] for code in range(CLASSES)), UNCLASSIFIED], dtype=np.uint8)
    return palette[codes]


def _fitted(image: ImageArray, interpolation: int) -> ImageArray:
    scale = _COLOUR_SIDE / max(image.shape[:2])
    size = (round(image.shape[1] * scale), round(image.shape[0] * scale))
    return np.asarray(cv2.resize(image, size, interpolation=interpolation), dtype=np.uint8)


# --- from lines -------------------------------------------------------------------------------------------------------


_SIDE = 900


def image_picture(found: ImageCalibration, image: ImageArray, field: FieldModel) -> ImageArray:
    """The first image with the field's lines at its pose through the generic mirror and through the calibrated one,

    and the points of all images on the field. BGR.
    """
    lines = found.lines
    pose, pixels = lines.poses[0], lines.pixels[0]
    good = lines.certainty.residuals[: len(pixels)] < WIDTHS[-1]
    front = Pose(pose.x, pose.y, pose.heading - found.camera.mount_yaw_rad)
    panels = [
        titled(_overlay(image, found.before, field, pose, pixels, good), "before: a generic mirror", _SIDE),
        titled(_overlay(image, found.camera, field, front, pixels, good), "after: the calibrated mirror", _SIDE),
    ]
    return np.vstack((np.hstack(panels), _wide(_on_field(lines, field), 2 * _SIDE)))


def points_picture(lines: LineCalibration, field: FieldModel) -> ImageArray:
    """The points as they are given, and on the field. BGR."""
    points = np.concatenate(lines.pixels)
    low, high = points.min(axis=0), points.max(axis=0)
    scale = 0.9 * _SIDE / float((high - low).max())
    canvas: ImageArray = np.full((_SIDE, _SIDE, 3), 24, dtype=np.uint8)
    for (u, v), good in zip(points, lines.certainty.residuals < WIDTHS[-1], strict=True):
        at = (round(0.05 * _SIDE + (u - low[0]) * scale), round(0.05 * _SIDE + (v - low[1]) * scale))
        cv2.circle(canvas, at, 2, ON_LINE_COLOR if good else OFF_LINE_COLOR, -1, cv2.LINE_AA)
    return np.vstack(
        (_wide(titled(canvas, "before: the points in the image", _SIDE), _SIDE), _wide(_on_field(lines, field), _SIDE))
    )


def _overlay(
    image: ImageArray,
    camera: OmniCamera,
    field: FieldModel,
    pose: Pose,
    pixels: FloatArray,
    good: BoolArray,
) -> ImageArray:
    scale = _SIDE / max(image.shape[:2])
    canvas = enlarged(image, scale)
    for line in projected_lines(GroundView(camera), field, pose):
        cv2.polylines(canvas, [fixed_point(line, scale)], False, LINE_COLOR, 1, cv2.LINE_AA, SHIFT)
    for pixel, on_line in zip(pixels, good, strict=True):
        at = fixed_point(pixel[np.newaxis], scale)[0]
        cv2.circle(
            canvas, (int(at[0]), int(at[1])), 32, ON_LINE_COLOR if on_line else OFF_LINE_COLOR, -1, cv2.LINE_AA, SHIFT
        )
    return canvas


def _on_field(lines: LineCalibration, field: FieldModel) -> ImageArray:
    """The field from above with all points where mirror and poses put them."""
    canvas, view = draw_field(field), field_view(field)
    good = lines.certainty.residuals < WIDTHS[-1]
    start = 0
    for pose, pixels in zip(lines.poses, lines.pixels, strict=True):
        own = good[start : start + len(pixels)]
        start += len(pixels)
        draw_rated(canvas, view, pose.transform(lines.shape.ground(pixels)), own, 3)
        u, v = view.picture_from_field(np.array([[pose.x, pose.y]]))[0]
        cv2.circle(canvas, (round(u), round(v)), 10, (0, 0, 220), 3, cv2.LINE_AA)
    return canvas


def _wide(panel: ImageArray, width: int) -> ImageArray:
    height = round(panel.shape[0] * width / panel.shape[1])
    return np.asarray(cv2.resize(panel, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


# --- perspective cameras ----------------------------------------------------------------------------------------------


_WIDTH_PX = 1200
_GRID_M, _STEP_M, _BEYOND_M = 0.5, 0.05, 1.0
_GRID: Paint = (235, 220, 190)
_BLANK = 60


def marks_picture(
    found: PerspectiveCalibration, image: ImageArray | None, pixels: FloatArray, places: FloatArray
) -> ImageArray:
    """The image, BGR, with the ground's half metres, the marks as clicked, and where the camera sees their places.

    image: None where there is none; an empty one stands for it. pixels, places: (N, 2) of the marks; m, robot frame.
    """
    canvas, scale = enlarged_view(found.camera, image)
    view = GroundView(found.camera)
    for line in _half_metres(places):
        seen = view.image_from_ground(line)
        for piece in np.split(seen, np.flatnonzero(~view.sees(seen))):
            inside = piece[view.sees(piece)]
            if len(inside) > 1:
                cv2.polylines(canvas, [fixed_pixels(inside, scale)], False, _GRID, 1, cv2.LINE_AA, SHIFT)
    for at in fixed_pixels(pixels, scale).tolist():
        cv2.drawMarker(
            canvas, (at[0] >> SHIFT, at[1] >> SHIFT), bgr(ORANGE), cv2.MARKER_TILTED_CROSS, 18, 2, cv2.LINE_AA
        )
    known = np.isfinite(places).all(axis=1)
    for at in fixed_pixels(found.camera.image_from_ground(places[known]), scale).tolist():
        cv2.circle(canvas, (at[0], at[1]), 11 << SHIFT, bgr(BLUE), 2, cv2.LINE_AA, SHIFT)
    legend = [("marks", bgr(ORANGE)), ("their places as this camera sees them", bgr(BLUE)), ("half metres", _GRID)]
    return with_legend(canvas, legend)


def enlarged_view(camera: PinholeCamera, image: ImageArray | None) -> tuple[ImageArray, float]:
    """A camera's image (grey without one), enlarged for drawing, and by how much."""
    scale = _WIDTH_PX / camera.width
    if image is None:
        image = np.full((camera.height, camera.width, 3), _BLANK, np.uint8)
    return enlarged(image, scale), scale


def _half_metres(places: FloatArray) -> list[FloatArray]:
    """Lines of the ground (M, 2), half a metre apart, about the marks."""
    known = places[np.isfinite(places).all(axis=1)]
    low, high = (
        _GRID_M * np.round(end / _GRID_M) for end in (known.min(axis=0) - _BEYOND_M, known.max(axis=0) + _BEYOND_M)
    )
    x, y = (np.arange(low[k], high[k] + 1e-6, _STEP_M) for k in (0, 1))
    along = [np.column_stack((np.full(len(y), at), y)) for at in np.arange(low[0], high[0] + 1e-6, _GRID_M)]
    across = [np.column_stack((x, np.full(len(x), at))) for at in np.arange(low[1], high[1] + 1e-6, _GRID_M)]
    return along + across


def fixed_pixels(pixels: FloatArray, scale: float) -> Int32Array:
    """Pixels (N, 2) in the enlarged image as OpenCV's fixed-point numbers; those that are none are left out."""
    limit = 1e4 / scale
    return fixed_point(np.clip(pixels[np.isfinite(pixels).all(axis=1)], -limit, limit), scale)


# --- from a recording -------------------------------------------------------------------------------------------------


_NEAR_M = 0.1


def self_picture(found: SelfCalibration[Any], field: FieldModel) -> ImageArray:
    """Line points, crossings and landmarks: those near lines are blue, others orange. BGR."""
    (before, after), (starts, poses) = found.points_m, found.poses
    return np.vstack((
        _panel(before, starts, field, f"before: {100 * found.before[0]:.0f} % in place"),
        _panel(after, poses, field, f"after: {100 * found.after[0]:.0f} %"),
    ))  # fmt: skip


def _panel(points: Sequence[FloatArray], poses: FloatArray, field: FieldModel, title: str) -> ImageArray:
    canvas, view = draw_field(field), field_view(field)
    for seen, pose in zip(points, poses, strict=True):
        placed = Pose(*pose.tolist()).transform(seen[np.isfinite(seen).all(axis=1)])
        draw_rated(canvas, view, placed, field.line_distances(placed) < _NEAR_M, 2)
    cv2.putText(canvas, title, (20, 40), cv2.FONT_HERSHEY_SIMPLEX, 1.0, (255, 255, 255), 2, cv2.LINE_AA)
    return canvas
