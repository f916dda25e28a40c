"""What teams' own detectors say in their own messages, as rows like those of observations.csv, in the robot frame.

Of Booster's robots `position_projection` is in the robot frame already; the messages of soccer_vision_3d_msgs are in
the frame of their headers. `pixel_features` reads those of pixels. A confidence that is not known (-1) is left open.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeAlias

import numpy as np

from touchline.geometry import FloatArray, Pose3
from touchline.sources.bags import roles
from touchline.types import MAX_VALUE, CrossingKind, LandmarkKind

FeatureRow: TypeAlias = dict[str, str]
_LABELS = {
    "LCross": CrossingKind.L,
    "TCross": CrossingKind.T,
    "XCross": CrossingKind.X,
    "PenaltyPoint": LandmarkKind.PENALTY_MARK,
    "Goalpost": LandmarkKind.POST,
}
CROSSING_OF_RAYS = {2: CrossingKind.L, 3: CrossingKind.T, 4: CrossingKind.X}
MAX_MARK_M = 0.35  # diameter: a larger ellipse is the centre circle


def feature_rows(role: str, message: Any, base_from_sensor: Pose3) -> list[FeatureRow]:
    """Rows of a message of one of `roles.FEATURES`; what has no place on the ground is left out."""
    return list(_READERS[role](message, base_from_sensor))


def _detections(message: Any, base_from_sensor: Pose3) -> Iterator[FeatureRow]:
    for seen in message.detected_objects:
        place = np.asarray(seen.position_projection, dtype=np.float64)
        if seen.label in _LABELS and len(place) >= 2:
            yield from feature_row(_LABELS[seen.label], place[:2], 0.01 * float(seen.confidence))


def _line_segments(message: Any, base_from_sensor: Pose3) -> Iterator[FeatureRow]:
    numbers = np.asarray(message.coordinates, dtype=np.float64)
    for ends in numbers[: len(numbers) // 4 * 4].reshape(-1, 4):
        yield from feature_row("line", ends[:2], -1.0, ends[2:])


def _markings(message: Any, base_from_sensor: Pose3) -> Iterator[FeatureRow]:
    for ellipse in message.ellipses:
        mark = LandmarkKind.PENALTY_MARK if ellipse.diameter < MAX_MARK_M else LandmarkKind.CIRCLE
        yield from feature_row(mark, _placed(base_from_sensor, ellipse.center.position), ellipse.confidence.confidence)
    for crossing in message.intersections:
        if crossing.num_rays in CROSSING_OF_RAYS:
            kind = CROSSING_OF_RAYS[crossing.num_rays]
            turn = orientation(kind, [_turned(base_from_sensor, ray) for ray in crossing.rays])
            place = _placed(base_from_sensor, crossing.center.position)
            yield from feature_row(kind, place, crossing.confidence.confidence, turn=turn)
    for segment in message.segments:
        start, end = (_placed(base_from_sensor, each) for each in (segment.start, segment.end))
        yield from feature_row("line", start, segment.confidence.confidence, end)


def _goalposts(message: Any, base_from_sensor: Pose3) -> Iterator[FeatureRow]:
    for post in message.posts:
        place = _placed(base_from_sensor, post.bb.center.position)
        yield from feature_row(LandmarkKind.POST, place, post.confidence.confidence)


_READERS: dict[str, Callable[[Any, Pose3], Iterator[FeatureRow]]] = {
    roles.DETECTIONS: _detections,
    roles.LINE_SEGMENTS: _line_segments,
    roles.MARKINGS: _markings,
    roles.GOALPOSTS: _goalposts,
}


def feature_row(
    kind: str, place: FloatArray, confidence: float, end: FloatArray | None = None, turn: float = math.nan
) -> Iterable[FeatureRow]:
    """One row, or none where a place is none; turn: its orientation (rad)."""
    numbers = {"x_m": place[0], "y_m": place[1]}
    if end is not None:
        numbers |= {"x2_m": end[0], "y2_m": end[1]}
    if not all(abs(value) < MAX_VALUE for value in numbers.values()):  # False for NaN
        return ()
    if math.isfinite(turn):
        numbers["orientation_rad"] = turn
    if 0.0 <= confidence <= 1.0:
        numbers["confidence"] = confidence
    return ({"kind": str(kind), **{name: repr(float(value)) for name, value in numbers.items()}},)


def _placed(base_from_sensor: Pose3, point: Any) -> FloatArray:
    place = np.array([[point.x, point.y, point.z]], dtype=np.float64)
    if not (np.abs(place) < MAX_VALUE).all():  # False for NaN
        return np.full(2, math.nan)
    return base_from_sensor.transform(place)[0, :2]


def _turned(base_from_sensor: Pose3, ray: Any) -> FloatArray:
    """A direction on the ground, of length 1; NaN for none."""
    way = np.array([ray.x, ray.y, ray.z], dtype=np.float64)
    return unit_vector((base_from_sensor.rotation @ way)[:2] if (np.abs(way) < MAX_VALUE).all() else np.zeros(2))


def unit_vector(way: FloatArray) -> FloatArray:
    """(2,) of length 1; NaN for none."""
    length = math.hypot(*way)
    return way / length if length > 0.0 else np.full(2, math.nan)


def orientation(kind: CrossingKind, rays: Sequence[FloatArray]) -> float:
    """As `touchline.types.Crossings` has it (rad); NaN where not all rays are told."""
    if len(rays) != {CrossingKind.L: 2, CrossingKind.T: 3, CrossingKind.X: 4}[kind]:
        return math.nan
    if kind is CrossingKind.L:
        x, y = rays[0] + rays[1]
    elif kind is CrossingKind.X:
        x, y = rays[0]
    else:  # the stem is the one beside the two that are opposite to each other
        x, y = rays[min(range(3), key=lambda k: float(rays[(k + 1) % 3] @ rays[(k + 2) % 3]))]
    return math.atan2(y, x)
