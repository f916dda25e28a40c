"""The features of an observation drawn over its image: lines, crossings with their arms, landmarks, the centre circle.

They are drawn from where they lie on the ground, so that lines bend as the lens bends them, and what a robot's own
detector has found is drawn as well.
"""

import math
from collections import Counter
from typing import NamedTuple

import cv2
import numpy as np

from touchline.camera import GroundView
from touchline.geometry import FloatArray
from touchline.messages import counted
from touchline.perception.stages import SHIFT, Legend, Paint, fixed_point
from touchline.types import CrossingKind, ImageArray, LandmarkKind, Observation

LINE_PAINT, CROSSING_PAINT, LANDMARK_PAINT = (0, 225, 255), (50, 50, 255), (255, 255, 255)  # BGR
_DARK = (20, 20, 20)
_STEP_M = 0.05
_ARM_M = 0.25  # drawn of each arm of a crossing
_UPRIGHT_M = 0.6  # drawn of a post or pole: how high it is, nobody says
_UPRIGHTS = (LandmarkKind.POST.value, LandmarkKind.POLE.value)
_ARMS_RAD = {  # from the orientation of `Crossings`
    CrossingKind.L.value: (-0.25 * math.pi, 0.25 * math.pi),
    CrossingKind.T.value: (0.0, 0.5 * math.pi, -0.5 * math.pi),
    CrossingKind.X.value: (0.0, 0.5 * math.pi, math.pi, -0.5 * math.pi),
}
_FONT = cv2.FONT_HERSHEY_SIMPLEX


class Canvas(NamedTuple):
    """picture: (zoom H, zoom W, 3), BGR, an image enlarged. view: how the image shows the ground."""

    picture: ImageArray
    view: GroundView
    zoom: int


def draw_features(canvas: Canvas, seen: Observation, circle_m: float = 0.0) -> Legend:
    """Draw what an observation holds beside its points; returns what the paints mean.

    circle_m: radius of the centre circle; 0 if it is not known.
    """
    for ends in seen.lines.ends_m:
        _draw_ground(canvas, ends, LINE_PAINT, 2)
    _draw_crossings(canvas, seen)
    _draw_landmarks(canvas, seen, circle_m)
    legend: Legend = []
    if len(seen.lines):
        legend.append((counted(len(seen.lines), "line"), LINE_PAINT))
    if len(seen.crossings):
        kinds = Counter(seen.crossings.kinds.tolist())
        legend.append(("crossings " + ", ".join(f"{n} {kind}" for kind, n in sorted(kinds.items())), CROSSING_PAINT))
    if len(seen.landmarks):
        legend.append((counted(len(seen.landmarks), "landmark"), LANDMARK_PAINT))
    return legend


def landmark_name(kind: str) -> str:
    """What a kind of landmark is called in pictures: `circle` is where the circle's middle lies."""
    return "circle's centre" if kind == LandmarkKind.CIRCLE.value else kind.replace("_", " ")


def label(picture: ImageArray, at: tuple[int, int], text: str, paint: Paint) -> None:
    """A word beside a place of a picture, readable on any ground and at any size of the picture."""
    size = 1.1 * picture.shape[1] / 1504.0
    thick = max(1, round(2.2 * size))
    (width, height), _ = cv2.getTextSize(text, _FONT, size, thick)
    u = min(max(at[0] + round(10 * size), 2), picture.shape[1] - width - 2)
    v = min(max(at[1] - round(10 * size), height + 2), picture.shape[0] - 4)
    cv2.putText(picture, text, (u, v), _FONT, size, _DARK, thick + round(4 * size), cv2.LINE_AA)
    cv2.putText(picture, text, (u, v), _FONT, size, paint, thick, cv2.LINE_AA)


def _draw_crossings(canvas: Canvas, seen: Observation) -> None:
    crossings = seen.crossings
    for kind, place, orientation in zip(
        crossings.kinds.tolist(), crossings.positions_m, crossings.orientations_rad, strict=True
    ):
        for arm in _ARMS_RAD[kind] if math.isfinite(orientation) else ():
            way = np.array([math.cos(orientation + arm), math.sin(orientation + arm)])
            _draw_ground(canvas, np.stack((place, place + _ARM_M * way)), CROSSING_PAINT, 3)
        at = _place(canvas, canvas.view.image_from_ground(place[np.newaxis])[0])
        if at is not None:
            cv2.circle(canvas.picture, at, 4 * canvas.zoom, CROSSING_PAINT, canvas.zoom, cv2.LINE_AA)
            label(canvas.picture, at, kind, (150, 150, 255))


def _draw_landmarks(canvas: Canvas, seen: Observation, circle_m: float) -> None:
    marks = seen.landmarks
    for kind, place, colors in zip(marks.kinds.tolist(), marks.positions_m, marks.colors, strict=True):
        if kind == LandmarkKind.CIRCLE.value and circle_m > 0.0:
            angles = np.linspace(0.0, 2.0 * math.pi, 120)
            ring = place + circle_m * np.column_stack((np.cos(angles), np.sin(angles)))
            _draw_path(canvas, canvas.view.image_from_ground(ring), LANDMARK_PAINT, 1)
        foot = canvas.view.image_from_ground(place[np.newaxis])[0]
        if kind in _UPRIGHTS and canvas.view.model != "omni":
            heights = np.linspace(0.0, _UPRIGHT_M, 12)
            points = np.column_stack((np.broadcast_to(place, (12, 2)), heights))
            _draw_path(canvas, canvas.view.image_from_base(points), LANDMARK_PAINT, 2)
        at = _place(canvas, foot)
        if at is not None:
            cv2.drawMarker(canvas.picture, at, LANDMARK_PAINT, cv2.MARKER_CROSS, 8 * canvas.zoom, canvas.zoom)
            label(canvas.picture, at, " ".join(("-".join(colors), landmark_name(kind))).strip(), LANDMARK_PAINT)


def _draw_ground(canvas: Canvas, ends: FloatArray, paint: Paint, width: int) -> None:
    """A straight piece of the ground (2, 2)."""
    count = max(2, math.ceil(float(np.hypot(*(ends[1] - ends[0]))) / _STEP_M) + 1)
    shares = np.linspace(0.0, 1.0, min(count, 400))[:, np.newaxis]
    _draw_path(canvas, canvas.view.image_from_ground(ends[0] + shares * (ends[1] - ends[0])), paint, width)


def _draw_path(canvas: Canvas, pixels: FloatArray, paint: Paint, width: int) -> None:
    """A path (N, 2) of image positions, broken where it leaves the image."""
    seen = canvas.view.sees(pixels)
    pieces = np.split(np.arange(len(pixels)), np.flatnonzero(~(seen[:-1] & seen[1:])) + 1)
    fixed = [fixed_point(pixels[piece], canvas.zoom) for piece in pieces if len(piece) > 1]
    for color, thickness in ((_DARK, (width + 1) * canvas.zoom), (paint, width * canvas.zoom)):
        cv2.polylines(canvas.picture, fixed, False, color, thickness, cv2.LINE_AA, SHIFT)


def _place(canvas: Canvas, pixel: FloatArray) -> tuple[int, int] | None:
    """Where a pixel (2,) lies in the picture; None outside of it."""
    if not canvas.view.sees(pixel[np.newaxis])[0]:
        return None
    u, v = (pixel + 0.5) * canvas.zoom - 0.5
    return round(float(u)), round(float(v))
