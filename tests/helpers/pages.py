"""Daemon, emulated board and page server as processes, and a browser that looks at the page."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from patience import PATIENCE_S
from playwright.sync_api import Page, expect
from stage import stage

CHROMIUM = shutil.which("chromium")
CHROMIUM_ARGUMENTS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
NO_CHROMIUM = "needs chromium: sudo apt install chromium"
LIVE_S = 1.0  # of a play that has been: a page shows the last second as it comes
CONFIG = """\
[port]
url = "{folder}/board"
[publish]
endpoints = ["ipc://{folder}/events.ipc"]
[record]
[detect.texture]
speed_mm_s = 1.0
answer_after_s = 1.2
hop_s = 0.6
"""


class Robot:
    """Processes of one robot in one folder; all end with it.

    Parameters
    ----------
    folder : Path
    config : str
        Text of the daemon's configuration, in which ``{folder}`` is replaced.
    """

    def __init__(self, folder: Path, config: str = CONFIG) -> None:
        self.folder = folder
        self.endpoint = f"ipc://{folder}/events.ipc"
        self.config = folder / "tactiled.toml"
        self.config.write_text(config.format(folder=folder))
        self._children: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, name: str, *arguments: str) -> None:
        """Start a verb of tactiled; its output goes to files named after `name`."""
        with (self.folder / f"{name}.out").open("wb") as out, (self.folder / f"{name}.err").open("wb") as err:
            command = [sys.executable, "-m", "tactiled", *arguments]
            self._children[name] = subprocess.Popen(command, stdout=out, stderr=err, env=dict(os.environ))

    def run(self) -> None:
        self.start("daemon", "run", "--config", str(self.config))

    def plug(self, scene: str = "rest") -> None:
        (self.folder / "board").unlink(missing_ok=True)
        self.start("board", "emulate", "--scene", scene, "--link", str(self.folder / "board"))

    def is_running(self, name: str) -> bool:
        return name in self._children and self._children[name].poll() is None

    def serve(self, *options: str, events: bool = True) -> str:
        """Start the page server, in place of one that runs; return the address of the page."""
        if self.is_running("web"):
            self.stop("web")
        source = ("--events", self.endpoint) if events else ()
        self.start("web", "web", "--port", "0", *source, *options)
        return str(self.line("web", "page")["url"])

    def line(self, name: str, what: str) -> dict[str, Any]:
        """Wait for a JSON line of a process."""
        until_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < until_s:
            for text in (self.folder / f"{name}.out").read_text().splitlines():
                if text.endswith("}") and json.loads(text).get("what") == what:
                    return dict(json.loads(text))
            assert self._children[name].poll() is None, self.words(name)
            time.sleep(0.05)
        raise AssertionError(f"{name} never said {what}: {self.words(name)}")

    def words(self, name: str) -> str:
        return (self.folder / f"{name}.err").read_text()

    def pid(self, name: str) -> int:
        return self._children[name].pid

    def stop(self, name: str, number: signal.Signals = signal.SIGTERM) -> int:
        """End a process and return its exit code."""
        child = self._children.pop(name)
        child.send_signal(number)
        try:
            return child.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
            raise

    def stop_all(self) -> None:
        for name in [*self._children]:
            self.stop(name, signal.SIGKILL)


def open_with_commands(page: Page, made: Robot) -> None:
    """Open the page of a server that accepts commands, and wait until data are fresh."""
    token = made.folder / "token"
    token.write_text("0123456789abcdef")
    token.chmod(0o600)
    page.goto(f"{made.serve('--allow-commands', '--token-file', str(token))}#token={token.read_text()}")
    expect(page.locator(".lamp")).to_have_attribute("data-state", "fresh")


@contextmanager
def staged(
    page: Page, made: Robot, *plays: tuple[str, str, float], live_s: float = LIVE_S, **options: Any
) -> Iterator[None]:
    """Play scenes (`stage`) to a page that is connected before, so that it misses nothing of them."""
    made.endpoint = f"ipc://{made.folder}/stage.ipc"
    page.goto(made.serve())
    expect(page.locator("#link-words")).to_have_text("page connected")
    with stage(made.folder, *plays, live_s=live_s, **options):
        yield


@contextmanager
def robot(folder: Path, config: str = CONFIG) -> Iterator[Robot]:
    made = Robot(folder, config)
    try:
        yield made
    finally:
        made.stop_all()
