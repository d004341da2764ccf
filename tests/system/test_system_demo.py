"""`tactiled demo` as a newcomer runs it: three processes, truth beside estimate, a picture."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

pytestmark = pytest.mark.system


def test_demo_is_right_and_in_time(tmp_path: Path) -> None:
    began_s = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "tactiled", "demo"],
        capture_output=True, text=True, cwd=tmp_path, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert time.monotonic() - began_s < 60  # the scene itself takes 30
    assert "WRONG" not in done.stdout
    for quantity in ("incipient at", "gross at", "direction", "answer after", "period", "angle"):
        assert f"grooves: {quantity}" in done.stdout
    assert (tmp_path / "demo.png").read_bytes().startswith(b"\x89PNG")


@contextlib.contextmanager
def demo(folder: Path) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """A demo whose scene has begun, and the process of its emulated board."""
    said = folder / "err"
    with said.open("w") as err:
        process = subprocess.Popen(
            [sys.executable, "-m", "tactiled", "demo"],
            stdout=subprocess.PIPE, stderr=err, text=True, cwd=folder,
        )  # fmt: skip
        try:
            deadline_s = time.monotonic() + 180
            while "true: rest" not in said.read_text():
                assert process.poll() is None, said.read_text()
                assert time.monotonic() < deadline_s
                time.sleep(0.05)
            yield process, board_of(process.pid)
        finally:
            process.terminate()
            process.communicate()


def board_of(demo_pid: int) -> int:
    """Process id of the emulator that a demo started."""
    for task in Path(f"/proc/{demo_pid}/task").iterdir():
        for child in (task / "children").read_text().split():
            if b"\0emulate\0" in Path(f"/proc/{child}/cmdline").read_bytes():
                return int(child)
    raise AssertionError("the demo has started no emulator")


def test_a_host_that_is_too_slow_is_named_and_nothing_is_called_good(tmp_path: Path) -> None:
    """The emulator gets the processor for 0.3 s in each 1.3 s.

    Where it catches up, the scans are late; where it does not, it misses scan instants. Either is evidence.
    """
    with demo(tmp_path) as (process, board):
        while process.poll() is None:
            with contextlib.suppress(ProcessLookupError):  # the demo has ended it
                os.kill(board, signal.SIGSTOP)
                time.sleep(1.0)
                os.kill(board, signal.SIGCONT)
            time.sleep(0.3)
        out = process.stdout.read() if process.stdout else ""
    said = (tmp_path / "err").read_text()
    assert process.returncode == 1, said
    assert re.search(r"too slow or too busy for the demo: .*(board missed \d+|\d+ scans were late)", said)
    assert "The line is not at fault" in said
    assert "good" not in out + said
    assert "cable" not in out + said


def test_a_demo_that_is_cut_short_names_what_was_not_found(tmp_path: Path) -> None:
    with demo(tmp_path) as (process, board):
        time.sleep(1.0)
        os.kill(board, signal.SIGKILL)
        process.wait(60)
    said = (tmp_path / "err").read_text()
    assert process.returncode == 1, said
    assert "the demo was cut short: the board process ended after" in said
    for name in ("slip 1, flat", "slip 2, grooves"):
        assert f": {name}: gross at: not reported" in said
