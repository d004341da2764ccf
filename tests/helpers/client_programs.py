"""Programs of clients, and the daemon and the emulated board that they hear, in processes of their own."""

import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from patience import PATIENCE_S

# Cheap to compute, so that a busy host keeps up.
_TOUCH = """
[[phases]]
kind = "press"
duration_s = 1.0
force_n = 15.0

[[phases]]
kind = "slide"
duration_s = 2.0
speed_mm_s = 1.0

[[phases]]
kind = "lift"
duration_s = 0.5
"""
SCENE = 'name = "touches"\ncontact = "mechanics"\n' + 500 * _TOUCH


class Program:
    """Client in a process, with the lines that it has printed."""

    def __init__(self, *command: str | Path) -> None:
        self.lines: list[str] = []
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        self.lines.extend(iter(self._process.stdout.readline, ""))

    def say(self, line: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(f"{line}\n")
        self._process.stdin.flush()

    def until(self, enough: Callable[[list[list[str]]], bool], what: str, first: int = 0) -> list[list[str]]:
        """Wait for lines from the first on, as words; return them."""
        until_s = time.monotonic() + PATIENCE_S
        while not enough(words := [line.split() for line in self.lines[first:]]):
            assert time.monotonic() < until_s, f"never: {what}; last {self.lines[-3:]}"
            assert self._process.poll() is None, f"ended, without {what}"
            time.sleep(0.02)
        return words

    def kill(self) -> None:
        """End the program, which still runs."""
        assert self._process.poll() is None
        self._process.kill()
        self.close()

    def close(self) -> int:
        """End the input; return the exit code."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        code = self._process.wait(PATIENCE_S)
        self._reader.join()
        self._process.stdout.close()
        return code


@contextmanager
def process(*arguments: str | Path) -> Iterator["subprocess.Popen[str]"]:
    command = [sys.executable, "-m", "tactiled", *map(str, arguments)]
    with subprocess.Popen(command, text=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as child:
        try:
            yield child
        finally:
            child.kill()


@contextmanager
def board(folder: Path) -> Iterator[None]:
    """Emulated board on a pty: touches that slide, for longer than any test waits for it."""
    scene = folder / "touches.toml"
    scene.write_text(SCENE)
    with process("emulate", "--scene", scene, "--link", folder / "board") as emulator:
        assert emulator.stdout is not None
        assert json.loads(emulator.stdout.readline())["what"] == "ready"
        threading.Thread(target=emulator.stdout.read, daemon=True).start()  # a full pipe would stop it
        yield
