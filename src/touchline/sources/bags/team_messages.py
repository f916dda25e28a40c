"""Definitions of robot teams' own messages, which ROS 2 does not bring: interface texts of public repositories.

vision_interface, booster_interface: of Booster Robotics' robots K1 and T1 (github.com/BoosterRobotics/robocup_demo and
booster_robotics_sdk_ros2, Apache-2.0). soccer_vision_*_msgs: github.com/ros-sports/soccer_interfaces (Apache-2.0).
vision_msgs: github.com/ros-perception/vision_msgs (Apache-2.0), of it what the others are made of.
"""

from __future__ import annotations

_CONFIDENCE = "soccer_vision_attribute_msgs/Confidence confidence\n"
_OBJECT = "string label\n{color}float64 confidence\nint64 xmin\nint64 ymin\nint64 xmax\nint64 ymax\n{pixel}"
_PLACES = "float32[] received_pos\nfloat32[] position\nfloat32[] position_projection\n"
_SEEN = "std_msgs/Header header\nvision_interface/DetectedObject[] detected_objects\n"

DEFINITIONS = {
    "vision_interface/msg/DetectedObject": _OBJECT.format(color="string color\n", pixel="float32[] target_uv\n")
    + _PLACES
    + "float32[] position_cam\nint32 position_confidence\n",
    "vision_interface/msg/Detections": _SEEN + "float32[] radar_x\nfloat32[] radar_y\nfloat32[] corner_pos\n",
    "vision_interface/msg/LineSegments": "std_msgs/Header header\nfloat32[] coordinates\nfloat32[] coordinates_uv\n",
    "booster_interface/msg/Odometer": "float32 x\nfloat32 y\nfloat32 theta\n",
    "booster_interface/msg/ImuState": "float32[3] rpy\nfloat32[3] gyro\nfloat32[3] acc\n",
    "booster_interface/msg/MotorState": "int8 mode\nfloat32 q\nfloat32 dq\nfloat32 ddq\nfloat32 tau_est\n"
    "int8 temperature\nuint32 lost\nuint32[2] reserve\n",
    "booster_interface/msg/LowState": "booster_interface/ImuState imu_state\n"
    "booster_interface/MotorState[] motor_state_parallel\nbooster_interface/MotorState[] motor_state_serial\n",
    "soccer_vision_attribute_msgs/msg/Confidence": "float32 CONFIDENCE_UNKNOWN=-1\nfloat32 confidence -1\n",
    "soccer_vision_attribute_msgs/msg/Goalpost": "uint8 side\nuint8 team\n",
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    "vision_msgs/msg/Point2D": "float64 x\nfloat64 y\n",
    "vision_msgs/msg/Pose2D": "vision_msgs/Point2D position\nfloat64 theta\n",
    "vision_msgs/msg/BoundingBox2D": "vision_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y\n",
    "soccer_vision_3d_msgs/msg/MarkingEllipse": "float64 diameter\ngeometry_msgs/Pose center\n" + _CONFIDENCE,
    "soccer_vision_3d_msgs/msg/MarkingIntersection": "geometry_msgs/Pose center\nint32 num_rays\n"
    "geometry_msgs/Vector3[] rays\n" + _CONFIDENCE,
    "soccer_vision_3d_msgs/msg/MarkingSegment": "geometry_msgs/Point start\ngeometry_msgs/Point end\n" + _CONFIDENCE,
    "soccer_vision_3d_msgs/msg/MarkingArray": "std_msgs/Header header\n"
    "soccer_vision_3d_msgs/MarkingEllipse[] ellipses\nsoccer_vision_3d_msgs/MarkingIntersection[] intersections\n"
    "soccer_vision_3d_msgs/MarkingSegment[] segments\n",
    "soccer_vision_3d_msgs/msg/Goalpost": "vision_msgs/BoundingBox3D bb\n"
    "soccer_vision_attribute_msgs/Goalpost attributes\n" + _CONFIDENCE,
    "soccer_vision_3d_msgs/msg/GoalpostArray": "std_msgs/Header header\nsoccer_vision_3d_msgs/Goalpost[] posts\n",
    "soccer_vision_2d_msgs/msg/MarkingEllipse": "vision_msgs/BoundingBox2D bb\nvision_msgs/Point2D center\n"
    + _CONFIDENCE,
    "soccer_vision_2d_msgs/msg/MarkingIntersection": "vision_msgs/Point2D center\nint32 num_rays\n"
    "float64[] heading_rays\n" + _CONFIDENCE,
    "soccer_vision_2d_msgs/msg/MarkingSegment": "vision_msgs/Point2D start\nvision_msgs/Point2D end\n" + _CONFIDENCE,
    "soccer_vision_2d_msgs/msg/MarkingArray": "std_msgs/Header header\n"
    "soccer_vision_2d_msgs/MarkingEllipse[] ellipses\nsoccer_vision_2d_msgs/MarkingIntersection[] intersections\n"
    "soccer_vision_2d_msgs/MarkingSegment[] segments\n",
    "soccer_vision_2d_msgs/msg/Goalpost": "vision_msgs/BoundingBox2D bb\n"
    "soccer_vision_attribute_msgs/Goalpost attributes\n" + _CONFIDENCE,
    "soccer_vision_2d_msgs/msg/GoalpostArray": "std_msgs/Header header\nsoccer_vision_2d_msgs/Goalpost[] posts\n",
}
"""By type of ROS 2, all with their packages."""
EARLIER = {
    "vision_interface/msg/DetectedObject": _OBJECT.format(color="", pixel="") + _PLACES,
    "vision_interface/msg/Detections": _SEEN,
    **{
        name: text.replace("vision_msgs/Point2D", "geometry_msgs/Point")
        for name, text in DEFINITIONS.items()
        if name.startswith("soccer_vision_2d_msgs/msg/Marking")
    },
}
"""The same types as the first robots, and as vision_msgs before ROS 2 Humble, had them: tried where a message isn't of
the present definition.
"""
