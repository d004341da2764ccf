"""A daemon as a process for boards of others, each with the layout and the array that ship for it."""

import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from daemon_on_pty import BoardInThread
from patience import PATIENCE_S

from tactiled.client import Message, Subscription
from tactiled.emulator.board.identity import EmulatedBoardParams
from tactiled.emulator.scene.description import load_scene
from tactiled.wire.layout import Layout, load_layout

pytestmark = pytest.mark.system
# Scan rate of the emulated board, and channels, by layout; the array has the same name. Real ones are several
# times as fast, but of six with which a host cannot keep up the daemon measures other rates.
BOARDS = {
    "magnetometers-5": (25.0, 15),
    "tsf-85": (20.0, 56),
    "tsf-85-dynamic": (50.0, 2),
    "xyz-counts-4x4": (20.0, 48),
    "pillars-3x3": (25.0, 27),
    "load-cell": (20.0, 1),
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
duration_s = 600.0
"""


def serial_of(layout: Layout) -> str:
    """Serial number that a layout assumes."""
    hello = layout.file.assumed_hello
    assert hello is not None
    return hello.board_serial


def newest(
    rates_hz: Mapping[str, float], subscription: Subscription, daemon: "subprocess.Popen[bytes]"
) -> dict[str, dict[str, dict[str, Any]]]:
    """First scan, newest contact and newest valid status of every board, by serial number and topic.

    A status with another rate than that of `rates_hz` does not count: a busy host hands over late.
    """
    found: dict[str, dict[str, dict[str, Any]]] = {board: {} for board in rates_hz}
    until_s = time.monotonic() + PATIENCE_S * len(rates_hz)
    while any(len(messages) < len(TOPICS) for messages in found.values()):
        silent = {board: set(TOPICS) - set(messages) for board, messages in found.items()}
        assert time.monotonic() < until_s, f"missing: {silent}"
        assert daemon.poll() is None
        item = subscription.next_item(min(until_s, time.monotonic() + 1.0))
        if not isinstance(item, Message) or item.topic not in TOPICS or item.board not in found:
            continue
        if item.topic == "scan":
            found[item.board].setdefault("scan", item.data)
        elif item.topic == "contact" or (
            item.data["valid"] and item.data["rate_hz"] == pytest.approx(rates_hz[item.board], rel=0.1)
        ):
            found[item.board][item.topic] = item.data
    return found


def test_boards_of_others_from_the_frames_to_the_client(tmp_path: Path) -> None:
    configs, touch, endpoint = tmp_path / "configs", tmp_path / "touch.toml", f"ipc://{tmp_path}/events.ipc"
    configs.mkdir()
    touch.write_text(SCENE)
    scene, layouts = load_scene(str(touch)), {name: load_layout(name) for name in BOARDS}
    with ExitStack() as stack:
        for name, layout in layouts.items():
            (configs / f"{name}.toml").write_text(
                f'[port]\nurl = "{tmp_path / name}"\n[session]\nboard_serial = "{serial_of(layout)}"\n'
                f'[publish]\nendpoints = ["{endpoint}"]\n'
                f'[board]\nprotocol = "{name}"\narray = "{name}"\n'
            )
        subscription = stack.enter_context(Subscription(endpoint))
        command = [sys.executable, "-m", "tactiled", "run", "--config", str(configs)]
        daemon = stack.enter_context(subprocess.Popen(command, stdout=subprocess.DEVNULL))
        stack.callback(daemon.terminate)
        until_s = time.monotonic() + PATIENCE_S
        while not isinstance(item := subscription.next_item(until_s), Message):
            assert item is not None, "the daemon does not start"
        for name, layout in layouts.items():  # they wait for no command: the daemon must see their rest
            board = EmulatedBoardParams(rate_hz=BOARDS[name][0])
            stack.enter_context(BoardInThread(tmp_path / name, board, layout, scene))
        rates_hz = {serial_of(layout): BOARDS[name][0] for name, layout in layouts.items()}
        found = newest(rates_hz, subscription, daemon)
    for name, (_, n_channels) in BOARDS.items():
        serial = serial_of(layouts[name])
        messages = found[serial]
        status = messages["status"]
        assert (status["loss_known"], status["damage_known"]) == (False, False), serial
        assert len(messages["scan"]["volts"]) == n_channels, serial
        assert messages["contact"]["state"] != "none", serial
