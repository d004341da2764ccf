"""Node of one board, active from the start: ros2 launch tactiled_driver driver.launch.py board:=TS0001."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode
from launch_ros.parameter_descriptions import ParameterValue

TEXTS = {
    "board": (None, "serial number of the board"),
    "endpoint": ("tcp://127.0.0.1:9872", "where the daemon publishes events"),
    "frame_id": ("", "frame of the array; empty for tactile_BOARD"),
    "qos": ("sensor_data", "of wrench, scan, force and grip: sensor_data or reliable"),
}
FLAGS = {
    "calibrated_only": ("true", "false: wrench has nominal forces, too"),
    "autostart": ("true", "false: a lifecycle manager configures and activates the node"),
}


def generate_launch_description() -> LaunchDescription:
    """Start the node with topics as /tactile/BOARD/wrench; a board that is no ROS name needs `namespace`."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=meaning)
        for name, (default, meaning) in (TEXTS | FLAGS).items()
    ]
    namespace = DeclareLaunchArgument(
        "namespace",
        default_value=["tactile/", LaunchConfiguration("board")],
        description="namespace of node and topics",
    )
    values = {name: ParameterValue(LaunchConfiguration(name), value_type=str) for name in TEXTS}
    flags = {name: ParameterValue(LaunchConfiguration(name), value_type=bool) for name in FLAGS}
    node = LifecycleNode(
        package="tactiled_driver",
        executable="driver",
        name="tactiled_driver",
        namespace=LaunchConfiguration("namespace"),
        parameters=[values | flags],
        output="screen",
    )
    return LaunchDescription([*arguments, namespace, node])
