"""A node for each board: ros2 launch tactiled_driver driver.launch.py boards:=TS0001,TS0002."""

import re

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode
from launch_ros.parameter_descriptions import ParameterValue

TEXTS = {
    "endpoint": ("tcp://127.0.0.1:9872", "where the daemon publishes events"),
    "qos": ("sensor_data", "of wrench, taxels, scan, force and grip: sensor_data or reliable"),
}
FLAGS = {
    "calibrated_only": ("true", "false: wrench and taxels have nominal forces, too"),
    "autostart": ("true", "false: a lifecycle manager configures and activates the nodes"),
}
PLACES = {
    "boards": (None, "serial numbers, with commas between them"),
    "namespace": ("tactile", "nodes and topics are in NAMESPACE/BOARD"),
}


def name_of_board(board: str) -> str:
    """Return the name of a board in topics and frames, by the rule of the node."""
    name = re.sub(r"[^A-Za-z0-9]+", "_", board).strip("_")
    return name if name[:1].isalpha() else f"board_{name}".rstrip("_")


def nodes_of_boards(context: LaunchContext) -> list[LifecycleNode]:
    """Return the nodes, each in a namespace with the name of its board."""
    boards, namespace = (LaunchConfiguration(name).perform(context) for name in PLACES)
    values = {name: ParameterValue(LaunchConfiguration(name), value_type=str) for name in TEXTS}
    flags = {name: ParameterValue(LaunchConfiguration(name), value_type=bool) for name in FLAGS}
    return [
        LifecycleNode(
            package="tactiled_driver",
            executable="driver",
            name="tactiled_driver",
            namespace=f"{namespace}/{name_of_board(board)}",
            parameters=[{"board": ParameterValue(board, value_type=str)} | values | flags],
            output="screen",
        )
        for board in map(str.strip, boards.split(","))
    ]


def generate_launch_description() -> LaunchDescription:
    """Start nodes with topics as /tactile/BOARD/wrench."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=meaning)
        for name, (default, meaning) in (PLACES | TEXTS | FLAGS).items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=nodes_of_boards)])
