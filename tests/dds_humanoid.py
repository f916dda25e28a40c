"""A humanoid that publishes by Cyclone DDS's own types and writers, as another team's program would.

python tests/dds_humanoid.py RECORDING [TOPIC LEFT OUT]
"""

import math
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct, types
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.topic import Topic
from foreign_bags import EPOCH_NS, Message, Types, compressed, foreign_messages

from touchline.geometry import Pose3
from touchline.sources import Recording, open_source

RELIABLE = Policy.Reliability.Reliable(10**8)
CDR = Policy.DataRepresentation(use_cdrv0_representation=True)


@dataclass
class Time(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
    sec: types.int32
    nanosec: types.uint32


@dataclass
class Header(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
    stamp: Time
    frame_id: str


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs.msg.dds_.Vector3_"):
    x: types.float64
    y: types.float64
    z: types.float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs.msg.dds_.Quaternion_"):
    x: types.float64
    y: types.float64
    z: types.float64
    w: types.float64


@dataclass
class Transform(IdlStruct, typename="geometry_msgs.msg.dds_.Transform_"):
    translation: Vector3
    rotation: Quaternion


@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs.msg.dds_.TransformStamped_"):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs.msg.dds_.TFMessage_"):
    transforms: types.sequence[TransformStamped]


@dataclass
class Imu(IdlStruct, typename="sensor_msgs.msg.dds_.Imu_"):
    header: Header
    orientation: Quaternion
    orientation_covariance: types.array[types.float64, 9]
    angular_velocity: Vector3
    angular_velocity_covariance: types.array[types.float64, 9]
    linear_acceleration: Vector3
    linear_acceleration_covariance: types.array[types.float64, 9]


@dataclass
class RegionOfInterest(IdlStruct, typename="sensor_msgs.msg.dds_.RegionOfInterest_"):
    x_offset: types.uint32
    y_offset: types.uint32
    height: types.uint32
    width: types.uint32
    do_rectify: bool


@dataclass
class CameraInfo(IdlStruct, typename="sensor_msgs.msg.dds_.CameraInfo_"):
    header: Header
    height: types.uint32
    width: types.uint32
    distortion_model: str
    d: types.sequence[types.float64]
    k: types.array[types.float64, 9]
    r: types.array[types.float64, 9]
    p: types.array[types.float64, 12]
    binning_x: types.uint32
    binning_y: types.uint32
    roi: RegionOfInterest


@dataclass
class CompressedImage(IdlStruct, typename="sensor_msgs.msg.dds_.CompressedImage_"):
    header: Header
    format: str
    data: types.sequence[types.uint8]


KINDS = {kind.__name__: kind for kind in (TFMessage, Imu, CameraInfo, CompressedImage)}
STRUCTS = {kind.__name__: kind for kind in (Time, Header, Vector3, Quaternion, Transform, RegionOfInterest)}


def as_idl(message: Any, kind: Any) -> Any:
    """A message as one of these types."""
    found = {}
    for field in fields(kind):
        value = getattr(message, field.name)
        if field.name == "transforms":
            found[field.name] = [as_idl(each, TransformStamped) for each in value]
        elif type(value).__name__.rpartition("__")[2] in STRUCTS:
            found[field.name] = as_idl(value, STRUCTS[type(value).__name__.rpartition("__")[2]])
        else:
            found[field.name] = value.tolist() if isinstance(value, np.ndarray) else value
    return kind(**found)


def messages_of(robot: Recording) -> Iterator[Message]:
    """Odometry goes out as TF alone."""
    types_ = Types()
    for time_ns, topic, kind, message in foreign_messages(robot, types_, compressed("jpeg", ".jpg"), "/head/image"):
        if topic == "/robot/odom":
            place, turn = message.pose.pose.position, message.pose.pose.orientation
            pose = Pose3.from_roll_pitch_yaw(0.0, 0.0, 2.0 * math.atan2(turn.z, turn.w), (place.x, place.y, 0.0))
            moved = types_.transforms(types_.transform(time_ns, "odom", "base_footprint", pose))
            yield time_ns, "/tf", "tf2_msgs/msg/TFMessage", moved
        else:
            yield time_ns, topic, kind, message


def publish(robot: Recording, without: str) -> None:
    """In real time, as soon as somebody reads its images."""
    messages = [one for one in messages_of(robot) if one[1] != without]
    participant, writers = DomainParticipant(int(os.environ["DOMAIN"])), {}
    for _, topic, kind, _ in messages:
        if topic not in writers:
            keeps = [Policy.Durability.TransientLocal] if topic == "/tf_static" else []
            described = Topic(participant, f"rt{topic}", KINDS[kind.rpartition("/")[2]])
            writers[topic] = DataWriter(participant, described, qos=Qos(RELIABLE, CDR, *keeps))
    read = [writer for topic, writer in writers.items() if topic in ("/head/image", "/tf", "/tf_static")]
    while not all(writer.get_matched_subscriptions() for writer in read):
        time.sleep(0.05)
    begun_s = time.monotonic() + 0.5
    for time_ns, topic, kind, message in messages:
        time.sleep(max(begun_s + 1e-9 * (time_ns - EPOCH_NS) - time.monotonic(), 0.0))
        writers[topic].write(as_idl(message, KINDS[kind.rpartition("/")[2]]))
    time.sleep(5.0)


if __name__ == "__main__":
    publish(open_source(Path(sys.argv[1])), "".join(sys.argv[2:]))
