"""The parameters of the node: names, defaults, ranges and what they do. Needs neither ROS nor Touchline."""

from __future__ import annotations

from typing import NamedTuple


class Parameter(NamedTuple):
    """range: the least and the most of a number. live: whether a change counts while the node is active."""

    name: str
    default: object
    description: str
    range: tuple[float, float] | None = None
    live: bool = False


PARAMETERS = (
    Parameter("field", "", "The field: the name of a preset (`touchline fields`) or the path of a field.yaml."),
    Parameter("camera", "", "The path of a camera.yaml; empty: CameraInfo and transforms, or points of a detector."),
    Parameter("system", "touchline", "The system that localises (`touchline systems`)."),
    Parameter("config", "", "The path of a file with settings of the system; empty: none."),
    Parameter("settings", [""], "Settings of the system as KEY=VALUE, which come before those of the file."),
    Parameter("topics", [""], "ROLE=/NAME of topics that are not found by their types, as compass=/imu/data."),
    Parameter("own_half", False, "Whether the robot starts in its own half, x < 0."),
    Parameter("start_pose", [0.0, 0.0, 0.0], "x, y (m), theta (rad): where ~/start_pose puts the robot.", live=True),
    Parameter("wheels", [0.0, 0.0], "Rolling directions of two measuring wheels (rad); two equal numbers: none."),
    Parameter("map_frame", "map", "The frame of the field: origin at the centre mark, x to the opponent goal."),
    Parameter("odom_frame", "odom", "The frame of the odometry, to which the transform leads."),
    Parameter("base_frame", "", "The robot's frame on the ground, x forward, y left; empty: by its usual names."),
    Parameter("publish_tf", True, "Whether map -> odom is published (without odometry map -> base)."),
    Parameter("tf_while_searching", False, "Whether the transform is published while the pose is not tracked, too."),
    Parameter("late_ms", 0.0, "By which messages without a stamp are received later than measured.", (0.0, 10_000.0)),
    Parameter("team_evidence", False, "Whether what others say of where the robot is counts; anybody may say it."),
    Parameter("seed", 0, "Of the system's random numbers.", (0, 2**31 - 1)),
    Parameter("autostart", True, "Whether the node configures and activates itself; false: a lifecycle manager does."),
)
