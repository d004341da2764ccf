"""Node of one board, active from the start: ros2 launch tactiled_driver driver.launch.py board:=TS0001."""

import re

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
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


def name_of_board(board: str) -> str:
    """Return the name of a board in topics and frames, by the rule of the node."""
    name = re.sub(r"[^A-Za-z0-9]+", "_", board).strip("_")
    return name if name[:1].isalpha() else f"board_{name}".rstrip("_")


def node_of_board(context: LaunchContext) -> list[LifecycleNode]:
    """Return the node, whose namespace has the name of the board where none is given."""
    namespace, board = (LaunchConfiguration(name).perform(context) for name in ("namespace", "board"))
    values = {name: ParameterValue(LaunchConfiguration(name), value_type=str) for name in TEXTS}
    flags = {name: ParameterValue(LaunchConfiguration(name), value_type=bool) for name in FLAGS}
    node = LifecycleNode(
        package="tactiled_driver",
        executable="driver",
        name="tactiled_driver",
        namespace=namespace or f"tactile/{name_of_board(board)}",
        parameters=[values | flags],
        output="screen",
    )
    return [node]


def generate_launch_description() -> LaunchDescription:
    """Start the node with topics as /tactile/BOARD/wrench."""
    namespace = {"namespace": ("", "of node and topics; empty for tactile/BOARD")}
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=meaning)
        for name, (default, meaning) in (TEXTS | FLAGS | namespace).items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=node_of_board)])
