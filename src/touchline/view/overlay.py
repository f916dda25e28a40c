"""What was seen and the projected field lines drawn over the image: whether a pose is right, at a glance."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from touchline.camera import GroundView
from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose
from touchline.messages import counted
from touchline.perception.feature_pictures import Canvas, draw_features
from touchline.perception.stages import Legend, with_legend
from touchline.types import ImageArray, LinePoints, Observation

ON_LINE_M = 0.15  # a point this near to a line of the model counts as lying on it
LINE_COLOR = (255, 90, 235)  # BGR, as all colours here: magenta, which no field, line or shirt has
ON_LINE_COLOR = (255, 200, 0)
OFF_LINE_COLOR = (0, 120, 255)
UNRATED_COLOR = (255, 200, 0)
_STEP_M = 0.05
_MAX_STEP_PX = 40.0
_SHIFT = 4  # OpenCV draws with 4 binary digits below the pixel
_DARK = (20, 20, 20)

IntArray = npt.NDArray[np.int32]


def overlay_image(
    image: ImageArray,
    view: GroundView,
    field: FieldModel | None,
    field_from_robot: Pose | None,
    seen: Observation | LinePoints | None,
    scale: int = 2,
) -> ImageArray:
    """The image (H, W, 3) BGR, enlarged `scale` times, with what was seen and field lines drawn over it and a legend
    below.

    view: the camera at this image. Without a field or pose only what was seen is drawn. Points nearer than 15 cm to a
    line of the model have another colour than the rest; their size grows with their confidence. Of an observation
    lines, crossings and landmarks are drawn, too.
    """
    canvas = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC).astype(np.uint8)
    legend: Legend = []
    if field is not None and field_from_robot is not None:
        for line in projected_lines(view, field, field_from_robot):
            cv2.polylines(canvas, [_fixed_point(line, scale)], False, LINE_COLOR, scale, cv2.LINE_AA, _SHIFT)
        legend.append(("field lines at this pose", LINE_COLOR))
    features: Legend = []
    if isinstance(seen, Observation):
        radius_m = float(field.circles[0, 2]) if field is not None and len(field.circles) else 0.0
        features = draw_features(Canvas(canvas, view, scale), seen, radius_m)
    points = seen.points if isinstance(seen, Observation) else seen
    if points is not None and (len(points) or not features):
        legend += _draw_points(canvas, field, field_from_robot, points, scale)
    return with_legend(canvas, legend + features)


def projected_lines(view: GroundView, field: FieldModel, field_from_robot: Pose) -> list[FloatArray]:
    """The visible pieces of the field's centre lines in the image: arrays (K, 2) of pixels u, v, K >= 2."""
    robot_from_field = field_from_robot.inverse()
    pieces: list[FloatArray] = []
    for line in field.polylines(_STEP_M):
        pieces += _visible_pieces(view, view.image_from_ground(robot_from_field.transform(line)))
    return pieces


def _visible_pieces(view: GroundView, pixels: FloatArray) -> list[FloatArray]:
    seen = view.sees(pixels)
    step = np.hypot(*np.diff(pixels, axis=0).T)
    with np.errstate(invalid="ignore"):
        broken = ~(seen[:-1] & seen[1:] & (step <= _MAX_STEP_PX))
    runs = np.split(np.arange(len(pixels)), np.flatnonzero(broken) + 1)
    return [pixels[run] for run in runs if len(run) > 1]


def _draw_points(
    canvas: ImageArray, field: FieldModel | None, field_from_robot: Pose | None, points: LinePoints, scale: int
) -> Legend:
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
