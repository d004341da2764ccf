"""``tactiled demo --web``: emulated board, daemon and live page as processes, until Ctrl-C."""

import contextlib
import json
import subprocess
import tempfile
import time
import webbrowser
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import click

from tactiled import child
from tactiled.demo.play import SCENE, DemoError
from tactiled.emulator.scene.description import load_scene

_START_S = 60.0  # Python and its libraries take 6 s to start on a small loaded machine
_REST_S = 8.0  # between two plays: the board is pulled out and plugged in again, as the lamp shows
_CONFIG = """\
[port]
url = "{folder}/board"
[board]
array = "wang2019-3x3"
[publish]
endpoints = ["ipc://{folder}/events.ipc"]
[detect.texture]
speed_mm_s = 1.0
"""


def run_page_demo(port: int, *, opens: bool) -> None:
    """Play the demo scene again and again below the live page, until Ctrl-C.

    Parameters
    ----------
    opens : bool
        Open the page in the browser of this desktop.

    Raises
    ------
    DemoError
        A process did not start.
    """
    play_s = load_scene(SCENE).duration_s + _REST_S
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="tactiled-demo-")))
        config = folder / "tactiled.toml"
        config.write_text(_CONFIG.format(folder=folder))
        daemon = stack.enter_context(_process(folder, "daemon", "run", "--config", str(config)))
        page = stack.enter_context(
            _process(
                folder,
                "page",
                "web",
                "--events",
                f"ipc://{folder}/events.ipc",
                "--port",
                str(port),
                "--allow-commands",
            )
        )
        url = _address(folder, page)
        click.echo(f"The page: {url}\nCtrl-C ends the demo.", err=True)
        if opens:
            webbrowser.open(url)
        with contextlib.suppress(KeyboardInterrupt):
            while True:
                with _process(folder, "board", "emulate", "--scene", SCENE, "--link", str(folder / "board")):
                    until_s = time.monotonic() + play_s
                    while time.monotonic() < until_s:
                        for name, process in (("daemon", daemon), ("page", page)):
                            if process.poll() is not None:
                                raise DemoError(f"the {name} process ended: {_words(folder, name)}")
                        time.sleep(0.2)


@contextlib.contextmanager
def _process(folder: Path, name: str, *arguments: str) -> Iterator["subprocess.Popen[bytes]"]:
    """Run a tactiled command with its output in files of the folder."""
    with (folder / f"{name}.out").open("wb") as out, (folder / f"{name}.err").open("wb") as words:
        process = child.start(*arguments, stdout=out, stderr=words)
        try:
            yield process
        finally:
            child.end(process)


def _address(folder: Path, page: "subprocess.Popen[bytes]") -> str:
    """Wait for the address that the page server prints."""
    until_s = time.monotonic() + _START_S
    while time.monotonic() < until_s and page.poll() is None:
        for line in (folder / "page.out").read_text().splitlines():
            with contextlib.suppress(ValueError):
                return str(json.loads(line)["url"])
        time.sleep(0.1)
    raise DemoError(f"the page did not start: {_words(folder, 'page')}")


def _words(folder: Path, name: str) -> str:
    lines = (folder / f"{name}.err").read_text().splitlines()
    return lines[-1] if lines else "without a word"
