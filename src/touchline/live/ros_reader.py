"""Messages of ROS as what a robot reports.

Each is read by its role: images, odometry, IMU, compass, line points, what a detector found (found by type, or
named), /tf and /tf_static for where camera and sensors are, /initialpose, and what ROS has no message for as the JSON
of `touchline.live.datagrams` in strings: /touchline/evidence, /touchline/wheels, /touchline/seen.
"""

import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from touchline.camera import Camera, camera_from_mapping
from touchline.geometry import Pose
from touchline.live.datagrams import Datagrams
from touchline.live.heard import Described, Heard, Reading, Sight, Start, count_refused
from touchline.sources.bags import roles
from touchline.sources.bags.camera_file import camera_mapping
from touchline.sources.bags.camera_track import CameraTrack
from touchline.sources.bags.gathering import Gathering
from touchline.sources.bags.pixels import image_pixels
from touchline.sources.bags.readings import attitude_of, cloud_points, place_and_turn, planar_pose, rates_of
from touchline.sources.bags.team_features import FeatureRow
from touchline.sources.bags.transforms import FrameTree, TransformOdometry, header_stamp_ns
from touchline.sources.observations import observation_of
from touchline.sources.truth import heading_of
from touchline.types import MAX_OBSERVED_POINTS, Observation, points_at

TRANSFORMS, FIRST_POSE, SAID, CLOCK = "tf", "initialpose", "said", "clock"  # roles beside those of bags
WHEELS_TOPIC, SEEN_TOPIC = "/touchline/wheels", "/touchline/seen"
FIXED_TOPICS = {
    "/tf": TRANSFORMS,
    "/tf_static": TRANSFORMS,
    "/initialpose": FIRST_POSE,
    "/clock": CLOCK,
    "/touchline/evidence": SAID,
    "/touchline/game_state": SAID,
    WHEELS_TOPIC: SAID,
    SEEN_TOPIC: SAID,
}
FIXED_TYPES = {
    TRANSFORMS: "tf2_msgs/msg/TFMessage",
    FIRST_POSE: "geometry_msgs/msg/PoseWithCovarianceStamped",
    CLOCK: "rosgraph_msgs/msg/Clock",
    SAID: "std_msgs/msg/String",
}
_PLANE = np.ix_((0, 1, 5), (0, 1, 5))  # x, y and yaw of a covariance (6, 6)
_WAIT_NS = 30_000_000  # for the slower of two topics that tell of one image


class RosReader:
    """Messages to what was heard. base: the robot's frame on the ground; None: by its usual names.

    camera: that of features in pixels; where a topic tells the head's pose, camera.yaml places it in the head.
    late_ms: by which messages without a stamp are received later than measured.
    """

    def __init__(self, base: str | None = None, camera: Camera | None = None, late_ms: float = 0.0) -> None:
        self._wanted, self._late_ns = base, round(1e6 * late_ms)
        self._tree = FrameTree()
        self._track = CameraTrack(self._tree, base, camera)
        self._info: Any = None  # CameraInfo, until transforms tell where the camera is
        self._odometry = TransformOdometry(self._tree, base)
        self.odometry_by_transforms = False
        """Whether no topic is the odometry."""
        self._clock_ns: int | None = None  # of a simulator or a bag that is played
        self._datagrams = Datagrams()
        self._seen: Gathering[FeatureRow] = Gathering(_WAIT_NS)
        self._arrived: dict[int, float] = {}
        self.counted: Counter[str] = Counter()

    @property
    def camera(self) -> Camera | None:
        """That of the images, given or described."""
        return self._track.camera

    @property
    def refused(self) -> Counter[str]:
        """What was left out so far, and how often."""
        late = {"features that came after those of a later image": self._seen.late} if self._seen.late else {}
        return self.counted + self._datagrams.refused + Counter(late)

    def expect(self, role: str) -> None:
        """Of a topic that tells of the same images as others."""
        if role in roles.FEATURES:
            self._seen.expect(role)

    def due(self) -> Iterator[Heard]:
        """What was found in images of which nothing more will come, or was waited for long enough."""
        for stamp_ns, rows in self._seen.ready(time.monotonic_ns()):
            arrived_s = self._arrived.pop(stamp_ns)
            yield Sight(stamp_ns, arrived_s, observation=observation_of(stamp_ns, rows))

    def read(self, role: str, message: Any, with_compass: bool = False) -> Iterator[Heard]:
        """What a message of a role says; with_compass: an IMU's yaw is the heading on the field."""
        if role == TRANSFORMS:
            placed = self._tree.update(message.transforms)
            self._track.moved(placed)
            for stamp_ns, *planar in self._odometry.moved(placed) if self.odometry_by_transforms else ():
                yield Reading("odometry", stamp_ns, tuple(planar))
        elif role == CLOCK:
            self._clock_ns = int(message.clock.sec) * 1_000_000_000 + int(message.clock.nanosec)
        elif role == FIRST_POSE:
            place, turn = place_and_turn(message)
            covariance = np.asarray(message.pose.covariance, dtype=np.float64).reshape(6, 6)[_PLANE]
            heading = heading_of(turn.x, turn.y, turn.z, turn.w)
            yield Start(Pose(place.x, place.y, heading), covariance if covariance.any() else None)
        elif role == roles.ODOMETRY:
            self._tree.moved(message)
            yield Reading("odometry", self._stamp(message), planar_pose(message))
        elif role in (roles.IMU, roles.COMPASS):
            yield from self._inertial(message, role == roles.IMU, with_compass or role == roles.COMPASS)
        elif role == roles.CAMERA_INFO:
            self._info = message if self.camera is None else None
        elif role == roles.IMAGE:
            yield from self._described()
            yield from self._image(message)
        elif role == roles.POINTS:
            yield from self._points(message)
        elif role in roles.FEATURES:
            stamp_ns, now_ns = self._stamp(message), time.monotonic_ns()
            rows = self._track.features(role, stamp_ns, message)[:MAX_OBSERVED_POINTS]
            self._arrived.setdefault(stamp_ns, now_ns / 1e9)
            self._seen.add(role, stamp_ns, rows, now_ns)
            yield from self.due()
        elif role == roles.HEAD:
            self._track.head(self._stamp(message), message)
        elif role == SAID:
            heard = self._datagrams.read(str(message.data).encode())
            if heard is not None:
                yield heard

    def _described(self) -> Iterator[Heard]:
        """The camera, once CameraInfo and transforms have told it."""
        if self._info is None:
            return
        frame = self._info.header.frame_id
        mapping = camera_mapping(self._info, self._track.at(frame, self._stamp(self._info)))
        if isinstance(mapping, str):
            count_refused(self.counted, f"an image without a camera: {mapping}; --camera FILE gives one")
            return
        self._track.camera, self._info = camera_from_mapping(mapping, Path("CameraInfo")), None
        yield Described(self._track.camera)

    def _stamp(self, message: Any) -> int:
        """The stamp of a message's header (ns); of one without, the time now by /clock, else by this machine, less the
        delay.
        """
        if not hasattr(message, "header"):
            return (time.time_ns() if self._clock_ns is None else self._clock_ns) - self._late_ns
        return header_stamp_ns(message.header)

    def _inertial(self, message: Any, rates_too: bool, with_compass: bool) -> Iterator[Heard]:
        stamp_ns, sensor = self._stamp(message), self._tree.base_from(message, self._wanted)
        rates, attitude = rates_of(message, sensor), attitude_of(message, sensor)
        if rates_too and rates is not None:
            yield Reading("gyro", stamp_ns, rates)
        if attitude is not None:
            if rates_too:
                self._track.leaned(stamp_ns, *attitude[:2])
                yield Reading("attitude", stamp_ns, attitude[:2])
            if with_compass:
                yield Reading("compass", stamp_ns, attitude[2:])

    def _image(self, message: Any) -> Iterator[Heard]:
        camera = self._track.at(message.header.frame_id, self._stamp(message))
        if hasattr(message, "encoding"):
            pixels = image_pixels(message)
            if isinstance(pixels, str):
                count_refused(self.counted, f"an image {pixels}")
            else:
                yield Sight(self._stamp(message), time.monotonic(), pixels, base_from_camera=camera)
        else:
            data = np.asarray(message.data, dtype=np.uint8).tobytes()
            yield Sight(self._stamp(message), time.monotonic(), data, base_from_camera=camera)

    def _points(self, message: Any) -> Iterator[Heard]:
        points = cloud_points(message)
        if isinstance(points, str):
            count_refused(self.counted, f"a cloud of points {points}")
            return
        seen = points_at(np.ascontiguousarray(self._tree.base_from(message, self._wanted).transform(points)[:, :2]))
        stamp_ns = self._stamp(message)
        yield Sight(stamp_ns, time.monotonic(), observation=Observation(stamp_ns, seen))
