"""What single messages of ROS say, in the units of a recording."""

from __future__ import annotations

from typing import Any

import numpy as np

from touchline.geometry import Pose3
from touchline.sources.bags.transforms import rotation
from touchline.sources.truth import heading_of

_UNKNOWN = -1.0  # first element of a covariance: the sensor does not measure this (sensor_msgs/Imu)


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


def head_of(pose: Any) -> Pose3 | None:
    """`base_from_head` by a geometry_msgs/Pose; None where it is none."""
    place, turn = np.array([pose.position.x, pose.position.y, pose.position.z]), rotation(pose.orientation)
    return None if turn is None or not np.isfinite(place).all() else Pose3(turn, place)


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
