"""Node of board TS0001, place of its array on the robot, and a controller."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Start the node, a static transform and the controller in Python."""
    share = FindPackageShare("tactiled_driver")
    return LaunchDescription(
        [
            DeclareLaunchArgument("endpoint", default_value="tcp://127.0.0.1:9872"),
            DeclareLaunchArgument("parent", default_value="base_link"),
            IncludeLaunchDescription(
                PathJoinSubstitution([share, "launch", "driver.launch.py"]),
                launch_arguments={
                    "boards": "TS0001",
                    "endpoint": LaunchConfiguration("endpoint"),
                }.items(),
            ),
            Node(
                package="tf2_ros",
                executable="static_transform_publisher",
                arguments=["--frame-id", LaunchConfiguration("parent"), "--child-frame-id", "tactile_TS0001"],
            ),
            Node(package="tactiled_examples", executable="grip_controller.py", output="screen"),
        ]
    )
