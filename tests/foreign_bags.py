"""Bags as another team's robot writes them: by the libraries' own writers, with that robot's topics and frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from touchline.geometry import Pose3
from touchline.sources import Recording

EPOCH_NS = 1_763_780_000_123_456_789
OPTICAL = "head_camera_optical_frame"
BASE_FROM_BODY = 0.45  # height (m) of base_link, of which only /tf_static tells
Message = tuple[int, str, str, Any]
Image = Callable[["Types", Any, Any], tuple[str, Any]]


@cache
def types_of(ros1: bool) -> Any:
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_IRON)
    if ros1:
        text = "geometry_msgs/TransformStamped[] transforms"
        store.register(get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))
    return store


class Types:
    """Messages of ROS 2, or of ROS 1."""

    def __init__(self, ros1: bool = False) -> None:
        self.ros1 = ros1
        self.store = types_of(ros1)

    def make(self, kind: str, **fields: Any) -> Any:
        return self.store.types[kind](**fields)

    def stamp(self, time_ns: int) -> Any:
        return self.make("builtin_interfaces/msg/Time", sec=time_ns // 10**9, nanosec=time_ns % 10**9)

    def header(self, time_ns: int, frame: str) -> Any:
        extra = {"seq": 0} if self.ros1 else {}
        return self.make("std_msgs/msg/Header", stamp=self.stamp(time_ns), frame_id=frame, **extra)

    def vector(self, x: float, y: float, z: float, kind: str = "Vector3") -> Any:
        return self.make(f"geometry_msgs/msg/{kind}", x=float(x), y=float(y), z=float(z))

    def quaternion(self, rotation: Any) -> Any:
        w = math.sqrt(max(1 + np.trace(rotation), 1e-12)) / 2
        x, y, z = (rotation[i, j] - rotation[j, i] for i, j in ((2, 1), (0, 2), (1, 0)))
        return self.make("geometry_msgs/msg/Quaternion", x=x / (4 * w), y=y / (4 * w), z=z / (4 * w), w=w)

    def transform(self, time_ns: int, parent: str, child: str, pose: Pose3) -> Any:
        kind = "geometry_msgs/msg/Transform"
        turn = self.quaternion(pose.rotation)
        placed = self.make(kind, translation=self.vector(*pose.translation_m), rotation=turn)
        header = self.header(time_ns, parent)
        return self.make("geometry_msgs/msg/TransformStamped", header=header, child_frame_id=child, transform=placed)

    def transforms(self, *each: Any) -> Any:
        return self.make("tf2_msgs/msg/TFMessage", transforms=list(each))


def raw(encoding: str, convert: Callable[[Any], Any]) -> Image:
    """Images as sensor_msgs/Image, with some bytes at the end of each row."""

    def write(types: Types, header: Any, pixels: Any) -> tuple[str, Any]:
        rows = np.ascontiguousarray(convert(pixels)).reshape(pixels.shape[0], -1).view(np.uint8)
        padded = np.pad(rows, ((0, 0), (0, 6)))
        kind = "sensor_msgs/msg/Image"
        height, width, step = *pixels.shape[:2], padded.shape[1]
        fields = {"height": height, "width": width, "encoding": encoding, "is_bigendian": 0, "step": step}
        return kind, types.make(kind, header=header, data=padded.ravel(), **fields)

    return write


def compressed(form: str, ending: str, convert: Callable[[Any], Any] = lambda pixels: pixels) -> Image:
    """Images as sensor_msgs/CompressedImage."""

    def write(types: Types, header: Any, pixels: Any) -> tuple[str, Any]:
        kind, data = "sensor_msgs/msg/CompressedImage", cv2.imencode(ending, convert(pixels))[1]
        return kind, types.make(kind, header=header, format=form, data=data.ravel())

    return write


def foreign_messages(recording: Recording, types: Types, image: Image, topic: str) -> Iterator[Message]:
    """What a walking robot records: time (ns), topic, type and message, in the order of time."""
    down = Pose3(np.eye(3), np.array([0.0, 0.0, BASE_FROM_BODY]))
    yield (
        EPOCH_NS,
        "/tf_static",
        "tf2_msgs/msg/TFMessage",
        types.transforms(
            types.transform(EPOCH_NS, "base_footprint", "base_link", down),
            types.transform(EPOCH_NS, "base_link", "imu_link", Pose3.from_roll_pitch_yaw(0.0, 0.0, math.pi / 2)),
            types.transform(EPOCH_NS, "head_camera", OPTICAL, optical()),
        ),
    )
    for frame in recording:
        time_ns = EPOCH_NS + frame.stamp_ns
        odometry, gyro, tilt = frame.odometry, frame.gyro, frame.tilt
        parts = (odometry, gyro, tilt, frame.base_from_camera, frame.image)
        assert not any(part is None for part in parts)
        for stamp, (x, y, theta) in zip(odometry.stamp_ns.tolist(), odometry.values.tolist(), strict=True):
            yield EPOCH_NS + stamp, "/robot/odom", *odometry_message(types, EPOCH_NS + stamp, x, y, theta)
        for stamp, rates, lean in zip(gyro.stamp_ns.tolist(), gyro.values, tilt.values, strict=True):
            yield EPOCH_NS + stamp, "/imu/data", *imu_message(types, EPOCH_NS + stamp, rates, *lean)
        head = down.inverse().compose(frame.base_from_camera)
        moved = types.transforms(types.transform(time_ns, "base_link", "head_camera", head))
        yield time_ns, "/tf", "tf2_msgs/msg/TFMessage", moved
        header = types.header(time_ns, OPTICAL)
        yield time_ns, "/front/camera_info", *camera_info(types, header, recording)
        yield time_ns + 2_000_000, topic, *image(types, header, frame.image)


def optical() -> Pose3:
    """`body_from_optical` of a camera."""
    return Pose3(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.zeros(3))


def odometry_message(types: Types, time_ns: int, x: float, y: float, theta: float) -> tuple[str, Any]:
    turn = types.quaternion(Pose3.from_roll_pitch_yaw(0.0, 0.0, theta).rotation)
    place = types.make("geometry_msgs/msg/Pose", position=types.vector(x, y, 0.0, "Point"), orientation=turn)
    pose = types.make("geometry_msgs/msg/PoseWithCovariance", pose=place, covariance=np.zeros(36))
    still = types.make("geometry_msgs/msg/Twist", linear=types.vector(0, 0, 0), angular=types.vector(0, 0, 0))
    twist = types.make("geometry_msgs/msg/TwistWithCovariance", twist=still, covariance=np.zeros(36))
    kind = "nav_msgs/msg/Odometry"
    header = types.header(time_ns, "odom")
    return kind, types.make(kind, header=header, child_frame_id="base_footprint", pose=pose, twist=twist)


def imu_message(types: Types, time_ns: int, rates: Any, roll: float, pitch: float) -> tuple[str, Any]:
    """Of a sensor that is mounted a quarter turn to the left."""
    mount = Pose3.from_roll_pitch_yaw(0.0, 0.0, math.pi / 2).rotation
    attitude = Pose3.from_roll_pitch_yaw(roll, pitch, 1.0).rotation @ mount
    kind = "sensor_msgs/msg/Imu"
    return kind, types.make(
        kind,
        header=types.header(time_ns, "imu_link"),
        orientation=types.quaternion(attitude),
        orientation_covariance=np.zeros(9),
        angular_velocity=types.vector(*(mount.T @ rates)),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=types.vector(0, 0, 9.81),
        linear_acceleration_covariance=np.zeros(9),
    )


def camera_info(types: Types, header: Any, recording: Recording) -> tuple[str, Any]:
    assert recording.camera_file is not None
    camera = yaml.safe_load(recording.camera_file.read_text())
    matrix = np.array([camera["fx"], 0, camera["cx"], 0, camera["fy"], camera["cy"], 0, 0, 1], dtype=np.float64)
    region = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
    fields = {
        "d": np.array(camera.get("distortion", [0.0] * 5), dtype=np.float64),
        "k": matrix,
        "r": np.eye(3).ravel(),
        "p": np.zeros(12),
    }
    kind = "sensor_msgs/msg/CameraInfo"
    return kind, types.make(
        kind,
        header=header,
        height=camera["height"],
        width=camera["width"],
        distortion_model="plumb_bob",
        binning_x=0,
        binning_y=0,
        roi=types.make("sensor_msgs/msg/RegionOfInterest", **region),
        **({name.upper(): value for name, value in fields.items()} if types.ros1 else fields),
    )


def cloud(types: Types, time_ns: int, frame: str, places: list[tuple[float, float, float]]) -> Message:
    """Points with a field of something else between them, as detectors write them."""
    kind, part = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/PointField"
    rows = np.zeros(len(places), np.dtype([("x", "<f4"), ("i", "u1"), ("y", "<f4"), ("z", "<f4")], align=False))
    for name, column in zip("xyz", np.array(places, dtype=np.float64).reshape(-1, 3).T, strict=True):
        rows[name] = column
    offsets = {"x": 0, "y": 5, "z": 9}
    fields = [types.make(part, name=name, offset=at, datatype=7, count=1) for name, at in offsets.items()]
    size = {"height": 1, "width": len(places), "point_step": 13, "row_step": 13 * len(places)}
    data = np.frombuffer(rows.tobytes(), dtype=np.uint8)
    header = types.header(time_ns, frame)
    flags = {"is_bigendian": False, "is_dense": True}
    return time_ns, "/vision/lines", kind, types.make(kind, header=header, fields=fields, data=data, **size, **flags)


def write_foreign(path: Path, messages: Iterator[Message], types: Types) -> Path:
    """A bag of the kind that the path's ending tells: .bag, .mcap, or a rosbag2 folder."""
    if path.suffix == ".bag":
        with Ros1Writer(path) as writer:
            known: dict[str, Any] = {}
            for time_ns, topic, kind, message in messages:
                if topic not in known:
                    known[topic] = writer.add_connection(topic, kind, typestore=types.store)
                writer.write(known[topic], time_ns, types.store.serialize_ros1(message, kind))
    elif path.suffix == ".mcap":
        with path.open("wb") as file:
            mcap, channels = McapWriter(file, chunk_size=100_000), {}
            mcap.start(profile="ros2")
            for time_ns, topic, kind, message in messages:
                if topic not in channels:
                    text = types.store.generate_msgdef(kind, ros_version=2)[0].encode()
                    channels[topic] = mcap.register_channel(topic, "cdr", mcap.register_schema(kind, "ros2msg", text))
                data = bytes(types.store.serialize_cdr(message, kind))
                mcap.add_message(channels[topic], time_ns, data, time_ns)
            mcap.finish()
    else:
        with Ros2Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as ros2:
            topics: dict[str, Any] = {}
            for time_ns, topic, kind, message in messages:
                if topic not in topics:
                    topics[topic] = ros2.add_connection(topic, kind, typestore=types.store)
                ros2.write(topics[topic], time_ns, types.store.serialize_cdr(message, kind))
    return path
