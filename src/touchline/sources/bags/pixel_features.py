"""What the messages of soccer_vision_2d_msgs say of an image's pixels, as rows on the ground, in the robot frame.

u grows to the right and v downwards; a heading of 0 points along u and π/2 along v (MarkingIntersection.msg).
"""

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from touchline.camera import GroundView
from touchline.geometry import FloatArray
from touchline.sources.bags import roles
from touchline.sources.bags.team_features import (
    CROSSING_OF_RAYS,
    MAX_MARK_M,
    FeatureRow,
    feature_row,
    orientation,
    unit_vector,
)
from touchline.types import MAX_VALUE, LandmarkKind

_RAY_PX = 1.0
_EDGE_PX = 2.0  # a post whose box ends at the image's border goes on below it


def in_pixels(message: Any) -> bool:
    """Whether a message of one of `roles.FEATURES` is of pixels."""
    return getattr(message, "__msgtype__", "") in roles.IN_PIXELS


def pixel_feature_rows(role: str, message: Any, view: GroundView) -> list[FeatureRow]:
    """Rows of a message; what lies at or above the horizon is left out, and so are posts whose foot is not seen."""
    return list(_READERS[role](message, view))


def _markings(message: Any, view: GroundView) -> Iterator[FeatureRow]:
    for ellipse in message.ellipses:
        (u, v), box = _pixel(ellipse.center), ellipse.bb
        half = 0.5 * float(box.size_x) + abs(float(_box_center(box)[0]) - u)
        center, side = _ground(view, np.array([(u, v), (u + half, v)]))
        small = 2.0 * math.hypot(*(side - center)) < MAX_MARK_M
        mark = LandmarkKind.PENALTY_MARK if small else LandmarkKind.CIRCLE
        yield from feature_row(mark, center, ellipse.confidence.confidence)
    for crossing in message.intersections:
        if crossing.num_rays not in CROSSING_OF_RAYS:
            continue
        kind, at = CROSSING_OF_RAYS[crossing.num_rays], _pixel(crossing.center)
        headings = np.asarray(crossing.heading_rays, dtype=np.float64).reshape(-1)[:4]
        headings = headings if (np.abs(headings) < MAX_VALUE).all() else headings[:0]  # False for NaN
        ends = at + _RAY_PX * np.column_stack((np.cos(headings), np.sin(headings)))
        center, *ways = _ground(view, np.vstack((at, ends)))
        turn = orientation(kind, [unit_vector(way - center) for way in ways])
        yield from feature_row(kind, center, crossing.confidence.confidence, turn=turn)
    for segment in message.segments:
        start, end = _ground(view, np.array([_pixel(segment.start), _pixel(segment.end)]))
        yield from feature_row("line", start, segment.confidence.confidence, end)


def _goalposts(message: Any, view: GroundView) -> Iterator[FeatureRow]:
    for post in message.posts:
        turn, half = float(post.bb.center.theta), 0.5 * float(post.bb.size_y)
        foot = _box_center(post.bb) + half * np.array([-math.sin(turn), math.cos(turn)])
        if foot[1] < view.camera.height - 1 - _EDGE_PX and view.sees(foot[np.newaxis])[0]:
            yield from feature_row(LandmarkKind.POST, _ground(view, foot[np.newaxis])[0], post.confidence.confidence)


_READERS: dict[str, Callable[[Any, GroundView], Iterator[FeatureRow]]] = {
    roles.MARKINGS: _markings,
    roles.GOALPOSTS: _goalposts,
}


def _pixel(point: Any) -> FloatArray:
    return np.array([point.x, point.y], dtype=np.float64)


def _box_center(box: Any) -> FloatArray:
    """Of a vision_msgs/BoundingBox2D, whose middle was a geometry_msgs/Pose2D before ROS 2 Humble."""
    return _pixel(getattr(box.center, "position", box.center))


def _ground(view: GroundView, pixels: FloatArray) -> FloatArray:
    """(N, 2) places of pixels (N, 2); NaN where there is none."""
    known = (np.abs(pixels) < MAX_VALUE).all(axis=1)  # False for NaN
    places = np.full(pixels.shape, np.nan)
    if known.any():
        places[known] = view.ground_from_image(pixels[known])
    return places
