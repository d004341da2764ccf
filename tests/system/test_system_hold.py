"""The example's controller in a process of its own: an object that is lifted, jerked and filled stays."""

import json
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.system
ROOT = Path(__file__).parents[2]
FILLED_S = 7.5  # of the scene `hold`
LEAST_N = 3.6 / (0.45 * 1.1)  # load over friction, once it is filled; the press of 6 N does not bear that


@contextmanager
def process(*arguments: str) -> Iterator["subprocess.Popen[str]"]:
    command = [sys.executable, *arguments]
    with subprocess.Popen(command, text=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as child:
        try:
            yield child
        finally:
            child.kill()


def ask(path: Path) -> dict[str, Any]:
    with socket.socket(socket.AF_UNIX) as control:
        control.settimeout(10.0)
        control.connect(str(path))
        control.sendall(b"{}\n")
        with control.makefile() as answers:
            answer: dict[str, Any] = json.loads(answers.readline())
            return answer


def test_the_example_holds_what_it_does_not_know(tmp_path: Path) -> None:
    endpoint = f"ipc://{tmp_path}/events.ipc"
    config = tmp_path / "hold.toml"
    config.write_text(
        f'port.url = "{tmp_path}/board"\ndetect.grip.enabled = true\npublish.endpoints = ["{endpoint}"]\n'
    )
    board = ("--scene", "hold", "--link", f"{tmp_path}/board", "--control", f"unix://{tmp_path}/control")
    with process("-m", "tactiled", "emulate", *board) as emulator, ExitStack() as others:
        assert emulator.stdout is not None
        assert json.loads(emulator.stdout.readline())["what"] == "ready"
        example = [str(ROOT / "examples" / "hold.py"), f"unix://{tmp_path}/control", endpoint]
        controller = others.enter_context(process(*example))
        others.enter_context(process("-m", "tactiled", "run", "--config", str(config)))
        while json.loads(emulator.stdout.readline())["what"] != "scene":
            pass
        time.sleep(FILLED_S)
        assert controller.poll() is None
        controller.kill()
        controller.wait()
        answer = ask(tmp_path / "control")
        assert not answer["fallen"]
        assert LEAST_N < answer["grip_n"] < 2.5 * LEAST_N
