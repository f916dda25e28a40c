"""Names and types of the topics that ROS's links read and publish."""

import numpy as np

from touchline.sources.bags import roles

TRANSFORMS, FIRST_POSE, SAID, CLOCK = "tf", "initialpose", "said", "clock"  # roles beside those of bags
EVIDENCE_TOPIC, WHEELS_TOPIC, SEEN_TOPIC = "/touchline/evidence", "/touchline/wheels", "/touchline/seen"
GAME_TOPIC = "/touchline/game_state"
FIXED_TOPICS = {
    "/tf": TRANSFORMS,
    "/tf_static": TRANSFORMS,
    "/initialpose": FIRST_POSE,
    "/clock": CLOCK,
    EVIDENCE_TOPIC: SAID,
    GAME_TOPIC: SAID,
    WHEELS_TOPIC: SAID,
    SEEN_TOPIC: SAID,
}
FIXED_TYPES = {
    TRANSFORMS: "tf2_msgs/msg/TFMessage",
    FIRST_POSE: "geometry_msgs/msg/PoseWithCovarianceStamped",
    CLOCK: "rosgraph_msgs/msg/Clock",
    SAID: "std_msgs/msg/String",
}
IMAGE_TOPIC, INFO_TOPIC, ODOMETRY_TOPIC, IMU_TOPIC = "/image/compressed", "/camera_info", "/odom", "/imu/data"
PLAYED = {
    IMAGE_TOPIC: roles.COMPRESSED_IMAGE,
    INFO_TOPIC: "sensor_msgs/msg/CameraInfo",
    ODOMETRY_TOPIC: "nav_msgs/msg/Odometry",
    IMU_TOPIC: "sensor_msgs/msg/Imu",
    "/tf": FIXED_TYPES[TRANSFORMS],
    WHEELS_TOPIC: FIXED_TYPES[SAID],
    SEEN_TOPIC: FIXED_TYPES[SAID],
}
BOOSTER_POSE, BOOSTER_POSE_TYPE = "/booster_soccer/robot_pose", "geometry_msgs/msg/Pose2D"
PLANE = np.ix_((0, 1, 5), (0, 1, 5))  # x, y and yaw of a covariance (6, 6)
