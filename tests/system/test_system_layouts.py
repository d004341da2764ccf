"""Real processes: one daemon for boards of others, each with the layout and the array that ship for it."""

import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from patience import PATIENCE_S

from tactiled.client import Message, Subscription
from tactiled.wire.layout import load_layout

pytestmark = [pytest.mark.system, pytest.mark.alone]

# Scan rate of the emulated board, and channels, by layout; the array has the same name.
BOARDS = {
    "magnetometers-5": (100.0, 15),
    "tsf-85": (62.5, 56),
    "tsf-85-dynamic": (250.0, 2),  # the real one has 1 kHz, which would cost this test a core
    "xyz-counts-4x4": (60.0, 48),
    "pillars-3x3": (100.0, 27),
    "load-cell": (80.0, 1),
}
TOPICS = ("scan", "status", "contact")
SCENE = """
name = "touch"
[[phases]]
kind = "rest"
duration_s = 6.0
[[phases]]
kind = "press"
duration_s = 0.5
force_n = 5.0
[[phases]]
kind = "hold"
duration_s = 60.0
"""


def serial_of(layout: str) -> str:
    """Serial number that a layout assumes."""
    hello = load_layout(layout).file.assumed_hello
    assert hello is not None
    return hello.board_serial


def start(stack: ExitStack, *arguments: object) -> "subprocess.Popen[bytes]":
    """Run a command of tactiled until the stack is left."""
    command = [sys.executable, "-m", "tactiled", *map(str, arguments)]
    child = stack.enter_context(subprocess.Popen(command, stdout=subprocess.DEVNULL))
    stack.callback(child.terminate)
    return child


def newest(
    rates_hz: Mapping[str, float], endpoint: str, children: Mapping[str, "subprocess.Popen[bytes]"]
) -> dict[str, dict[str, dict[str, Any]]]:
    """First scan, newest contact and newest valid status of every board, by serial number and topic.

    A status with another rate than that of `rates_hz` does not count: a busy host hands over late.
    """
    found: dict[str, dict[str, dict[str, Any]]] = {board: {} for board in rates_hz}
    until_s = time.monotonic() + PATIENCE_S
    with Subscription(endpoint) as subscription:
        while any(len(messages) < len(TOPICS) for messages in found.values()):
            silent = {board: set(TOPICS) - set(messages) for board, messages in found.items()}
            assert time.monotonic() < until_s, f"missing after {PATIENCE_S} s: {silent}"
            assert [name for name, child in children.items() if child.poll() is not None] == []
            item = subscription.next_item(min(until_s, time.monotonic() + 1.0))
            if not isinstance(item, Message) or item.topic not in TOPICS:
                continue
            if item.topic == "scan":
                found[item.board].setdefault("scan", item.data)
            elif item.topic == "contact" or (
                item.data["valid"] and item.data["rate_hz"] == pytest.approx(rates_hz[item.board], rel=0.1)
            ):
                found[item.board][item.topic] = item.data
    return found


def test_boards_of_others_from_the_frames_to_the_client(tmp_path: Path) -> None:
    configs, scene, endpoint = tmp_path / "configs", tmp_path / "touch.toml", f"ipc://{tmp_path}/events.ipc"
    configs.mkdir()
    scene.write_text(SCENE)
    children: dict[str, subprocess.Popen[bytes]] = {}
    with ExitStack() as stack:
        for name, (rate_hz, _) in BOARDS.items():
            board = tmp_path / f"{name}.toml"
            board.write_text(f"rate_hz = {rate_hz}\n")
            serial = serial_of(name)
            (configs / f"{name}.toml").write_text(
                f'[port]\nurl = "{tmp_path / name}"\n[session]\nboard_serial = "{serial}"\n'
                f'[publish]\nendpoints = ["{endpoint}"]\n'
                f'[board]\nprotocol = "{name}"\narray = "{name}"\n'
            )
            children[f"board {serial}"] = start(
                stack, "emulate", "--layout", name, "--array", name, "--scene", scene, "--board", board,
                "--link", tmp_path / name,
            )  # fmt: skip
        children["daemon"] = start(stack, "run", "--config", configs)
        rates_hz = {serial_of(name): rate_hz for name, (rate_hz, _) in BOARDS.items()}
        found = newest(rates_hz, endpoint, children)
    for name, (_, n_channels) in BOARDS.items():
        serial = serial_of(name)
        messages = found[serial]
        status = messages["status"]
        assert (status["loss_known"], status["damage_known"]) == (False, False), serial
        assert len(messages["scan"]["volts"]) == n_channels, serial
        assert messages["contact"]["state"] != "none", serial
