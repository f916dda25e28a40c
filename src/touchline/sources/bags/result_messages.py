"""An estimate as the messages that ROS's programs show and use: nav2, RViz, Foxglove, Lichtblick.

Under NAMESPACE/touchline/: the pose (reliable and latched, as nav2 listens to /amcl_pose), the path driven, all
hypotheses, the lines seen; the field as lines and as a map, once and latched. Beside them /tf and /diagnostics.
"""

import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose
from touchline.sources.bags.layout import LATCHED_RESULTS
from touchline.sources.bags.standard import Fields, StandardMessages, planar, xyz
from touchline.sources.bags.with_rosbags import Codec
from touchline.types import Estimate, Observation, Status

OWN = "/touchline/"  # before the name of each topic here
POSE, PATH, HYPOTHESES, PARTICLES = f"{OWN}pose", f"{OWN}path", f"{OWN}hypotheses", f"{OWN}particles"
FIELD_LINES, MAP_GRID, LINES_SEEN = f"{OWN}field_lines", f"{OWN}map", f"{OWN}lines_seen"
OVERLAY, LOOK = f"{OWN}overlay/compressed", f"{OWN}look"
TF, DIAGNOSTICS = "/tf", "/diagnostics"
TYPES = {
    POSE: "geometry_msgs/msg/PoseWithCovarianceStamped",
    PATH: "nav_msgs/msg/Path",
    HYPOTHESES: "geometry_msgs/msg/PoseArray",
    PARTICLES: "nav2_msgs/msg/ParticleCloud",
    FIELD_LINES: "visualization_msgs/msg/MarkerArray",
    MAP_GRID: "nav_msgs/msg/OccupancyGrid",
    LINES_SEEN: "visualization_msgs/msg/MarkerArray",
    OVERLAY: "sensor_msgs/msg/CompressedImage",
    LOOK: "geometry_msgs/msg/PoseStamped",
    TF: "tf2_msgs/msg/TFMessage",
    DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
}
_CUBE, _CYLINDER, _LINE_LIST, _POINTS, _DELETE_ALL = 1, 3, 5, 8, 3  # of visualization_msgs/Marker
_WHITE, _GREEN, _CYAN, _ORANGE = (1.0, 1.0, 1.0), (0.1, 0.45, 0.15), (0.0, 0.8, 1.0), (1.0, 0.5, 0.0)
_STEP_M, _CELL_M, _MAX_CELLS = 0.2, 0.05, 4_000_000
_LINE, _POST = 30, 100  # of nav_msgs/OccupancyGrid: nav2 drives over what is less than 100
_PATH_M, _PATH_POSES, _PATH_NS = 0.05, 500, 1_000_000_000  # of the path: a pose every, at most, published every


class Outgoing(NamedTuple):
    """A message on its way: topic, type, the message itself; latched: those that come later receive the last one."""

    topic: str
    kind: str
    message: Any
    latched: bool = False


class ResultMessages:
    """Makes them. namespace: before the names of Touchline's own topics."""

    def __init__(self, codec: Codec, field: FieldModel | None = None, namespace: str = "") -> None:
        self.standard, self._codec = StandardMessages(codec), codec
        self.namespace = namespace
        self.with_tf, self.while_searching = True, False
        """Whether the transform is sent, and whether while the pose is not tracked, too."""
        self.wanted: Callable[[str], bool] = lambda topic: True
        """Whether somebody looks at a topic: what is only shown is not made otherwise."""
        self._field = field
        self._path: deque[Any] = deque(maxlen=_PATH_POSES)
        self._last: Pose | None = None
        self._path_ns = -_PATH_NS

    def field(self, stamp_ns: int = 0) -> Iterator[Outgoing]:
        """The field, as lines and as a map."""
        if self._field is not None:
            yield self._own(FIELD_LINES, self._markers(stamp_ns, _field_markers(self._field)))
            yield self._own(MAP_GRID, self._grid(stamp_ns, self._field))

    def located(self, stamp_ns: int, estimate: Estimate, map_from_odom: Pose | None) -> Iterator[Outgoing]:
        """Pose and transform, of an image or carried on."""
        yield self._own(POSE, self.standard.estimated(stamp_ns, estimate))
        if self.with_tf and (estimate.status is Status.TRACKING or self.while_searching):
            yield self._own(TF, self.standard.map_from(stamp_ns, estimate, map_from_odom))

    def explained(self, stamp_ns: int, e: Estimate, more: Mapping[str, object] | None = None) -> Iterator[Outgoing]:
        """Of an image: the path, the hypotheses, the lines seen, the diagnostics. more: values of these."""
        header = self.standard.header(stamp_ns, self.standard.frames.map)
        poses = [planar(*pose) for pose in (e.pose, *(other.pose for other in e.hypotheses))]
        if self.wanted(self._topic(HYPOTHESES)):
            yield self._own(HYPOTHESES, {"header": header, "poses": poses})
        if self.wanted(self._topic(PARTICLES)):
            weights = [e.probability, *(other.probability for other in e.hypotheses)]
            particles = [
                {"pose": pose, "weight": 1.0 / len(poses) if weight is None else float(weight)}
                for pose, weight in zip(poses, weights, strict=True)
            ]
            yield self._own(PARTICLES, {"header": header, "particles": particles})
        if e.observation is not None and self.wanted(self._topic(LINES_SEEN)):
            yield self._own(LINES_SEEN, self._markers(stamp_ns, _seen_markers(e.observation, e.pose)))
        if self.wanted(self._topic(LOOK)) and e.look is not None:
            ahead = self.standard.header(stamp_ns, self.standard.frames.base)
            yield self._own(LOOK, {"header": ahead, "pose": planar(0.0, 0.0, e.look.bearing_rad)})
        if e.status is Status.TRACKING and (self._last is None or e.pose.distance_to(self._last) >= _PATH_M):
            self._path.append(self._codec.make("geometry_msgs/msg/PoseStamped", header=header, pose=poses[0]))
            self._last = e.pose
        if not 0 <= stamp_ns - self._path_ns < _PATH_NS and self.wanted(self._topic(PATH)):
            self._path_ns = stamp_ns
            yield self._own(PATH, {"header": header, "poses": list(self._path)})
        yield self._own(DIAGNOSTICS, self.standard.diagnostics(stamp_ns, e, more))

    def overlay(self, stamp_ns: int, jpeg: bytes) -> Outgoing:
        """A picture of the image with the projected field lines."""
        return self._own(OVERLAY, self.standard.compressed(stamp_ns, jpeg))

    def announced(self) -> Iterator[tuple[str, str, bool]]:
        """Topic, type and whether it is latched, of all that may come."""
        for name, kind in TYPES.items():
            yield self._topic(name), kind, name in LATCHED_RESULTS

    def _topic(self, name: str) -> str:
        return self.namespace + name if name.startswith(OWN) else name

    def _own(self, name: str, message: Any) -> Outgoing:
        made = self._codec.make(TYPES[name], **message) if isinstance(message, dict) else message
        return Outgoing(self._topic(name), TYPES[name], made, name in LATCHED_RESULTS)

    def _markers(self, stamp_ns: int, markers: list[Fields]) -> Fields:
        header = self.standard.header(stamp_ns, self.standard.frames.map)
        numbered = [{"header": header, "ns": "touchline", "id": at, **each} for at, each in enumerate(markers)]
        return {"markers": [{"header": header, "action": _DELETE_ALL}, *numbered]}

    def _grid(self, stamp_ns: int, field: FieldModel) -> Fields:
        """The carpet, free; lines are driven over, posts are in the way."""
        half = 0.5 * np.array([field.length, field.width]) + field.border
        cell_m = max(_CELL_M, math.sqrt(4.0 * float(np.prod(half)) / _MAX_CELLS))
        columns, rows = np.ceil(2.0 * half / cell_m).astype(int).tolist()
        x, y = np.meshgrid((np.arange(columns) + 0.5) * cell_m - half[0], (np.arange(rows) + 0.5) * cell_m - half[1])
        cells = np.column_stack((x.ravel(), y.ravel()))
        data = np.where(field.line_distances(cells) <= max(0.5 * field.line_width, 0.5 * cell_m), _LINE, 0)
        for post in field.posts:
            near = np.hypot(cells[:, 0] - post.x, cells[:, 1] - post.y)
            data[near <= max(0.5 * post.diameter, near.min())] = _POST
        info = {"resolution": cell_m, "width": columns, "height": rows, "origin": planar(-half[0], -half[1], 0.0)}
        return {"header": self.standard.header(stamp_ns, self.standard.frames.map), "info": info, "data": data}


def _marker(kind: int, size: tuple[float, float, float], color: tuple[float, ...], **fields: Any) -> Fields:
    rgba = dict(zip("rgba", (*color, 1.0), strict=True))
    pose = {"pose": planar(0.0, 0.0, 0.0), **fields}
    return {"type": kind, "scale": xyz(*size), "color": rgba, **pose}


def _at(x: float, y: float, z: float) -> dict[str, Fields]:
    return {"pose": {**planar(x, y, 0.0), "position": xyz(x, y, z)}}


def _points(places: FloatArray) -> list[Fields]:
    return [xyz(x, y, 0.0) for x, y in places.reshape(-1, 2).tolist()]


def _field_markers(field: FieldModel) -> list[Fields]:
    pieces = [np.stack((line[:-1], line[1:]), axis=1) for line in field.polylines(_STEP_M)]
    carpet = (field.length + 2.0 * field.border, field.width + 2.0 * field.border, 0.01)
    width = (field.line_width, 0.0, 0.0)
    found = [
        _marker(_CUBE, carpet, _GREEN, **_at(0.0, 0.0, -0.02)),
        _marker(_LINE_LIST, width, _WHITE, points=_points(np.concatenate(pieces))),
    ]
    found += [_marker(_CYLINDER, (d, d, 0.001), _WHITE, **_at(x, y, 0.0)) for x, y, d in field.discs.tolist()]
    for post in field.posts:
        size = (post.diameter, post.diameter, post.height)
        found.append(_marker(_CYLINDER, size, _WHITE, **_at(post.x, post.y, 0.5 * post.height)))
    return found


def _seen_markers(seen: Observation, pose: Pose) -> list[Fields]:
    """Line points, lines, crossings and landmarks on the field, if the robot stands at the pose."""
    found = []
    for places, kind, size, color in (
        (seen.points.positions_m, _POINTS, 0.04, _CYAN),
        (seen.lines.ends_m, _LINE_LIST, 0.03, _CYAN),
        (np.concatenate((seen.crossings.positions_m, seen.landmarks.positions_m)), _POINTS, 0.15, _ORANGE),
    ):
        if len(places):
            on_field = _points(pose.transform(places.reshape(-1, 2)))
            found.append(_marker(kind, (size, size, 0.0), color, points=on_field))
    return found
