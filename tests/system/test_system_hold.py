"""The example's controller in a process of its own: an object that is lifted, jerked and filled stays."""

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

pytestmark = [pytest.mark.system, pytest.mark.alone]
ROOT = Path(__file__).parents[2]
FILLED_S = 7.5  # of the scene `hold`
TOO_LATE_S = 0.5  # of a scan: longer than a hiccup of a busy host
LEAST_N = 3.6 / (0.45 * 1.1)  # load over friction, once it is filled; the press of 6 N does not bear that


@contextmanager
def process(*arguments: str) -> Iterator["subprocess.Popen[str]"]:
    command = [sys.executable, *arguments]
    with subprocess.Popen(command, text=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as child:
        try:
            yield child
        finally:
            child.kill()


def test_the_example_holds_what_it_does_not_know(tmp_path: Path) -> None:
    endpoint = f"ipc://{tmp_path}/events.ipc"
    config = tmp_path / "hold.toml"
    config.write_text(f'port.url = "{tmp_path}/board"\npublish.endpoints = ["{endpoint}"]\n')
    control = f"unix://{tmp_path}/control"
    board = ("--scene", "hold", "--link", f"{tmp_path}/board", "--control", control, "--scans")
    with process("-m", "tactiled", "emulate", *board) as emulator, ExitStack() as others:
        assert emulator.stdout is not None
        assert json.loads(emulator.stdout.readline())["what"] == "ready"
        example = [str(ROOT / "examples" / "hold.py"), control, endpoint]
        controller = others.enter_context(process(*example))
        others.enter_context(process("-m", "tactiled", "run", "--config", str(config)))
        reports = (json.loads(line) for line in emulator.stdout)
        t0_s = next(report["t0_s"] for report in reports if report["what"] == "scene")
        scan = next(reports)
        while scan["what"] != "scan" or scan["began_s"] < t0_s + FILLED_S:
            if scan["what"] == "scan" and time.monotonic() - scan["began_s"] > TOO_LATE_S:
                pytest.skip("this host is too slow for an emulated board in real time")
            scan = next(reports)
        assert controller.poll() is None
        assert not scan["fallen"]
        assert LEAST_N < scan["grip_n"] < 2.5 * LEAST_N
