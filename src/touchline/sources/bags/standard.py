"""What Touchline knows, as the messages that other programs of ROS understand (REP 103, REP 105)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from touchline.geometry import FloatArray, Pose3
from touchline.sources.bags.with_rosbags import Codec

MAP, ODOM, BASE, OPTICAL = "map", "odom", "base_footprint", "camera_optical_frame"
_UNKNOWN = -1.0
# `body_from_optical`: z ahead, x right, y down of the optical frame in x ahead, y left, z up of the camera's body.
BODY_FROM_OPTICAL = Pose3(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.zeros(3))


class StandardMessages:
    """Makes messages; stamps are in nanoseconds of the bag's clock."""

    def __init__(self, codec: Codec) -> None:
        self._make = codec.make

    def header(self, stamp_ns: int, frame: str) -> Any:
        """std_msgs/Header; seconds beyond 32 bits stay at the last ones."""
        seconds, rest = divmod(stamp_ns, 1_000_000_000)
        stamp = self._make("builtin_interfaces/msg/Time", sec=min(max(seconds, -(2**31)), 2**31 - 1), nanosec=rest)
        return self._make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def odometry(self, stamp_ns: int, x: float, y: float, theta: float) -> Any:
        """nav_msgs/Odometry, without covariances and velocities, which nobody knows."""
        zero = self._make("geometry_msgs/msg/Twist", linear=self._vector(0, 0, 0), angular=self._vector(0, 0, 0))
        return self._make(
            "nav_msgs/msg/Odometry",
            header=self.header(stamp_ns, ODOM),
            child_frame_id=BASE,
            pose=self._pose_with_covariance(x, y, theta, np.zeros(36)),
            twist=self._make("geometry_msgs/msg/TwistWithCovariance", twist=zero, covariance=np.zeros(36)),
        )

    def imu(self, stamp_ns: int, attitude: Sequence[float], rates: Sequence[float]) -> Any:
        """sensor_msgs/Imu of roll, pitch, yaw (rad; NaN: 0, and unknown if all are) and rates (rad/s; NaN: unknown)."""
        known, turning = np.isfinite(attitude), np.isfinite(rates).all()
        roll, pitch, yaw = np.where(known, attitude, 0.0).tolist()
        first = np.eye(1, 9).ravel() * _UNKNOWN
        return self._make(
            "sensor_msgs/msg/Imu",
            header=self.header(stamp_ns, BASE),
            orientation=self._quaternion(Pose3.from_roll_pitch_yaw(roll, pitch, yaw).rotation),
            orientation_covariance=np.zeros(9) if known.any() else first,
            angular_velocity=self._vector(*(rates if turning else (0, 0, 0))),
            angular_velocity_covariance=np.zeros(9) if turning else first,
            linear_acceleration=self._vector(0, 0, 0),
            linear_acceleration_covariance=first,
        )

    def pose(self, stamp_ns: int, x: float, y: float, heading: float, covariance: FloatArray | None = None) -> Any:
        """geometry_msgs/PoseStamped in the field's frame; with a covariance (36,), PoseWithCovarianceStamped."""
        header = self.header(stamp_ns, MAP)
        if covariance is None:
            return self._make("geometry_msgs/msg/PoseStamped", header=header, pose=self._planar(x, y, heading))
        pose = self._pose_with_covariance(x, y, heading, covariance)
        return self._make("geometry_msgs/msg/PoseWithCovarianceStamped", header=header, pose=pose)

    def transform(self, stamp_ns: int, parent: str, child: str, parent_from_child: Pose3) -> Any:
        """tf2_msgs/TFMessage of one frame."""
        placed = self._make(
            "geometry_msgs/msg/Transform",
            translation=self._vector(*parent_from_child.translation_m.tolist()),
            rotation=self._quaternion(parent_from_child.rotation),
        )
        each = self._make(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(stamp_ns, parent),
            child_frame_id=child,
            transform=placed,
        )
        return self._make("tf2_msgs/msg/TFMessage", transforms=[each])

    def camera_info(self, stamp_ns: int, camera: Mapping[str, Any]) -> Any:
        """sensor_msgs/CameraInfo of the keys of a perspective camera.yaml."""
        fx, fy, cx, cy = (float(camera[key]) for key in ("fx", "fy", "cx", "cy"))
        matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        fisheye = camera.get("model") == "fisheye"
        region = dict.fromkeys(("x_offset", "y_offset", "height", "width"), 0)
        return self._make(
            "sensor_msgs/msg/CameraInfo",
            header=self.header(stamp_ns, OPTICAL),
            height=int(camera["height"]),
            width=int(camera["width"]),
            distortion_model="equidistant" if fisheye else "plumb_bob",
            d=np.array(camera.get("distortion", [0.0] * (4 if fisheye else 5)), dtype=np.float64),
            k=matrix.ravel(),
            r=np.eye(3).ravel(),
            p=np.column_stack((matrix, np.zeros(3))).ravel(),
            binning_x=0,
            binning_y=0,
            roi=self._make("sensor_msgs/msg/RegionOfInterest", do_rectify=False, **region),
        )

    def diagnostics(self, stamp_ns: int, level: int, message: str, values: Mapping[str, str]) -> Any:
        """diagnostic_msgs/DiagnosticArray of one status. level: 0 fine, 1 warning, 2 error."""
        pairs = [self._make("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in values.items()]
        status = self._make(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=level,
            name="touchline: localization",
            message=message,
            hardware_id="",
            values=pairs,
        )
        return self._make("diagnostic_msgs/msg/DiagnosticArray", header=self.header(stamp_ns, ""), status=[status])

    def _pose_with_covariance(self, x: float, y: float, heading: float, covariance: FloatArray) -> Any:
        kind = "geometry_msgs/msg/PoseWithCovariance"
        return self._make(kind, pose=self._planar(x, y, heading), covariance=covariance)

    def _planar(self, x: float, y: float, heading: float) -> Any:
        place = self._make("geometry_msgs/msg/Point", x=float(x), y=float(y), z=0.0)
        half = 0.5 * heading
        turn = self._make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(half), w=math.cos(half))
        return self._make("geometry_msgs/msg/Pose", position=place, orientation=turn)

    def _vector(self, x: float, y: float, z: float) -> Any:
        return self._make("geometry_msgs/msg/Vector3", x=float(x), y=float(y), z=float(z))

    def _quaternion(self, rotation: FloatArray) -> Any:
        x, y, z, w = quaternion_of(rotation)
        return self._make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def quaternion_of(rotation: FloatArray) -> tuple[float, float, float, float]:
    """x, y, z, w of a rotation matrix (3, 3), from its largest part (Shepperd 1978)."""
    r = rotation
    squares = np.array([1 + r[0, 0] - r[1, 1] - r[2, 2], 1 - r[0, 0] + r[1, 1] - r[2, 2]])
    squares = np.append(squares, [1 - r[0, 0] - r[1, 1] + r[2, 2], 1 + r[0, 0] + r[1, 1] + r[2, 2]])
    rows = np.array(
        [
            [squares[0], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[2, 1] - r[1, 2]],
            [r[0, 1] + r[1, 0], squares[1], r[1, 2] + r[2, 1], r[0, 2] - r[2, 0]],
            [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], squares[2], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], squares[3]],
        ]
    )
    largest = rows[int(np.argmax(squares))]
    x, y, z, w = (largest / np.linalg.norm(largest)).tolist()
    return x, y, z, w
