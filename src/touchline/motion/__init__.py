"""Odometry, wheels, gyro, compass, attitude: the motion between two stamps with its noise, the orientation at one."""

from touchline.motion.clocks import FrameClock, FrameOrder
from touchline.motion.compass import CompassTrackSettings
from touchline.motion.dead_reckoning import DeadReckoning
from touchline.motion.gyro import GyroSettings
from touchline.motion.history import MotionHistory, Orientation
from touchline.motion.lean import LeanFilter
from touchline.motion.odometry import Motion, OdometrySettings
from touchline.motion.wheels import WheelSettings

__all__ = [
    "CompassTrackSettings",
    "DeadReckoning",
    "FrameClock",
    "FrameOrder",
    "GyroSettings",
    "LeanFilter",
    "Motion",
    "MotionHistory",
    "OdometrySettings",
    "Orientation",
    "WheelSettings",
]
