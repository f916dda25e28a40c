"""What single messages of ROS say, in the units of a recording."""

from __future__ import annotations

from typing import Any

from touchline.geometry import Pose3
from touchline.sources.bags.transforms import rotation

_UNKNOWN = -1.0  # first element of a covariance: the sensor does not measure this (sensor_msgs/Imu)


def place_and_turn(message: Any) -> tuple[Any, Any]:
    """Position and orientation of an Odometry, a PoseStamped or a PoseWithCovarianceStamped."""
    pose = message.pose
    pose = pose if hasattr(pose, "position") else pose.pose
    return pose.position, pose.orientation


def attitude_of(imu: Any, base_from_sensor: Pose3) -> tuple[float, float, float] | None:
    """Roll, pitch, yaw of the base by a sensor_msgs/Imu (rad); None where the sensor does not measure them."""
    turn = None if imu.orientation_covariance[0] == _UNKNOWN else rotation(imu.orientation)
    if turn is None:
        return None
    return Pose3(turn @ base_from_sensor.rotation.T, base_from_sensor.translation_m * 0.0).roll_pitch_yaw()


def rates_of(imu: Any, base_from_sensor: Pose3) -> tuple[float, float, float] | None:
    """Turning rates about the axes of the base (rad/s); None where the sensor does not measure them."""
    if imu.angular_velocity_covariance[0] == _UNKNOWN:
        return None
    rate = imu.angular_velocity
    x, y, z = (base_from_sensor.rotation @ (rate.x, rate.y, rate.z)).tolist()
    return x, y, z
