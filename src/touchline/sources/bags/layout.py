"""Where the files of a recording go in a bag: what has no ROS message, and what has to come back to the last digit.

Tables travel line by line, at their own times, so that a bag that was cut off holds all of them up to the cut.
"""

STRING = "std_msgs/msg/String"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
IMAGES = "/camera/image/compressed"
IMAGE_ROWS = "/touchline/images"
SEQUENCE_TOPIC = "/touchline/sequence"
WHOLE = {
    "sequence.yaml": SEQUENCE_TOPIC,
    "field.yaml": "/touchline/field",
    "camera.yaml": "/touchline/camera",
    "marks.csv": "/touchline/marks",
    "regions.yaml": "/touchline/regions",
}
"""Files that are one latched message."""
TABLES = {
    "odometry.csv": "/touchline/odometry",
    "wheels.csv": "/touchline/wheels",
    "imu.csv": "/touchline/imu",
    "camera_pose.csv": "/touchline/camera_pose",
    "game_states.csv": "/touchline/game_states",
    "observations.csv": "/touchline/observations",
    "ground_truth.tum": "/touchline/ground_truth",
    "images.csv": IMAGE_ROWS,
}
"""Files of which each line is a message, its header the first one."""
LATCHED_RESULTS = ("/touchline/pose", "/touchline/field_lines", "/touchline/map")
LATCHED_TOPICS = frozenset((*WHOLE.values(), *LATCHED_RESULTS, "/tf_static", "/camera/camera_info"))
LATCHED = (
    "- history: 1\n  depth: 1\n  reliability: 1\n  durability: 1\n"
    "  deadline: {sec: 0, nsec: 0}\n  lifespan: {sec: 0, nsec: 0}\n  liveliness: 0\n"
    "  liveliness_lease_duration: {sec: 0, nsec: 0}\n  avoid_ros_namespace_conventions: false\n"
)
"""The quality of service of latched topics, as a bag names it."""
EPOCH_KEY = "clock_starts_at_ns"
"""In sequence.yaml: what the bag's clock showed at t = 0."""
