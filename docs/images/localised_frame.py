"""Makes the picture at the top of the README: one localised image, and the path on the field.

python docs/images/localised_frame.py RECORDING INDEX PICTURE.jpg
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from touchline.camera import GroundView, OmniCamera
from touchline.field import FieldModel
from touchline.field.drawing import draw_field, field_view
from touchline.geometry import FloatArray, Pose
from touchline.sources import open_source
from touchline.systems import DEFAULT_SYSTEM, RobotSetup, open_system
from touchline.types import LinePoints
from touchline.view.overlay import LINE_COLOR, ON_LINE_COLOR, overlay_image

PATH_COLOR = (60, 220, 255)  # BGR
SIDE_PX = 840
SHIFT = 4

Picture = npt.NDArray[np.uint8]


def main(recording: Path, index: int, picture: Path) -> None:
    source = open_source(recording)
    system = open_system(DEFAULT_SYSTEM, RobotSetup(source.field, source.camera))
    path = []
    for number, frame in enumerate(source):
        estimate = system.step(frame)
        path.append(estimate.pose)
        if number == index:
            image, pose, points = frame.image, estimate.pose, estimate.observation.points
    overlay = overlay_image(image, GroundView(source.camera), source.field, pose, points, scale=3)
    left = cv2.resize(_round(overlay, source.camera, 3), (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_AREA)
    right = _field(source.field, path, pose, points)
    space = np.full((SIDE_PX, 24, 3), 255, np.uint8)
    cv2.imwrite(str(picture), np.hstack((left, space, right)), [cv2.IMWRITE_JPEG_QUALITY, 82])


def _round(overlay: Picture, camera: OmniCamera, scale: int) -> Picture:
    """The mirror's disc, on white; the legend below it is cut off."""
    side = round(2 * (camera.outer_radius_px + 4) * scale)
    u, v = (round(c * scale - side / 2) for c in camera.center)
    window = np.full((side, side, 3), 255, np.uint8)
    rows, columns = min(side, camera.height * scale - v), min(side, camera.width * scale - u)
    window[max(-v, 0) : rows, max(-u, 0) : columns] = overlay[max(v, 0) : v + rows, max(u, 0) : u + columns]
    mask = np.zeros((side, side), np.uint8)
    cv2.circle(mask, (side // 2, side // 2), side // 2 - 3, 255, -1, cv2.LINE_AA)
    share = (mask / 255.0)[..., np.newaxis]
    return (share * window + (1.0 - share) * 255.0).astype(np.uint8)


def _field(field: FieldModel, path: list[Pose], pose: Pose, points: LinePoints) -> Picture:
    """The field from above, SIDE_PX high: the path, the robot and its points."""
    scale = SIDE_PX / (field.width + 2 * field.border)
    view, picture = field_view(field, scale), draw_field(field, scale)
    picture = picture[:SIDE_PX].copy()

    def fixed(places: FloatArray) -> npt.NDArray[np.int32]:
        return np.round(view.picture_from_field(places) * 2**SHIFT).astype(np.int32)

    for center in fixed(pose.transform(points.positions_m)):
        cv2.circle(picture, tuple(map(int, center)), 5 * 2**SHIFT, (20, 20, 20), -1, cv2.LINE_AA, SHIFT)
        cv2.circle(picture, tuple(map(int, center)), 4 * 2**SHIFT, ON_LINE_COLOR, -1, cv2.LINE_AA, SHIFT)
    way = fixed(np.array([place[:2] for place in path]))
    cv2.polylines(picture, [way], False, PATH_COLOR, 3, cv2.LINE_AA, SHIFT)
    angles = pose.heading + np.linspace(-math.pi, math.pi, 61)
    body = np.column_stack((np.cos(angles), np.sin(angles))) * 0.26 + pose[:2]
    nose = np.array([[0.26, 0.0], [1.0, 0.0]])
    cv2.fillPoly(picture, [fixed(body)], (30, 30, 30), cv2.LINE_AA, SHIFT)
    cv2.polylines(picture, [fixed(body)], True, LINE_COLOR, 3, cv2.LINE_AA, SHIFT)
    start, end = fixed(pose.transform(nose)) / 2**SHIFT
    cv2.arrowedLine(
        picture, tuple(map(round, start)), tuple(map(round, end)), LINE_COLOR, 4, cv2.LINE_AA, tipLength=0.4
    )
    return picture


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]))
