"""Bridge to ROS 2."""

import json
import re
import shutil
from pathlib import Path

import click

from tactiled import resources
from tactiled.cli.options import KEYS, need_extra
from tactiled.errors import OperatorError

_GIDS_OF_24_BYTES = ("foxy", "galactic", "humble")


@click.command()
@click.option(
    "-e", "--events", "endpoints", multiple=True, metavar="ENDPOINT", default=("tcp://127.0.0.1:9872",),
    show_default=True, help="Endpoint of a daemon's events; several times for several daemons.",
)  # fmt: skip
@click.option(
    "--domain", default=0, show_default=True, envvar="ROS_DOMAIN_ID", type=click.IntRange(0, 232),
    help="DDS domain, as ROS_DOMAIN_ID.",
)  # fmt: skip
@click.option("--namespace", default="tactile", show_default=True, help="Namespace of topics.")
@click.option(
    "--frame", "frames", multiple=True, metavar="BOARD=FRAME",
    help="frame_id of a board. [default: tactile_BOARD]",
)  # fmt: skip
@click.option(
    "--distro", default="jazzy", show_default=True, envvar="ROS_DISTRO",
    help="Distribution of ROS 2 on the other side.",
)  # fmt: skip
@click.option(
    "--localhost/--network", default=True, show_default=True,
    help="Use the loopback interface alone, or let every host of the network read: DDS is not encrypted.",
)  # fmt: skip
@click.option(
    "--messages", type=click.Path(path_type=Path, file_okay=False), metavar="DIRECTORY",
    help="Only write the package tactiled_msgs for colcon into this folder.",
)  # fmt: skip
@KEYS
def ros2(
    endpoints: tuple[str, ...],
    domain: int,
    namespace: str,
    frames: tuple[str, ...],
    distro: str,
    localhost: bool,
    messages: Path | None,
    keys: Path | None,
) -> None:
    """Publish boards to ROS 2 over DDS, as a node; ROS need not be installed.

    Topics are /NAMESPACE/BOARD/wrench, taxels, scan, slip, contact, grip, force, texture and others, and
    /diagnostics. Nothing is published that is older than 0.5 s.

    Example: tactiled ros2 --events tcp://127.0.0.1:9872 --namespace tactile
    """
    if messages is not None:
        _write_package(messages)
        return
    need_extra("cyclonedds", "", "the bridge to ROS 2", "tactiled-ros2")
    from tactiled.ros2.bridge import BridgeParams, run_bridge
    from tactiled.ros2.names import is_namespace
    from tactiled.ros2.participant import Node

    namespace = namespace.strip("/")
    if not is_namespace(namespace):
        raise click.UsageError(f"--namespace {namespace}: use letters, digits and single underscores")
    pairs = dict(frame.partition("=")[::2] for frame in frames)
    if wrong := [frame for frame in frames if not re.fullmatch(r"[^=]+=[^=\s]+", frame)]:
        raise click.UsageError(f"--frame {wrong[0]}: give BOARD=FRAME")
    params = BridgeParams(endpoints, namespace, pairs, keys)

    def report(what: dict[str, object]) -> None:
        click.echo(json.dumps(what))
        if what["what"] == "board":
            click.echo(f"ros2: board {what['board']}: {len(list(what['topics']))} topics", err=True)  # type: ignore[call-overload]
        else:
            reach = "this host alone (--network opens it)" if localhost else "every host of the network"
            click.echo(f"ros2: node {what['name']} in domain {what['domain']}, for {reach}", err=True)

    gid_bytes = 24 if distro.lower() in _GIDS_OF_24_BYTES else 16

    def make_node() -> Node:
        return Node(domain, "tactiled", namespace, gid_bytes=gid_bytes, loopback=localhost)

    run_bridge(params, make_node, report)


def _write_package(folder: Path) -> None:
    """Copy the message package for colcon; files that are there are replaced."""
    name = "tactiled_msgs"
    try:
        shutil.copytree(resources.shipped("ros2", name), folder / name, dirs_exist_ok=True)
    except OSError as error:
        reason = error.strerror or error
        raise OperatorError(f"--messages {folder}: cannot be written: {reason}") from None
    click.echo(f"ros2: {folder / name}", err=True)
