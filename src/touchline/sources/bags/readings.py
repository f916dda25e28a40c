"""What single messages of ROS say, in the units of a recording."""

from typing import Any

import numpy as np

from touchline.geometry import FloatArray, Pose3
from touchline.sources.bags.transforms import rotation
from touchline.sources.truth import heading_of

_UNKNOWN = -1.0  # first element of a covariance: the sensor does not measure this (sensor_msgs/Imu)
_NUMBERS = {7: "f4", 8: "f8"}  # datatypes of a PointCloud2
_MAX_POINTS = 2_000_000


def place_and_turn(message: Any) -> tuple[Any, Any]:
    """Position and orientation of an Odometry, a PoseStamped or a PoseWithCovarianceStamped."""
    pose = message.pose
    pose = pose if hasattr(pose, "position") else pose.pose
    return pose.position, pose.orientation


def planar_pose(message: Any) -> tuple[float, float, float]:
    """x, y, yaw (m, rad) of these, or of a booster_interface/Odometer."""
    if hasattr(message, "theta"):
        return message.x, message.y, message.theta
    place, turn = place_and_turn(message)
    return place.x, place.y, heading_of(turn.x, turn.y, turn.z, turn.w)


def attitude_of(imu: Any, base_from_sensor: Pose3) -> tuple[float, float, float] | None:
    """Roll, pitch, yaw of the base by a sensor_msgs/Imu or a booster_interface/LowState (rad); None where the sensor
    does not measure them.
    """
    if hasattr(imu, "imu_state"):
        roll, pitch, yaw = (float(angle) for angle in imu.imu_state.rpy)
        return roll, pitch, yaw
    turn = None if imu.orientation_covariance[0] == _UNKNOWN else rotation(imu.orientation)
    if turn is None:
        return None
    return Pose3(turn @ base_from_sensor.rotation.T, base_from_sensor.translation_m * 0.0).roll_pitch_yaw()


def rates_of(imu: Any, base_from_sensor: Pose3) -> tuple[float, float, float] | None:
    """Turning rates about the axes of the base (rad/s); None where the sensor does not measure them."""
    if hasattr(imu, "imu_state"):
        gx, gy, gz = (float(rate) for rate in imu.imu_state.gyro)
        return gx, gy, gz
    if imu.angular_velocity_covariance[0] == _UNKNOWN:
        return None
    rate = imu.angular_velocity
    x, y, z = (base_from_sensor.rotation @ (rate.x, rate.y, rate.z)).tolist()
    return x, y, z


def cloud_points(message: Any) -> FloatArray | str:
    """(N, 3) the finite points x, y, z of a sensor_msgs/PointCloud2, in its frame, or why there are none."""
    fields = {field.name: field for field in message.fields}
    missing = [name for name in "xyz" if name not in fields or fields[name].datatype not in _NUMBERS]
    if missing:
        return f"has no number {' and '.join(missing)} of its points"
    width, height, step = int(message.width), int(message.height), int(message.point_step)
    data = np.asarray(message.data, dtype=np.uint8)
    line = int(message.row_step) if height > 1 else width * step
    if width * height > _MAX_POINTS or line < width * step or len(data) < line * (height - 1) + width * step:
        return f"holds {len(data)} bytes, not those of {width}×{height} points"
    order = ">" if message.is_bigendian else "<"
    formats = [f"{order}{_NUMBERS[fields[name].datatype]}" for name in "xyz"]
    offsets = [int(fields[name].offset) for name in "xyz"]
    if not width * height:
        return np.zeros((0, 3))
    if any(offset + int(kind[-1]) > step for offset, kind in zip(offsets, formats, strict=True)):
        return "has fields beyond the end of a point"
    each = np.dtype({"names": list("xyz"), "formats": formats, "offsets": offsets, "itemsize": step})
    rows = [data[row * line : row * line + width * step].view(each) for row in range(height)]
    points = np.concatenate([np.column_stack([row[name] for name in "xyz"]) for row in rows]).astype(np.float64)
    return points[np.isfinite(points).all(axis=1)]
