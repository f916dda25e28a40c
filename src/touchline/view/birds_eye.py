"""The image as seen from above: its pixels laid out on the ground, in metres."""

import cv2
import numpy as np

from touchline.camera import GroundView
from touchline.types import ImageArray, LinePoints

_BACKGROUND = (24, 24, 24)
_RING_COLOR = (150, 150, 150)
_POINT_COLOR = (255, 200, 0)


def birds_eye_image(
    image: ImageArray,
    view: GroundView,
    points: LinePoints | None = None,
    reach_m: float = 7.0,
    pixels_per_m: int = 64,
) -> ImageArray:
    """The ground around the robot, forward up and left on the left, (S, S, 3) BGR with S = 2 reach_m pixels_per_m + 1.

    Rings show the range every two metres; points (detected ones) lie where they were measured. What the camera does
    not see is dark. view: the camera at this image.
    """
    size = 2 * round(reach_m * pixels_per_m) + 1
    middle = size // 2
    rows, columns = np.mgrid[0:size, 0:size]
    ground = np.stack(((middle - rows).ravel(), (middle - columns).ravel()), axis=-1) / pixels_per_m
    pixels = view.image_from_ground(ground)
    seen = view.sees(pixels)
    table = np.where(seen[:, np.newaxis], pixels, -10.0).astype(np.float32).reshape(size, size, 2)
    canvas: ImageArray = np.full((size, size, 3), _BACKGROUND[0], dtype=np.uint8)
    cv2.remap(image, table[..., 0], table[..., 1], cv2.INTER_LINEAR, dst=canvas, borderMode=cv2.BORDER_TRANSPARENT)
    canvas[~seen.reshape(size, size)] = _BACKGROUND
    for range_m in np.arange(2.0, reach_m, 2.0):
        reach_px = round(float(range_m) * pixels_per_m)
        cv2.circle(canvas, (middle, middle), reach_px, _RING_COLOR, 1, cv2.LINE_AA)
        at = (middle + 6, middle - reach_px - 6)
        cv2.putText(canvas, f"{range_m:.0f} m", at, cv2.FONT_HERSHEY_SIMPLEX, 0.5, (235, 235, 235), 1, cv2.LINE_AA)
    cv2.arrowedLine(canvas, (middle, middle), (middle, middle - pixels_per_m // 2), (255, 255, 255), 2, cv2.LINE_AA)
    for x, y in np.zeros((0, 2)) if points is None else points.positions_m:
        at = (middle - round(float(y) * pixels_per_m), middle - round(float(x) * pixels_per_m))
        if max(at) < size and min(at) >= 0:
            cv2.circle(canvas, at, 4, (20, 20, 20), -1, cv2.LINE_AA)
            cv2.circle(canvas, at, 3, _POINT_COLOR, -1, cv2.LINE_AA)
    return canvas
