"""Makes the picture at the top of the README: a localised image of a mirror robot and one of a humanoid, with paths.

python docs/images/localised_frame.py MIRROR_RECORDING INDEX HUMANOID_RECORDING INDEX PICTURE.jpg
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from touchline.camera import GroundView, OmniCamera
from touchline.field import FieldModel
from touchline.field.drawing import FieldView, draw_field, field_view
from touchline.geometry import FloatArray, Pose
from touchline.motion import LeanFilter
from touchline.motion.attitude import view_at
from touchline.perception.feature_pictures import CROSSING_PAINT, LINE_PAINT
from touchline.sources import open_source
from touchline.systems import DEFAULT_SYSTEM, RobotSetup, open_system
from touchline.types import ImageArray, LinePoints, Observation, Prior
from touchline.view.overlay import LINE_COLOR, ON_LINE_COLOR, overlay_image

PATH_COLOR = (60, 220, 255)  # BGR
HIGH_PX, WIDE_PX, GAP_PX = 840, 2064, 24
SHIFT = 4

Picture = npt.NDArray[np.uint8]


class Moment(NamedTuple):
    """One image of a run, what was seen in it, and the whole path."""

    image: ImageArray
    view: GroundView
    seen: Observation
    pose: Pose
    path: list[Pose]
    field: FieldModel


def main(mirror: Path, mirror_index: int, humanoid: Path, humanoid_index: int, picture: Path) -> None:
    """Write the picture: the mirror robot above, the humanoid below."""
    above, below = localised(mirror, mirror_index), localised(humanoid, humanoid_index)
    below = below._replace(seen=replace(below.seen, points=LinePoints.none()))  # they lie on the lines
    disc = overlay_image(above.image, above.view, above.field, above.pose, above.seen, scale=3)
    disc = cv2.resize(_round(disc, above.view.camera, 3), (HIGH_PX, HIGH_PX), interpolation=cv2.INTER_AREA)
    frame = overlay_image(below.image, below.view, below.field, below.pose, below.seen, scale=2)
    frame = frame[: 2 * len(below.image)]  # the legend below is cut off
    rows = [_row(disc, above, HIGH_PX), _row(frame, below, _height(frame, below.field))]
    space = np.full((GAP_PX, WIDE_PX, 3), 255, np.uint8)
    sheet = np.vstack((rows[0], space, rows[1]))
    sheet = cv2.resize(sheet, None, fx=0.8, fy=0.8, interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(picture), sheet, [cv2.IMWRITE_JPEG_QUALITY, 68, cv2.IMWRITE_JPEG_PROGRESSIVE, 1])


def localised(recording: Path, index: int) -> Moment:
    """An image of a recording as the system for its camera has localised it, started where the robot stood."""
    source = open_source(recording)
    assert source.truth is not None
    system = open_system(DEFAULT_SYSTEM, RobotSetup(source.field, source.camera))
    system.reset(Prior(source.truth[0]))
    path, leaning = [], LeanFilter()
    for number, frame in enumerate(source):
        leaning.add(frame)
        estimate = system.step(frame)
        path.append(estimate.pose)
        if number == index:
            assert frame.image is not None
            assert estimate.observation is not None
            view = view_at(source.camera, frame, leaning.lean(frame.stamp_ns))
            kept = Moment(frame.image, view, estimate.observation, estimate.pose, path, source.field)
    return kept


def _row(left: Picture, moment: Moment, height: int) -> Picture:
    """An image and its field beside each other, WIDE_PX wide."""
    shown = cv2.resize(left, (round(left.shape[1] * height / len(left)), height), interpolation=cv2.INTER_AREA)
    right = _field(moment, height)
    row = np.full((height, WIDE_PX, 3), 255, np.uint8)
    row[:, : shown.shape[1]] = shown
    wide = min(right.shape[1], WIDE_PX - shown.shape[1] - GAP_PX)
    row[:, WIDE_PX - wide :] = right[:, (right.shape[1] - wide) // 2 :][:, :wide]
    return row


def _height(left: Picture, field: FieldModel) -> int:
    """The height at which an image and a field beside it are WIDE_PX wide."""
    field_aspect = (field.length + 2 * field.border) / (field.width + 2 * field.border)
    return int((WIDE_PX - GAP_PX) / (left.shape[1] / len(left) + field_aspect))


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


def _field(moment: Moment, height: int) -> Picture:
    """The field from above, so high: the path, the robot and what it sees."""
    field, pose, seen = moment.field, moment.pose, moment.seen
    scale = height / (field.width + 2 * field.border)
    view, picture = field_view(field, scale), draw_field(field, scale)
    picture = np.ascontiguousarray(picture[(len(picture) - height) // 2 :][:height])
    view = FieldView(view.width, height, scale)

    def fixed(places: FloatArray) -> npt.NDArray[np.int32]:
        return np.round(view.picture_from_field(places) * 2**SHIFT).astype(np.int32)

    def disc(places: FloatArray, size: float, color: tuple[int, int, int]) -> None:
        for center in fixed(places):
            for radius, paint in ((size + 1.0, (20, 20, 20)), (size, color)):
                cv2.circle(picture, tuple(map(int, center)), round(radius * 2**SHIFT), paint, -1, cv2.LINE_AA, SHIFT)

    for ends in seen.lines.ends_m:
        for width, paint in ((8, (20, 20, 20)), (5, LINE_PAINT)):
            cv2.polylines(picture, [fixed(pose.transform(ends))], False, paint, width, cv2.LINE_AA, SHIFT)
    disc(pose.transform(seen.points.positions_m), 4.0, ON_LINE_COLOR)
    disc(pose.transform(seen.crossings.positions_m), 8.0, CROSSING_PAINT)
    disc(pose.transform(seen.landmarks.positions_m), 8.0, (255, 255, 255))
    way = fixed(np.array([place[:2] for place in moment.path]))
    cv2.polylines(picture, [way], False, PATH_COLOR, 3, cv2.LINE_AA, SHIFT)
    angles = pose.heading + np.linspace(-math.pi, math.pi, 61)
    radius, nose_m = (0.26, 1.0) if field.length > 10.0 else (0.16, 0.6)
    body = np.column_stack((np.cos(angles), np.sin(angles))) * radius + pose[:2]
    nose = np.array([[radius, 0.0], [nose_m, 0.0]])
    cv2.fillPoly(picture, [fixed(body)], (30, 30, 30), cv2.LINE_AA, SHIFT)
    cv2.polylines(picture, [fixed(body)], True, LINE_COLOR, 3, cv2.LINE_AA, SHIFT)
    start, end = fixed(pose.transform(nose)) / 2**SHIFT
    cv2.arrowedLine(
        picture, tuple(map(round, start)), tuple(map(round, end)), LINE_COLOR, 4, cv2.LINE_AA, tipLength=0.4
    )
    return picture


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]), int(sys.argv[4]), Path(sys.argv[5]))
