"""Where lines lie in an image, from brightness profiles across their projection: no perception, no fit to the field."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose
from touchline.types import ImageArray

Project = Callable[[FloatArray], FloatArray]
_STEPS_PX = np.arange(-40.0, 40.05, 0.1)
_MARGIN_PX = 5.0


def projected_lines(
    project: Project, field: FieldModel, pose: Pose, size: tuple[int, int], reach_m: float = 6.0
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Places along all lines as the closed form projects them: (N, 2) pixels in the middle of both projected edges,

    (N, 2) unit normals, (N,) half widths (px), (N, 2) ground points (m, base frame). size: width, height of the image.
    """
    found = []
    to_base = pose.inverse()
    for line in field.polylines(0.05):
        ground = to_base.transform(line)
        along = np.gradient(line, axis=0)
        across = np.column_stack((-along[:, 1], along[:, 0])) / np.linalg.norm(along, axis=1, keepdims=True)
        middle, left, right = (
            project(to_base.transform(line + side * 0.5 * field.line_width * across)) for side in (0, 1, -1)
        )
        tangent = np.gradient(middle, axis=0)
        with np.errstate(invalid="ignore"):
            tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
            normal = np.column_stack((-tangent[:, 1], tangent[:, 0]))
            half = 0.5 * np.abs(np.sum((left - right) * normal, axis=1))
            middle += np.sum((0.5 * (left + right) - middle) * normal, axis=1)[:, np.newaxis] * normal
            seen = (middle > _MARGIN_PX).all(axis=1) & (middle < np.array(size) - 1.0 - _MARGIN_PX).all(axis=1)
            seen &= (np.hypot(*ground.T) < reach_m) & (half > 0.6) & (half < 25.0) & np.isfinite(normal).all(axis=1)
        seen[:4] = seen[-4:] = False
        found.append(np.column_stack((middle, normal, half, ground))[seen])
    table = np.concatenate(found)
    return table[:, :2], table[:, 2:4], table[:, 4], table[:, 5:]


def line_offsets(
    image: ImageArray, places: FloatArray, normals: FloatArray, half: FloatArray, reach: float
) -> FloatArray:
    """How far (px) the middle of a bright line lies from each place along its normal (N,), from both crossings of half

    brightness in the red channel; NaN where no single line of about that width stands out from darker ground.
    """
    red = image[..., 2].astype(np.float32)
    offsets = np.full(len(places), np.nan)
    for index, (place, normal, width) in enumerate(zip(places, normals, half, strict=True)):
        steps = _STEPS_PX[np.abs(_STEPS_PX) <= width + reach]
        path = (place + steps[:, np.newaxis] * normal).astype(np.float32)
        if path.min() < 2.0 or path[:, 0].max() > red.shape[1] - 3.0 or path[:, 1].max() > red.shape[0] - 3.0:
            continue
        profile = cv2.remap(red, path[np.newaxis, :, 0], path[np.newaxis, :, 1], cv2.INTER_LINEAR)[0]
        low, high = float(np.percentile(profile, 15)), float(profile.max())
        edge = 0.5 * (low + high)
        bright = np.flatnonzero(profile > edge)
        first, last = int(bright[0]), int(bright[-1])
        if high - low < 70.0 or low > 110.0 or first == 0 or last == len(steps) - 1 or len(bright) != last - first + 1:
            continue
        ends = [steps[a] + 0.1 * (edge - profile[a]) / (profile[a + 1] - profile[a]) for a in (first - 1, last)]
        if abs(ends[1] - ends[0] - 2.0 * width) < max(1.5, 0.5 * width):
            offsets[index] = 0.5 * (ends[0] + ends[1])
    return offsets
