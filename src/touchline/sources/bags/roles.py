"""Which topic of a foreign bag is what: found by type, chosen by name, and to be named by the user."""

import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from typing_extensions import Self

from touchline.errors import InputError
from touchline.messages import did_you_mean, listed
from touchline.sources.bags.messages import Topic
from touchline.sources.problems import ProblemKind, ProblemLog

IMAGE, CAMERA_INFO, ODOMETRY, IMU = "image", "camera_info", "odometry", "imu"
COMPASS, TRUTH, POINTS = "compass", "truth", "points"
DETECTIONS, LINE_SEGMENTS, MARKINGS, GOALPOSTS, HEAD = "detections", "lines", "markings", "goalposts", "head"
DETECTION_TOPIC = "/booster_soccer/detection"
FEATURES = (DETECTIONS, LINE_SEGMENTS, MARKINGS, GOALPOSTS)
"""Roles of which all that are there make up what the robot's own detector found in an image."""
_STAMPED_POSES = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped"
_POSES = ("nav_msgs/msg/Odometry", *_STAMPED_POSES)
RAW_IMAGE, COMPRESSED_IMAGE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
IMU_TYPE, POINT_CLOUD = "sensor_msgs/msg/Imu", "sensor_msgs/msg/PointCloud2"
LOW_STATE, ODOMETER = "booster_interface/msg/LowState", "booster_interface/msg/Odometer"
UNSTAMPED = frozenset((LOW_STATE, ODOMETER, "geometry_msgs/msg/Pose"))
"""Types without a header: their messages are taken for as old as they are when they come."""
_MARKINGS_2D, _GOALPOSTS_2D = "soccer_vision_2d_msgs/msg/MarkingArray", "soccer_vision_2d_msgs/msg/GoalpostArray"
IN_PIXELS = frozenset((_MARKINGS_2D, _GOALPOSTS_2D))
"""Types of features whose places are pixels: they need the camera."""
ROLES = {
    IMAGE: (RAW_IMAGE, COMPRESSED_IMAGE),
    CAMERA_INFO: ("sensor_msgs/msg/CameraInfo",),
    ODOMETRY: (*_POSES, ODOMETER),
    IMU: (IMU_TYPE, LOW_STATE),
    COMPASS: (IMU_TYPE, LOW_STATE),
    TRUTH: _POSES,
    POINTS: (POINT_CLOUD,),
    DETECTIONS: ("vision_interface/msg/Detections",),
    LINE_SEGMENTS: ("vision_interface/msg/LineSegments",),
    MARKINGS: ("soccer_vision_3d_msgs/msg/MarkingArray", _MARKINGS_2D),
    GOALPOSTS: ("soccer_vision_3d_msgs/msg/GoalpostArray", _GOALPOSTS_2D),
    HEAD: ("geometry_msgs/msg/Pose",),
}
"""What a topic can be, and the types that can be it."""
TRANSFORM_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_TRUTH_NAME = re.compile(r"truth|(?:^|[/_])gt(?:$|[/_])|mocap|vicon|optitrack|vrpn")
_LINES_NAME = re.compile(r"line|marking|field")
_NOT_THE_CAMERA = re.compile(r"depth|debug|mask|overlay|annotat|result|disparity|infra|compressedDepth|theora")


@dataclass(frozen=True, slots=True)
class BagOptions:
    """What a bag does not say of itself. topics: role -> topic. field: a preset's name or a file. camera: a file.

    base: the frame of the robot on the ground, x forward, y left. late_ms: by which messages without a stamp were
    received later than measured. from_zero: times count from the bag's first second.
    """

    topics: Mapping[str, str] = field(default_factory=dict)
    field: str | None = None
    camera: Path | None = None
    base: str | None = None
    late_ms: float = 0.0
    from_zero: bool = False

    def given(self) -> bool:
        """Whether anything is."""
        return self != BagOptions()

    def to_dict(self) -> dict[str, Any]:
        """As JSON knows it, files by their whole paths: a run notes how its recording was read."""
        file = None if self.field is None or not Path(self.field).is_file() else str(Path(self.field).resolve())
        camera = None if self.camera is None else str(self.camera.resolve())
        named = {"topics": dict(self.topics), "field": file or self.field, "camera": camera, "base": self.base}
        return {**named, "late_ms": self.late_ms, "from_zero": self.from_zero}

    @classmethod
    def from_dict(cls, tree: Any) -> Self:
        """The inverse of `to_dict`; of anything else, nothing is given."""
        if not isinstance(tree, dict) or not isinstance(topics := tree.get("topics", {}), dict):
            return cls()
        field, camera, base = (None if tree.get(key) is None else str(tree[key]) for key in ("field", "camera", "base"))
        named = {str(role): str(name) for role, name in topics.items()}
        late = tree.get("late_ms", 0.0)
        late_ms = float(late) if type(late) in (int, float) else 0.0
        from_zero = tree.get("from_zero") is True
        return cls(named, field, None if camera is None else Path(camera), base, late_ms, from_zero)


def choose_topics(topics: Mapping[str, Topic], named: Mapping[str, str], problems: ProblemLog) -> dict[str, Topic]:
    """The topic of each role that the bag has one for. Where there was a choice, the log says so.

    Raises InputError for a role, topic or type that does not fit.
    """
    chosen: dict[str, Topic] = {role: _named(topics, role, name) for role, name in named.items()}
    beside = (IMAGE, CAMERA_INFO, POINTS)  # what a detector has seen already
    # a compass has to be named: what most robots send as yaw is summed up from the gyro and starts anywhere
    for role in (*FEATURES, IMAGE, CAMERA_INFO, ODOMETRY, IMU, TRUTH, POINTS, HEAD):
        needed = role == CAMERA_INFO and in_pixels(chosen)
        if role in chosen or (role in beside and not needed and IMAGE not in named and has_features(chosen)):
            continue
        candidates = [topic for topic in topics.values() if topic.type in ROLES[role] and topic.messages]
        fitting = _fitting(role, candidates, chosen)
        if not fitting:
            continue
        chosen[role] = fitting[0]
        if len(fitting) > 1 and role != CAMERA_INFO:
            others = listed([topic.name for topic in fitting[1:]])
            what = f"is read as {role}; there is also {others} (--topic {role}=/NAME chooses)"
            problems.add(ProblemKind.TOPIC, fitting[0].name, what)
    return chosen


def has_features(chosen: Collection[str]) -> bool:
    """Whether one of some roles is a detector's."""
    return any(role in chosen for role in FEATURES)


def in_pixels(chosen: Mapping[str, Topic]) -> list[str]:
    """The names of the topics whose features are pixels."""
    return [topic.name for role, topic in chosen.items() if role in FEATURES and topic.type in IN_PIXELS]


def _named(topics: Mapping[str, Topic], role: str, name: str) -> Topic:
    if role not in ROLES:
        raise InputError(f"--topic {role}={name}: {role} is not known; {did_you_mean(role, list(ROLES))}")
    if name not in topics:
        raise InputError(f"--topic {role}={name}: is not in the bag; {did_you_mean(name, list(topics))}")
    if topics[name].type not in ROLES[role]:
        raise InputError(f"--topic {role}={name}: is a {topics[name].type}, expected {listed(list(ROLES[role]))}")
    return topics[name]


def _fitting(role: str, candidates: Iterable[Topic], chosen: Mapping[str, Topic]) -> list[Topic]:
    """Those that can be meant, the likeliest first."""
    by_number = sorted(candidates, key=lambda topic: (-topic.messages, topic.name))
    if role == IMAGE:
        by_number.sort(key=lambda topic: (bool(_NOT_THE_CAMERA.search(topic.name)), topic.type != RAW_IMAGE))
        return by_number
    if role == CAMERA_INFO:
        image = chosen.get(IMAGE)
        beside = [each for each in by_number if image and _camera_of(each.name) == _camera_of(image.name)]
        return beside or (by_number if len(by_number) == 1 else [])
    if role == TRUTH:
        return [topic for topic in by_number if _TRUTH_NAME.search(topic.name.lower())]
    if role == ODOMETRY:
        kinds = (_POSES[0], ODOMETER)
        rest = [each for each in by_number if each.type in kinds and not _TRUTH_NAME.search(each.name.lower())]
        return sorted(rest, key=lambda topic: "odom" not in topic.name.lower())
    if role == POINTS:
        return [each for each in by_number if _LINES_NAME.search(each.name.lower()) or IMAGE not in chosen]
    if role in FEATURES:  # places in metres come first: they need no camera
        return sorted(by_number, key=lambda topic: ROLES[role].index(topic.type))
    if role == HEAD:
        return [each for each in by_number if "head_pose" in each.name.lower()]
    return by_number


def _camera_of(name: str) -> str:
    """/front/image_raw/compressed, /front/camera_info -> /front."""
    return re.sub(r"/(?:image[^/]*|camera_info)(?:/.*)?$", "", name)
