"""Names of ROS 2, and of its types on DDS (``package::msg::dds_::Name_``)."""

import re

_TOKEN = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


def is_namespace(name: str) -> bool:
    """Return True for a relative namespace of ROS, such as ``tactile`` or ``robot1/left``."""
    return all(_TOKEN.fullmatch(part) and "__" not in part for part in name.split("/"))


def name_of_board(board: str) -> str:
    """Return the name of a board in topics and frames: letters and digits of ASCII, single underscores.

    >>> name_of_board("TS-0001"), name_of_board("0001"), name_of_board("")
    ('TS_0001', 'board_0001', 'board')
    """
    name = re.sub(r"[^A-Za-z0-9]+", "_", board).strip("_")
    return name if name[:1].isalpha() else f"board_{name}".rstrip("_")


def frame_id(board: str) -> str:
    """Return the name of the array frame of a board.

    >>> frame_id("TS0001")
    'tactile_TS0001'
    """
    return f"tactile_{name_of_board(board)}"


def dds_type(name: str) -> str:
    """Return the name of a type on DDS.

    >>> dds_type("geometry_msgs/msg/WrenchStamped")
    'geometry_msgs::msg::dds_::WrenchStamped_'
    """
    package, folder, bare = name.split("/")
    return f"{package}::{folder}::dds_::{bare}_"
