"""Bridge to a running daemon, place of the array on the robot, and a controller."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, SetEnvironmentVariable
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    """Start `tactiled ros2`, a static transform and the controller in Python."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("events", default_value="tcp://127.0.0.1:9872"),
            DeclareLaunchArgument("parent", default_value="base_link"),
            DeclareLaunchArgument("frame", default_value="tactile_TS0001"),
            # As `tactiled ros2` without --network: loopback alone. Humble: ROS_LOCALHOST_ONLY=1.
            SetEnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"),
            ExecuteProcess(
                cmd=["tactiled", "ros2", "--events", LaunchConfiguration("events")], output="screen"
            ),
            Node(
                package="tf2_ros",
                executable="static_transform_publisher",
                arguments=[
                    "--frame-id",
                    LaunchConfiguration("parent"),
                    "--child-frame-id",
                    LaunchConfiguration("frame"),
                ],
            ),
            Node(package="tactiled_examples", executable="grip_controller.py", output="screen"),
        ]
    )
