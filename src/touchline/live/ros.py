"""Messages of ROS as what a robot says, and estimates as messages of ROS; whoever carries them.

What comes is read by its role: image, odometry, imu, compass, points (found by type, or named), /tf and /tf_static for
where camera and sensors are, /initialpose. What goes is a pose with covariance on NAMESPACE/touchline/pose, map → odom
(or map → base_footprint without odometry) on /tf, and the reasons on /diagnostics (REP 103, REP 105).
"""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from touchline.geometry import Pose, Pose3
from touchline.live.heard import Heard, Picture, Reading, Sight, Start, Told
from touchline.sources.bags import roles
from touchline.sources.bags.pixels import image_pixels
from touchline.sources.bags.point_cloud import cloud_points
from touchline.sources.bags.readings import attitude_of, place_and_turn, rates_of
from touchline.sources.bags.standard import BASE, BODY_FROM_OPTICAL, MAP, ODOM, OPTICAL, StandardMessages
from touchline.sources.bags.transforms import FrameTree, camera_body, plain
from touchline.sources.bags.with_rosbags import Codec
from touchline.sources.truth import heading_of
from touchline.types import Observation, Status, points_at

TRANSFORMS, FIRST_POSE = "tf", "initialpose"  # roles beside those of bags
FIXED_TOPICS = {"/tf": TRANSFORMS, "/tf_static": TRANSFORMS, "/initialpose": FIRST_POSE}
FIXED_TYPES = {
    TRANSFORMS: "tf2_msgs/msg/TFMessage",
    FIRST_POSE: "geometry_msgs/msg/PoseWithCovarianceStamped",
}
IMAGE_TOPIC, ODOMETRY_TOPIC, IMU_TOPIC = "/image/compressed", "/odom", "/imu/data"
PLAYED = {
    IMAGE_TOPIC: roles.COMPRESSED_IMAGE,
    ODOMETRY_TOPIC: "nav_msgs/msg/Odometry",
    IMU_TOPIC: "sensor_msgs/msg/Imu",
    "/tf": FIXED_TYPES[TRANSFORMS],
}
POSE, DIAGNOSTICS = "/touchline/pose", "/diagnostics"
POSE_TYPE, TF_TYPE, DIAGNOSTICS_TYPE = (
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "tf2_msgs/msg/TFMessage",
    "diagnostic_msgs/msg/DiagnosticArray",
)
_INERTIAL = ("gyro", "compass", "attitude")
_CAMERA_POSES = 1_000  # that are remembered: an image is older than the newest of a head that moves
_LEVELS = {Status.TRACKING: 0, Status.SEARCHING: 1, Status.LOST: 2}
_SECOND_NS = 1_000_000_000
_PLANE = np.ix_((0, 1, 5), (0, 1, 5))  # x, y and yaw of a covariance (6, 6)


class Outgoing(NamedTuple):
    """A message on its way: topic, type, and the message itself."""

    topic: str
    kind: str
    message: Any


class RosReader:
    """Messages to what was heard. base: the robot's frame on the ground; None: by its usual names."""

    def __init__(self, base: str | None = None) -> None:
        self._wanted = base
        self._tree = FrameTree()
        self._camera_frame = ""
        self._camera_poses: deque[tuple[int, Pose3]] = deque(maxlen=_CAMERA_POSES)
        self.refused: Counter[str] = Counter()

    def read(self, role: str, message: Any, with_compass: bool = False) -> Iterator[Heard]:
        """What a message of a role says; with_compass: an IMU's yaw is the heading on the field."""
        if role == TRANSFORMS:
            placed = self._tree.update(message.transforms)
            pose = self._newest_camera_pose()
            if placed and pose is not None:
                self._camera_poses.append((max(stamp_ns for _, stamp_ns in placed), pose))
        elif role == FIRST_POSE:
            place, turn = place_and_turn(message)
            covariance = np.asarray(message.pose.covariance, dtype=np.float64).reshape(6, 6)[_PLANE]
            heading = heading_of(turn.x, turn.y, turn.z, turn.w)
            yield Start(Pose(place.x, place.y, heading), covariance if covariance.any() else None)
        elif role == roles.ODOMETRY:
            place, turn = place_and_turn(message)
            yaw = heading_of(turn.x, turn.y, turn.z, turn.w)
            yield Reading("odometry", stamp_of(message), (place.x, place.y, yaw))
        elif role in (roles.IMU, roles.COMPASS):
            yield from self._inertial(message, role == roles.IMU, with_compass or role == roles.COMPASS)
        elif role == roles.IMAGE:
            yield from self._image(message)
        elif role == roles.POINTS:
            yield from self._points(message)

    def _inertial(self, message: Any, rates_too: bool, with_compass: bool) -> Iterator[Heard]:
        stamp_ns, sensor = stamp_of(message), self._base_from(message)
        rates, attitude = rates_of(message, sensor), attitude_of(message, sensor)
        if rates_too and rates is not None:
            yield Reading("gyro", stamp_ns, rates)
        if attitude is not None:
            if rates_too:
                yield Reading("attitude", stamp_ns, attitude[:2])
            if with_compass:
                yield Reading("compass", stamp_ns, attitude[2:])

    def _image(self, message: Any) -> Iterator[Heard]:
        camera = self._camera_pose(plain(message.header.frame_id), stamp_of(message))
        if hasattr(message, "encoding"):
            pixels = image_pixels(message)
            if isinstance(pixels, str):
                self.refused[f"an image {pixels}"] += 1
            else:
                yield Sight(stamp_of(message), time.monotonic(), pixels, base_from_camera=camera)
        else:
            data = np.asarray(message.data, dtype=np.uint8).tobytes()
            yield Sight(stamp_of(message), time.monotonic(), data, base_from_camera=camera)

    def _points(self, message: Any) -> Iterator[Heard]:
        points = cloud_points(message)
        if isinstance(points, str):
            self.refused[f"a cloud of points {points}"] += 1
            return
        seen = points_at(np.ascontiguousarray(self._base_from(message).transform(points)[:, :2]))
        stamp_ns = stamp_of(message)
        yield Sight(stamp_ns, time.monotonic(), observation=Observation(stamp_ns, seen))

    def _base_from(self, message: Any) -> Pose3:
        """`base_from_sensor`; a sensor that no transform places is in the base."""
        base = self._tree.base(self._wanted)
        found = None if base is None else self._tree.pose(base, plain(message.header.frame_id))
        return found or Pose3.identity()

    def _camera_pose(self, frame: str, stamp_ns: int) -> Pose3 | None:
        """`base_from_camera` at an image's time where transforms tell it: of those there are, the nearest in time."""
        if frame != self._camera_frame:
            self._camera_frame = frame
            self._camera_poses.clear()
            if (pose := self._newest_camera_pose()) is not None:
                self._camera_poses.append((stamp_ns, pose))
        return min(self._camera_poses, key=lambda each: abs(each[0] - stamp_ns), default=(0, None))[1]

    def _newest_camera_pose(self) -> Pose3 | None:
        base = self._tree.base(self._wanted)
        if base is None or not self._camera_frame:
            return None
        found = self._tree.pose(base, self._camera_frame)
        return None if found is None else camera_body(found, self._camera_frame)


class RosWriter:
    """Estimates, and what a recording holds, to messages. namespace: before the names of Touchline's own topics."""

    def __init__(self, codec: Codec, namespace: str = "") -> None:
        self._make = StandardMessages(codec)
        self._codec = codec
        self._namespace = namespace
        self._inertial: dict[str, tuple[float, ...]] = {}
        self._inertial_ns = 0

    def told(self, told: Told) -> Iterator[Outgoing]:
        """An estimate: pose and transform; of an image the diagnostics, too."""
        e = told.estimate
        stamp_ns = max(e.stamp_ns, 0)
        full = np.zeros((6, 6))
        full[_PLANE] = e.covariance
        pose = self._make.pose(stamp_ns, *e.pose, covariance=full.ravel())
        yield Outgoing(self._namespace + POSE, POSE_TYPE, pose)
        if e.status is Status.TRACKING:
            child = BASE if told.map_from_odom is None else ODOM
            placed = told.map_from_odom or e.pose
            moved = Pose3.from_roll_pitch_yaw(0.0, 0.0, placed.heading, (placed.x, placed.y, 0.0))
            yield Outgoing("/tf", TF_TYPE, self._make.transform(stamp_ns, MAP, child, moved))
        if told.image:
            values = _reasons(told)
            message = "; ".join([str(e.status), *e.problems])
            diagnostics = self._make.diagnostics(stamp_ns, _LEVELS[e.status], message, values)
            yield Outgoing(DIAGNOSTICS, DIAGNOSTICS_TYPE, diagnostics)

    def played(self, event: Reading | Picture) -> Iterator[Outgoing]:
        """What a recording holds, as a robot's messages; samples of one IMU at one time are one message."""
        inertial = isinstance(event, Reading) and event.sensor in _INERTIAL
        if self._inertial and not (inertial and event.stamp_ns == self._inertial_ns):
            yield self._imu()
        if isinstance(event, Picture):
            if event.data is not None:
                stamp_ns = max(event.stamp_ns, 0)
                if event.base_from_camera is not None:
                    optical = event.base_from_camera.compose(BODY_FROM_OPTICAL)
                    yield Outgoing("/tf", TF_TYPE, self._make.transform(stamp_ns, BASE, OPTICAL, optical))
                yield Outgoing(IMAGE_TOPIC, PLAYED[IMAGE_TOPIC], self._compressed(stamp_ns, event.data))
        elif inertial:
            self._inertial_ns = event.stamp_ns
            self._inertial[event.sensor] = event.values
        elif event.sensor == "odometry":
            message = self._make.odometry(max(event.stamp_ns, 0), *event.values[:3])
            yield Outgoing(ODOMETRY_TOPIC, PLAYED[ODOMETRY_TOPIC], message)

    def _imu(self) -> Outgoing:
        """The message of what was gathered of an IMU."""
        roll, pitch = self._inertial.get("attitude", (math.nan, math.nan))
        (yaw,) = self._inertial.get("compass", (math.nan,))
        rates = self._inertial.get("gyro", (math.nan,) * 3)
        self._inertial = {}
        message = self._make.imu(max(self._inertial_ns, 0), (roll, pitch, yaw), rates)
        return Outgoing(IMU_TOPIC, PLAYED[IMU_TOPIC], message)

    def _compressed(self, stamp_ns: int, data: bytes) -> Any:
        kind = "png" if data.startswith(b"\x89PNG") else "jpeg"
        header = self._make.header(stamp_ns, OPTICAL)
        pixels = np.frombuffer(data, dtype=np.uint8)
        return self._codec.make(roles.COMPRESSED_IMAGE, header=header, format=kind, data=pixels)


def _reasons(told: Told) -> dict[str, str]:
    e = told.estimate
    values = {
        "residual_m": e.residual_m,
        "points": e.points,
        "probability": e.probability,
        "mode": e.mode,
        "dropped images": told.dropped,
        "after_s": round(told.after_s, 4),
    }
    return {key: str(value) for key, value in values.items() if value is not None}


def stamp_of(message: Any) -> int:
    """The stamp of a message's header (ns)."""
    stamp = message.header.stamp
    return int(stamp.sec) * _SECOND_NS + int(stamp.nanosec)
