"""The picture of a self-calibration: the line points of all images on the field, before and after."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from touchline.calibration.self_calibration import SelfCalibration
from touchline.field import FieldModel
from touchline.field.drawing import draw_field, field_view
from touchline.geometry import FloatArray, Pose
from touchline.types import ImageArray
from touchline.view.overlay import draw_rated

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
