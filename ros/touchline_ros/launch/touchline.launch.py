"""ros2 launch touchline_ros touchline.launch.py field:=hsl-s-9x6 [pose:=/amcl_pose]"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

ARGUMENTS = {
    "field": ("", "The name of a preset, or the path of a field.yaml"),
    "camera": ("", "The path of a camera.yaml; empty: CameraInfo and transforms"),
    "own_half": ("false", "Whether the robot starts in its own half"),
    "autostart": ("true", "false: nav2's lifecycle manager starts the node"),
    "namespace": ("", "Of this robot"),
    "pose": ("/touchline/pose", "Where the pose goes; nav2 listens to /amcl_pose"),
}


def generate_launch_description():
    given = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    node = Node(
        package="touchline_ros",
        executable="localization",
        name="touchline",
        namespace=given["namespace"],
        output="screen",
        parameters=[{name: given[name] for name in ("field", "camera", "own_half", "autostart")}],
        remappings=[("/touchline/pose", given["pose"])],
    )
    described = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*described, node])
