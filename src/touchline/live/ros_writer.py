"""Estimates, and what a recording holds, as messages of ROS; of Booster's robots /booster_soccer/robot_pose, too."""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from touchline.camera import PerspectiveCamera
from touchline.geometry import Pose3
from touchline.live.datagrams import reading_datagram, seen_datagram
from touchline.live.heard import Picture, Published, Reading
from touchline.live.ros_reader import FIXED_TYPES, SAID, SEEN_TOPIC, TRANSFORMS, WHEELS_TOPIC
from touchline.sources.bags import roles
from touchline.sources.bags.result_messages import Outgoing, ResultMessages
from touchline.sources.bags.standard import BASE, BODY
from touchline.sources.bags.with_rosbags import Codec
from touchline.types import Status

_IMAGE_TOPIC, _INFO_TOPIC, _ODOMETRY_TOPIC, _IMU_TOPIC = "/image/compressed", "/camera_info", "/odom", "/imu/data"
PLAYED = {
    _IMAGE_TOPIC: roles.COMPRESSED_IMAGE,
    _INFO_TOPIC: "sensor_msgs/msg/CameraInfo",
    _ODOMETRY_TOPIC: "nav_msgs/msg/Odometry",
    _IMU_TOPIC: "sensor_msgs/msg/Imu",
    "/tf": FIXED_TYPES[TRANSFORMS],
    WHEELS_TOPIC: FIXED_TYPES[SAID],
    SEEN_TOPIC: FIXED_TYPES[SAID],
}
BOOSTER_POSE_TYPE = "geometry_msgs/msg/Pose2D"
_INERTIAL = ("gyro", "compass", "attitude")
_MAX_BYTES = 8_000_000  # of what a detector found


class RosWriter:
    """Estimates, and what a recording holds, to messages. camera: that took the images that are played."""

    def __init__(
        self, codec: Codec, results: ResultMessages | None = None, camera: PerspectiveCamera | None = None
    ) -> None:
        self._camera = camera
        self.results = results or ResultMessages(codec)
        self._make, self._codec = self.results.standard, codec
        self._inertial: dict[str, tuple[float, ...]] = {}
        self._inertial_ns = self._leaned_ns = 0
        self._booster: str | None = None

    def as_booster(self, name: str) -> str:
        """Tell the pose on the topic of Booster's robots, too. name: what stands behind it. Returns the topic."""
        self._booster = f"/booster_soccer/robot_pose{name}"
        return self._booster

    def published(self, published: Published) -> Iterator[Outgoing]:
        """An estimate: pose and transform; of an image what explains it, too."""
        e = published.estimate
        stamp_ns = max(e.stamp_ns, 0)
        yield from self.results.located(stamp_ns, e, published.map_from_odom)
        if e.status is Status.TRACKING and self._booster is not None:
            flat = dict(zip(("x", "y", "theta"), map(float, e.pose), strict=True))
            yield Outgoing(self._booster, BOOSTER_POSE_TYPE, self._codec.make(BOOSTER_POSE_TYPE, **flat))
        if published.image:
            more = {"dropped images": published.dropped, "after_s": round(published.after_s, 4)}
            yield from self.results.explained(stamp_ns, e, more)

    def played(self, event: Reading | Picture) -> Iterator[Outgoing]:
        """What a recording holds, as a robot's messages; samples of one IMU at one time are one message."""
        inertial = isinstance(event, Reading) and event.sensor in _INERTIAL
        if not (inertial and event.stamp_ns == self._inertial_ns):
            yield from self.rest()
        if isinstance(event, Picture):
            stamp_ns = max(event.stamp_ns, 0)
            if event.observation is not None:
                found = replace(event.observation, stamp_ns=event.stamp_ns)
                yield self._said(SEEN_TOPIC, seen_datagram(found, event.base_from_camera, _MAX_BYTES))
            elif event.data is not None:
                yield from self._described(stamp_ns, event.base_from_camera)
                yield Outgoing(_IMAGE_TOPIC, PLAYED[_IMAGE_TOPIC], self._make.compressed(stamp_ns, event.data))
        elif inertial:
            self._inertial_ns = event.stamp_ns
            self._inertial[event.sensor] = event.values
        elif event.sensor == "odometry":
            message = self._make.odometry(max(event.stamp_ns, 0), *event.values[:3])
            yield Outgoing(_ODOMETRY_TOPIC, PLAYED[_ODOMETRY_TOPIC], message)
        else:
            yield self._said(WHEELS_TOPIC, reading_datagram(event))

    def rest(self) -> Iterator[Outgoing]:
        """What was gathered of an IMU, at the end."""
        if self._camera is not None and self._camera.use_attitude and "attitude" in self._inertial:
            lean = Pose3.from_roll_pitch_yaw(*self._inertial["attitude"])
            self._leaned_ns = max(self._inertial_ns, 0)
            yield self._placed(self._make.transform(self._leaned_ns, BASE, BODY, lean))
        if self._inertial:
            yield self._imu()

    def _described(self, stamp_ns: int, base_from_camera: Pose3 | None) -> Iterator[Outgoing]:
        """Where the camera was when it took an image, and what it is, as far as ROS has messages for it."""
        if base_from_camera is not None:
            yield self._placed(self._make.camera_at(stamp_ns, base_from_camera))
        elif self._camera is not None:
            # stamped as the newest lean: who receives it takes it for one of that lean, and an image may come late
            leans = self._camera.use_attitude
            placed_ns, body = (self._leaned_ns, BODY) if leans else (stamp_ns, BASE)
            yield self._placed(self._make.camera_at(placed_ns, self._camera.base_from_camera, body))
        if self._camera is not None:
            yield Outgoing(_INFO_TOPIC, PLAYED[_INFO_TOPIC], self._make.camera_info(stamp_ns, self._camera))

    def _placed(self, transform: Any) -> Outgoing:
        return Outgoing("/tf", PLAYED["/tf"], transform)

    def _said(self, topic: str, line: bytes) -> Outgoing:
        return Outgoing(topic, PLAYED[topic], self._codec.make(PLAYED[topic], data=line.decode().rstrip()))

    def _imu(self) -> Outgoing:
        """The message of what was gathered of an IMU."""
        roll, pitch = self._inertial.get("attitude", (math.nan, math.nan))
        (yaw,) = self._inertial.get("compass", (math.nan,))
        rates = self._inertial.get("gyro", (math.nan,) * 3)
        self._inertial = {}
        message = self._make.imu(max(self._inertial_ns, 0), (roll, pitch, yaw), rates)
        return Outgoing(_IMU_TOPIC, PLAYED[_IMU_TOPIC], message)
