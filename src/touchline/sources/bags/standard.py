"""What Touchline knows, as the messages that other programs of ROS understand (REP 103, REP 105)."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from touchline.camera import PerspectiveCamera
from touchline.geometry import FloatArray, Pose, Pose3
from touchline.sources.bags.transforms import BODY_FROM_OPTICAL
from touchline.sources.bags.with_rosbags import Codec
from touchline.types import Estimate, Status

MAP, ODOM, BASE, OPTICAL = "map", "odom", "base_footprint", "camera_optical_frame"
BODY = "base_link"  # leans as the robot does
_UNKNOWN = np.eye(1, 9).ravel() * -1.0  # the covariance of what a sensor does not measure (sensor_msgs/Imu)
Fields = dict[str, Any]
_VALUES = (
    *("residual_m", "points", "probability", "twin_probability", "end_probability", "protection_m", "protection_rad"),
    *("mode", "perception_ms", "localization_ms"),
)


_LEVELS = {Status.TRACKING: 0, Status.SEARCHING: 1, Status.LOST: 2}  # fine, warning, error


class Frames(NamedTuple):
    """Names of the field's frame, of the odometry's and of the robot's on the ground."""

    map: str = MAP
    odom: str = ODOM
    base: str = BASE


class StandardMessages:
    """Makes messages; stamps are in nanoseconds of the bag's clock."""

    def __init__(self, codec: Codec) -> None:
        self._make = codec.make
        self.frames = Frames()

    def header(self, stamp_ns: int, frame: str) -> Any:
        """std_msgs/Header; seconds beyond 32 bits stay at the last ones."""
        seconds, rest = divmod(stamp_ns, 1_000_000_000)
        stamp = {"sec": min(max(seconds, -(2**31)), 2**31 - 1), "nanosec": rest}
        return self._make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def odometry(self, stamp_ns: int, x: float, y: float, theta: float) -> Any:
        """nav_msgs/Odometry, without covariances and velocities, which nobody knows."""
        header, pose = self.header(stamp_ns, self.frames.odom), {"pose": planar(x, y, theta)}
        return self._make("nav_msgs/msg/Odometry", header=header, child_frame_id=self.frames.base, pose=pose)

    def imu(self, stamp_ns: int, attitude: Sequence[float], rates: Sequence[float]) -> Any:
        """sensor_msgs/Imu of roll, pitch, yaw (rad; NaN: 0, and unknown if all are) and rates (rad/s; NaN: unknown)."""
        known, turning = np.isfinite(attitude), np.isfinite(rates).all()
        roll, pitch, yaw = np.where(known, attitude, 0.0).tolist()
        return self._make(
            "sensor_msgs/msg/Imu",
            header=self.header(stamp_ns, self.frames.base),
            orientation=_quaternion(Pose3.from_roll_pitch_yaw(roll, pitch, yaw).rotation),
            orientation_covariance=None if known.any() else _UNKNOWN,
            angular_velocity=xyz(*rates) if turning else None,
            angular_velocity_covariance=None if turning else _UNKNOWN,
            linear_acceleration_covariance=_UNKNOWN,
        )

    def pose(self, stamp_ns: int, x: float, y: float, heading: float, covariance: FloatArray | None = None) -> Any:
        """geometry_msgs/PoseStamped in the field's frame; with a covariance (36,), PoseWithCovarianceStamped."""
        header, pose = self.header(stamp_ns, self.frames.map), planar(x, y, heading)
        if covariance is None:
            return self._make("geometry_msgs/msg/PoseStamped", header=header, pose=pose)
        uncertain = {"pose": pose, "covariance": covariance}
        return self._make("geometry_msgs/msg/PoseWithCovarianceStamped", header=header, pose=uncertain)

    def transform(self, stamp_ns: int, parent: str, child: str, parent_from_child: Pose3) -> Any:
        """tf2_msgs/TFMessage of one frame."""
        place, turn = xyz(*parent_from_child.translation_m), _quaternion(parent_from_child.rotation)
        transform = {"translation": place, "rotation": turn}
        each = {"header": self.header(stamp_ns, parent), "child_frame_id": child, "transform": transform}
        return self._make("tf2_msgs/msg/TFMessage", transforms=[each])

    def compressed(self, stamp_ns: int, data: bytes) -> Any:
        """sensor_msgs/CompressedImage of the content of a JPEG or PNG file."""
        kind = "png" if data.startswith(b"\x89PNG") else "jpeg"
        pixels = np.frombuffer(data, dtype=np.uint8)
        return self._make(
            "sensor_msgs/msg/CompressedImage", header=self.header(stamp_ns, OPTICAL), format=kind, data=pixels
        )

    def camera_at(self, stamp_ns: int, base_from_camera: Pose3, base: str = BASE) -> Any:
        """tf2_msgs/TFMessage of a camera, whose frame looks along z in ROS."""
        return self.transform(stamp_ns, base, OPTICAL, base_from_camera.compose(BODY_FROM_OPTICAL))

    def camera_info(self, stamp_ns: int, camera: PerspectiveCamera) -> Any:
        """sensor_msgs/CameraInfo of a camera."""
        matrix = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
        return self._make(
            "sensor_msgs/msg/CameraInfo",
            header=self.header(stamp_ns, OPTICAL),
            height=camera.height,
            width=camera.width,
            distortion_model=camera.ros_model,
            d=camera.distortion.tolist(),
            k=matrix.ravel(),
            r=np.eye(3).ravel(),
            p=np.column_stack((matrix, np.zeros(3))).ravel(),
        )

    def estimated(self, stamp_ns: int, estimate: Estimate) -> Any:
        """geometry_msgs/PoseWithCovarianceStamped of an estimate."""
        return self.pose(stamp_ns, *estimate.pose, covariance=estimate.ros_covariance())

    def map_from(self, stamp_ns: int, estimate: Estimate, map_from_odom: Pose | None) -> Any:
        """tf2_msgs/TFMessage of an estimate: map → odom, or map → base where that is not known (REP 105)."""
        child = self.frames.base if map_from_odom is None else self.frames.odom
        return self.transform(stamp_ns, self.frames.map, child, on_ground(map_from_odom or estimate.pose))

    def diagnostics(self, stamp_ns: int, estimate: Estimate, more: Mapping[str, object] | None = None) -> Any:
        """diagnostic_msgs/DiagnosticArray of one status, why it is so, and what is wrong. more: values to add.

        Among the values each problem's sentence stands by its code.
        """
        known = ((name, getattr(estimate, name)) for name in _VALUES)
        values = {name: value for name, value in known if value is not None and value == value} | dict(more or {})
        values |= {name: f"{value:.4g}" for name, value in estimate.statistics.items()}
        values |= {problem.code: problem.sentence for problem in estimate.problems}
        because = ": ".join(filter(None, (estimate.status.value, estimate.reason)))
        status = {
            "level": _LEVELS[estimate.status],
            "name": "touchline: localization",
            "message": "; ".join((because, *map(str, estimate.problems))),
            "values": [
                {"key": key, "value": str(value)}
                for key, value in values.items()
                if value is not None and value == value
            ],
        }
        return self._make("diagnostic_msgs/msg/DiagnosticArray", header=self.header(stamp_ns, ""), status=[status])


def on_ground(pose: Pose) -> Pose3:
    """A pose on the ground as one in space."""
    return Pose3.from_roll_pitch_yaw(0.0, 0.0, pose.heading, (pose.x, pose.y, 0.0))


def planar(x: float, y: float, heading: float) -> Fields:
    """geometry_msgs/Pose on the ground."""
    turn = {"z": math.sin(0.5 * heading), "w": math.cos(0.5 * heading)}
    return {"position": xyz(x, y, 0.0), "orientation": turn}


def xyz(x: float, y: float, z: float) -> Fields:
    """geometry_msgs/Point or Vector3."""
    return {"x": float(x), "y": float(y), "z": float(z)}


def _quaternion(rotation: FloatArray) -> Fields:
    return dict(zip("xyzw", quaternion_of(rotation), strict=True))


def quaternion_of(rotation: FloatArray) -> tuple[float, float, float, float]:
    """x, y, z, w of a rotation matrix (3, 3)."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(rotation).as_quat().tolist()
    return x, y, z, w
