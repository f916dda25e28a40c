"""Wheels, gyro and compass: the motion between two stamps with its noise, and the heading at one."""

from touchline.motion.compass import CompassTrack, CompassTrackSettings
from touchline.motion.odometry import Motion, OdometrySettings, OdometryTrack
from touchline.motion.wheels import WheelOdometry, WheelOdometrySettings

__all__ = [
    "CompassTrack",
    "CompassTrackSettings",
    "Motion",
    "OdometrySettings",
    "OdometryTrack",
    "WheelOdometry",
    "WheelOdometrySettings",
]
