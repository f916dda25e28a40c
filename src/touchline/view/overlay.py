"""What was seen and the projected field lines drawn over the image: whether a pose is right, at a glance."""

import cv2
import numpy as np

from touchline.camera import GroundView
from touchline.field import FieldModel
from touchline.field.drawing import FieldView
from touchline.geometry import BoolArray, FloatArray, Pose
from touchline.messages import counted
from touchline.perception.feature_pictures import Canvas, draw_features
from touchline.perception.stages import SHIFT, Legend, enlarged, fixed_point, with_legend
from touchline.types import ImageArray, LinePoints, Observation

ON_LINE_M = 0.15  # a point this near to a line of the model counts as lying on it
LINE_COLOR = (255, 90, 235)  # BGR, as all colours here: magenta, which no field, line or shirt has
ON_LINE_COLOR = (255, 200, 0)
OFF_LINE_COLOR = (0, 120, 255)
_STEP_M = 0.05
_MAX_STEP_PX = 40.0
_DARK = (20, 20, 20)


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
    canvas = enlarged(image, scale)
    legend: Legend = []
    if field is not None and field_from_robot is not None:
        for line in projected_lines(view, field, field_from_robot):
            cv2.polylines(canvas, [fixed_point(line, scale)], False, LINE_COLOR, scale, cv2.LINE_AA, SHIFT)
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
    on_line: BoolArray | None = None
    if field is not None and field_from_robot is not None:
        on_line = field.line_distances(field_from_robot.transform(points.positions_m)) <= ON_LINE_M
    for index in np.flatnonzero(np.isfinite(points.pixels).all(axis=1)):
        at = tuple(fixed_point(points.pixels[index], scale).tolist())
        radius = round((1.0 + 0.7 * float(points.confidences[index])) * scale * 2**SHIFT)
        color = ON_LINE_COLOR if on_line is None or on_line[index] else OFF_LINE_COLOR
        cv2.circle(canvas, at, radius + 2**SHIFT, _DARK, -1, cv2.LINE_AA, SHIFT)
        cv2.circle(canvas, at, radius, color, -1, cv2.LINE_AA, SHIFT)
    if on_line is None:
        return [(f"{len(points)} line points", ON_LINE_COLOR)]
    near = f"{int(on_line.sum())} points within {100 * ON_LINE_M:.0f} cm of a line"
    return [(near, ON_LINE_COLOR), (counted(int((~on_line).sum()), "other"), OFF_LINE_COLOR)]


def draw_rated(picture: ImageArray, view: FieldView, places: FloatArray, on_line: BoolArray, radius_px: int) -> None:
    """Points (N, 2) of the field into a picture of it, those on a line in another colour; far outside they are none."""
    for place, near in zip(view.picture_from_field(places), on_line, strict=True):
        if np.all(np.abs(place) < 1e4):
            color = ON_LINE_COLOR if near else OFF_LINE_COLOR
            cv2.circle(picture, (round(place[0]), round(place[1])), radius_px, color, -1, cv2.LINE_AA)
