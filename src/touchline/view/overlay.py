"""Detected points and the projected field lines drawn over the image: whether a pose is right, at a glance."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from touchline.camera import Camera
from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose, Pose3
from touchline.messages import counted
from touchline.types import ImageArray, LinePoints

ON_LINE_M = 0.15  # a point this near to a line of the model counts as lying on it
LINE_COLOR = (255, 90, 235)  # BGR, as all colours here: magenta, which no field, line or shirt has
ON_LINE_COLOR = (255, 200, 0)
OFF_LINE_COLOR = (0, 120, 255)
UNRATED_COLOR = (255, 200, 0)
_STEP_M = 0.05
_LONGEST_STEP_PX = 40.0
_SHIFT = 4  # OpenCV draws with 4 binary digits below the pixel
_DARK = (20, 20, 20)

IntArray = npt.NDArray[np.int32]


def overlay_image(
    image: ImageArray,
    camera: Camera,
    field: FieldModel | None,
    field_from_robot: Pose | None,
    points: LinePoints | None,
    scale: int = 2,
    base_from_camera: Pose3 | None = None,
) -> ImageArray:
    """The image (H, W, 3) BGR, enlarged `scale` times, with points and field lines drawn over it and a legend below.

    Without a field or pose only the points are drawn. Points nearer than 15 cm to a line of the model have another
    colour than the rest; their size grows with their confidence. base_from_camera: where the camera was; None for its
    place on a robot that does not lean.
    """
    canvas = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC).astype(np.uint8)
    legend: list[tuple[str, tuple[int, int, int]]] = []
    if field is not None and field_from_robot is not None:
        for line in projected_lines(camera, field, field_from_robot, base_from_camera):
            cv2.polylines(canvas, [_fixed_point(line, scale)], False, LINE_COLOR, scale, cv2.LINE_AA, _SHIFT)
        legend.append(("field lines at this pose", LINE_COLOR))
    if points is not None:
        legend += _draw_points(canvas, field, field_from_robot, points, scale)
    return _with_legend(canvas, legend)


def projected_lines(
    camera: Camera, field: FieldModel, field_from_robot: Pose, base_from_camera: Pose3 | None = None
) -> list[FloatArray]:
    """The visible pieces of the field's centre lines in the image: arrays (K, 2) of pixels u, v, K >= 2."""
    robot_from_field = field_from_robot.inverse()
    pieces: list[FloatArray] = []
    for line in field.polylines(_STEP_M):
        pixels = camera.image_from_ground(robot_from_field.transform(line), base_from_camera)
        pieces += _visible_pieces(camera, pixels)
    return pieces


def _visible_pieces(camera: Camera, pixels: FloatArray) -> list[FloatArray]:
    seen = camera.sees(pixels)
    step = np.hypot(*np.diff(pixels, axis=0).T)
    with np.errstate(invalid="ignore"):
        broken = ~(seen[:-1] & seen[1:] & (step <= _LONGEST_STEP_PX))
    runs = np.split(np.arange(len(pixels)), np.flatnonzero(broken) + 1)
    return [pixels[run] for run in runs if len(run) > 1]


def _draw_points(
    canvas: ImageArray, field: FieldModel | None, field_from_robot: Pose | None, points: LinePoints, scale: int
) -> list[tuple[str, tuple[int, int, int]]]:
    rated = field is not None and field_from_robot is not None
    if field is not None and field_from_robot is not None:
        on_line = field.line_distances(field_from_robot.transform(points.positions_m)) <= ON_LINE_M
    else:
        on_line = np.ones(len(points), dtype=np.bool_)
    near_color = ON_LINE_COLOR if rated else UNRATED_COLOR
    drawable = np.flatnonzero(np.isfinite(points.pixels).all(axis=1))
    for index in drawable:
        center = _fixed_point(points.pixels[index : index + 1], scale)[0]
        radius = round((1.0 + 0.7 * float(points.confidences[index])) * scale * 2**_SHIFT)
        color = near_color if on_line[index] else OFF_LINE_COLOR
        at = (int(center[0]), int(center[1]))
        cv2.circle(canvas, at, radius + 2**_SHIFT, _DARK, -1, cv2.LINE_AA, _SHIFT)
        cv2.circle(canvas, at, radius, color, -1, cv2.LINE_AA, _SHIFT)
    if not rated:
        return [(f"{len(points)} line points", UNRATED_COLOR)]
    near = f"{int(on_line.sum())} points within {100 * ON_LINE_M:.0f} cm of a line"
    return [(near, ON_LINE_COLOR), (counted(int((~on_line).sum()), "other"), OFF_LINE_COLOR)]


def _fixed_point(pixels: FloatArray, scale: int) -> IntArray:
    """Pixels (N, 2) in the enlarged image as OpenCV's fixed-point numbers; pixel centres stay pixel centres."""
    enlarged = (pixels + 0.5) * scale - 0.5
    numbers: IntArray = np.round(enlarged * 2**_SHIFT).astype(np.int32)
    return numbers


def _with_legend(canvas: ImageArray, entries: list[tuple[str, tuple[int, int, int]]]) -> ImageArray:
    if not entries:
        return canvas
    columns = canvas.shape[1]
    size = 0.6 * columns / 960.0
    band = np.full((round(70 * size), columns, 3), 24, dtype=np.uint8)
    x, middle = round(24 * size), band.shape[0] // 2
    for text, color in entries:
        (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, 1)
        cv2.circle(band, (x, middle), max(2, round(9 * size)), color, -1, cv2.LINE_AA)
        x += round(24 * size)
        cv2.putText(
            band, text, (x, middle + height // 2), cv2.FONT_HERSHEY_SIMPLEX, size, (235, 235, 235), 1, cv2.LINE_AA
        )
        x += width + round(48 * size)
    return np.vstack((canvas, band))
